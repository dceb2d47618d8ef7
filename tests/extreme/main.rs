//! Stiff and extreme cases, each with the answer or bound that it must meet: through deep framebuffer, direct light,
//! both methods of indirect light and compression. docs/extreme.md is the table; the heaviest run with RELUME_FULL=1.

#[path = "../common/mod.rs"]
mod common;

mod energy;
mod even;
mod geometry;
mod lights;
mod pictures;
mod place;
mod sized;
mod skies;
mod table;

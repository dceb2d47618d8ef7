//! Files: memory mapping, atomic writes, and journals of long bakes.

pub mod file;
pub mod journal;
#[allow(unsafe_code)]
pub mod mapped;

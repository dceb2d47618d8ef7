//! Published methods, to compare with.

pub mod row_wavelets;
pub mod thesis;

//! Published methods, for comparison.

pub mod row_wavelets;
pub mod thesis;

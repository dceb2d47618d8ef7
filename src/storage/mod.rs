//! Files: mapped into memory, written whole or not at all, and journals of long bakes.

pub mod file;
pub mod journal;
#[allow(unsafe_code)]
pub mod mapped;

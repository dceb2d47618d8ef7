//! Files: memory mapping, atomic writes, values with a checksum, and journals of long bakes.

pub mod checked;
pub mod file;
pub mod journal;
#[allow(unsafe_code)]
pub mod mapped;
pub mod pods;

//! IES files and what they say.

use std::ops::Deref;

use super::ies::{self, Photometry};

/// An IES file: its photometry, and its bytes, which exports copy.
#[derive(Clone, Debug, PartialEq)]
pub struct Profile {
    photometry: Photometry,
    pub file: Vec<u8>,
}

impl Profile {
    /// # Errors
    /// One sentence that says what is wrong with the file.
    pub fn parse(file: &[u8]) -> Result<Self, String> {
        Ok(Self { photometry: ies::parse(file)?, file: file.to_vec() })
    }
}

impl Deref for Profile {
    type Target = Photometry;

    fn deref(&self) -> &Photometry {
        &self.photometry
    }
}

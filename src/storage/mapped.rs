//! Memory-mapped files, whose factors are uploaded to the device or multiplied without a copy in between, and arrays
//! that may be stored in one.

use std::fs::File;
use std::io;
use std::ops::{Deref, Range};
use std::sync::Arc;

use bytemuck::Pod;
use memmap2::Mmap;

/// The bytes of a file that never changes; the system loads pages on first access and may evict them.
#[derive(Clone, Debug)]
pub struct Mapping(Arc<(Mmap, Option<File>)>);

impl Mapping {
    /// Maps a cache file.
    pub fn new(file: &File) -> io::Result<Self> {
        Self::map(file).map(|map| Self(Arc::new((map, None))))
    }

    /// The same, with a lock that tells other processes that the file is in use.
    pub fn in_use(file: File) -> io::Result<Self> {
        // Where there are no locks, nobody is told.
        let _ = file.try_lock_shared();
        Self::map(&file).map(|map| Self(Arc::new((map, Some(file)))))
    }

    fn map(file: &File) -> io::Result<Mmap> {
        // SAFETY: no process may write to the file or truncate it while it is mapped. relume does not: cache files are
        // written to a temporary file and renamed, replaced by renaming others over them, and removed by unlinking; all
        // of these leave a mapped file unchanged. Another program could, as it could change our libraries, which are
        // mapped too. The consequences are limited: once a mapping has been validated, only its factors are used, which
        // are numbers whatever their bits. Indices that a kernel follows are copied before they are validated.
        unsafe { Mmap::map(file) }
    }
}

impl Deref for Mapping {
    type Target = [u8];

    fn deref(&self) -> &[u8] {
        &self.0.0
    }
}

/// An array in memory, or in a mapped file. Clones share it.
#[derive(Clone, Debug)]
pub enum Elements<T> {
    Owned(Arc<Vec<T>>),
    /// Byte range `place` of the file.
    Mapped {
        file: Mapping,
        place: Range<usize>,
    },
}

impl<T: Pod> Elements<T> {
    /// Maps a byte range; `None` unless it is inside the file, aligned, and a whole number of elements.
    pub fn mapped(file: &Mapping, place: Range<usize>) -> Option<Self> {
        bytemuck::try_cast_slice::<u8, T>(file.get(place.clone())?).ok()?;
        Some(Self::Mapped { file: file.clone(), place })
    }

    /// Mutable access; elements that are mapped or shared are copied first.
    pub fn to_mut(&mut self) -> &mut Vec<T> {
        if let Self::Mapped { .. } = self {
            *self = Self::from(self.to_vec());
        }
        match self {
            Self::Owned(elements) => Arc::make_mut(elements),
            Self::Mapped { .. } => unreachable!("just copied"),
        }
    }
}

impl<T: Pod> Deref for Elements<T> {
    type Target = [T];

    fn deref(&self) -> &[T] {
        match self {
            Self::Owned(elements) => elements,
            Self::Mapped { file, place } => bytemuck::cast_slice(&file[place.clone()]),
        }
    }
}

impl<T> Default for Elements<T> {
    fn default() -> Self {
        Self::from(Vec::new())
    }
}

impl<T> From<Vec<T>> for Elements<T> {
    fn from(elements: Vec<T>) -> Self {
        Self::Owned(Arc::new(elements))
    }
}

#[cfg(test)]
mod tests {
    use std::io::Write;

    use super::*;

    #[test]
    fn elements_are_the_same_wherever_they_lie() {
        let mut written = tempfile::tempfile().unwrap();
        written.write_all(bytemuck::cast_slice(&[1u32, 2, 3, 4])).unwrap();
        let file = Mapping::new(&written).unwrap();
        let mut mapped = Elements::<u32>::mapped(&file, 4..12).unwrap();
        assert_eq!(mapped[..], [2, 3]);
        assert!(Elements::<u32>::mapped(&file, 4..4).unwrap().is_empty());
        for nowhere in [4..11, 2..10, 8..20, 16..20] {
            assert!(Elements::<u32>::mapped(&file, nowhere).is_none());
        }
        mapped.to_mut().push(5);
        assert_eq!(mapped[..], [2, 3, 5]);
        assert!(matches!(mapped, Elements::Owned(_)));
    }
}

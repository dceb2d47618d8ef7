//! Files with one serialized value: a line that names kind and version, the value, and a checksum over both.

use std::io::{self, Write};
use std::path::Path;

use serde::Serialize;
use serde::de::DeserializeOwned;

use super::file::{mark_used, open, write_whole};
use super::mapped::Mapping;
use crate::error::{Error, Result};

/// Writes `value` to `path`, whole or not at all. `kind` is one line: what the file is, and its version.
pub fn write(path: &Path, kind: &str, value: &impl Serialize) -> Result<()> {
    write_whole(path, |out| {
        let mut hashing = Hashing { out, hasher: blake3::Hasher::new() };
        writeln!(hashing, "{kind}").map_err(Error::io("write", path))?;
        postcard::to_io(value, &mut hashing)
            .map_err(|source| Error::Export { path: path.into(), source: source.into() })?;
        let Hashing { out, hasher } = hashing;
        out.write_all(hasher.finalize().as_bytes()).map_err(Error::io("write", path))
    })
}

/// A value, and the checksum of its file.
pub type Checked<T> = (T, [u8; blake3::OUT_LEN]);

/// Reads what [`write`] wrote with the same `kind`. The error says whether the file is damaged or of another kind.
pub fn read<T: DeserializeOwned>(path: &Path, kind: &str) -> Result<Checked<T>> {
    open(path)?; // a regular file
    decode(&std::fs::read(path).map_err(Error::io("read", path))?, path, kind)
}

/// The same of a file of the cache, which is marked as used and not copied as a whole.
pub fn read_mapped<T: DeserializeOwned>(path: &Path, kind: &str) -> Result<Checked<T>> {
    let (file, _) = open(path)?;
    mark_used(&file);
    decode(&Mapping::in_use(file).map_err(Error::io("read", path))?, path, kind)
}

fn decode<T: DeserializeOwned>(bytes: &[u8], path: &Path, kind: &str) -> Result<Checked<T>> {
    let damaged = || Error::import(path, "the file is damaged");
    let (content, checksum) = bytes.split_last_chunk::<{ blake3::OUT_LEN }>().ok_or_else(damaged)?;
    if blake3::Hasher::new().update_rayon(content).finalize().as_bytes() != checksum {
        return Err(damaged());
    }
    let line = content.iter().position(|byte| *byte == b'\n').ok_or_else(damaged)?;
    if &content[..line] != kind.as_bytes() {
        let found = String::from_utf8_lossy(&content[..line]);
        return Err(Error::import(path, format!("this is a {found}, and a {kind} is needed")));
    }
    match postcard::take_from_bytes(&content[line + 1..]) {
        Ok((value, [])) => Ok((value, *checksum)),
        _ => Err(damaged()),
    }
}

/// Hashes what it passes on.
struct Hashing<'a> {
    out: &'a mut dyn Write,
    hasher: blake3::Hasher,
}

impl Write for Hashing<'_> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let written = self.out.write(bytes)?;
        self.hasher.update(&bytes[..written]);
        Ok(written)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.out.flush()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_was_written_is_read_and_damage_is_told() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("value");
        let value = (3u32, vec![1.5f32, -2.0], "text".to_owned());
        write(&path, "test file 1", &value).unwrap();
        assert_eq!(read::<(u32, Vec<f32>, String)>(&path, "test file 1").unwrap().0, value);
        let told = |path: &Path| read::<(u32, Vec<f32>, String)>(path, "test file 2").unwrap_err().to_string();
        assert!(told(&path).ends_with("this is a test file 1, and a test file 2 is needed"), "{}", told(&path));
        let whole = std::fs::read(&path).unwrap();
        for cut in 0..whole.len() {
            std::fs::write(&path, &whole[..cut]).unwrap();
            assert!(told(&path).ends_with("the file is damaged"), "{cut}");
            let mut changed = whole.clone();
            changed[cut] ^= 1;
            std::fs::write(&path, &changed).unwrap();
            assert!(told(&path).ends_with("the file is damaged"), "{cut}");
        }
    }
}

//! Baked data on disk, keyed by content: safetensors files, which NumPy reads too, with a checksum over header and
//! data. Files are memory-mapped: data that is not copied out is read once, and the system can reclaim its memory.
//!
//! [`store`] and [`store_transfer`] name the tensors. Structs are rows of 32-bit words, in the order of their fields in
//! src/shared/mod.rs; float fields of a tensor of type U32 are stored by their bits.

mod folder;
mod framebuffer;
mod inputs;
mod transfer;

use std::ops::Range;
use std::path::{Path, PathBuf};

use bytemuck::Pod;
use safetensors::tensor::{Dtype, Metadata, SafeTensors, TensorInfo};
use serde::{Deserialize, Serialize};

pub use self::folder::{Entry, Keep, Pruned, list, prune};
pub use self::framebuffer::{load, store};
pub use self::inputs::Inputs;
pub use self::transfer::{load_sky, load_transfer, store_sky, store_transfer, transfer_key};

use crate::bake::compression::Part;
use crate::error::{Cause, Error, Result};
use crate::storage::file::{mark_used, open, write_whole};
use crate::storage::mapped::{Elements, Mapping};

/// Version of the file format; incremented when the content changes.
const FORMAT: &str = "40";

/// Hash of all inputs of a bake; names its file.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Key(String);

/// A byte string that identifies these settings among all settings of their type.
fn serialized(settings: &impl Serialize) -> Vec<u8> {
    postcard::to_stdvec(settings).expect("plain data is serialized in memory")
}

fn hash_of(settings: &impl Serialize) -> String {
    name(&blake3::hash(&serialized(settings)))
}

fn name(hash: &blake3::Hash) -> String {
    hash.to_hex()[..32].to_owned()
}

/// Path of another file that belongs to the bake of `key`; what it is, its extension tells.
pub fn file_of(dir: &Path, key: &Key, extension: &str) -> PathBuf {
    dir.join(format!("bake-{}.{extension}", key.0))
}

/// The same of one part of that bake.
pub fn file_of_part(dir: &Path, key: &Key, Part { number, count }: Part, extension: &str) -> PathBuf {
    file_of(dir, key, &format!("{number}-of-{count}.{extension}"))
}

/// The finished parts of the bake of `key`, with their files.
pub fn parts(dir: &Path, key: &Key) -> Result<Vec<(Part, PathBuf)>> {
    let prefix = format!("bake-{}.", key.0);
    let part = |name: &str| {
        let numbers = name.strip_prefix(&prefix)?.strip_suffix(".part")?;
        numbers.replace("-of-", "/").parse::<Part>().ok()
    };
    let paths = files(dir, |name| part(name).is_some())?;
    let name = |path: &Path| path.file_name().and_then(|name| part(name.to_str()?));
    Ok(paths.into_iter().filter_map(|path| Some((name(&path)?, path))).collect())
}

/// What files of a bake in parts call themselves; `what` they are.
pub fn kind(what: &str) -> String {
    format!("relume {what}, format {FORMAT} of {}", env!("CARGO_PKG_VERSION"))
}

/// Whether there is a file of a key, damaged or not.
pub fn has(dir: &Path, key: &Key) -> bool {
    file(dir, key).exists()
}

fn file(dir: &Path, key: &Key) -> PathBuf {
    file_of(dir, key, "safetensors")
}

/// The file of a key as decoded by `decode`. A file that is damaged or of another version is reported in one line.
/// `decode` must validate everything, as it runs in parallel with the checksum.
fn read<T: Send>(dir: &Path, key: &Key, decode: impl Fn(&Reader) -> Option<T> + Sync) -> Option<T> {
    let path = file(dir, key);
    let (opened, _) = open(&path).ok()?;
    mark_used(&opened);
    let reason = match Reader::new(Mapping::in_use(opened).ok()?) {
        Some(reader) if reader.text("relume") != Some(FORMAT) => "of another version",
        Some(reader) => match rayon::join(|| reader.is_whole(), || decode(&reader)) {
            (true, Some(decoded)) => return Some(decoded),
            _ => "damaged",
        },
        None => "damaged",
    };
    tracing::warn!("{} is {reason}: baking again", path.display());
    None
}

/// Whether a file name is that of a finished bake.
fn is_bake(name: &str) -> bool {
    name.starts_with("bake-") && name.ends_with(".safetensors")
}

fn files(dir: &Path, chosen: impl Fn(&str) -> bool) -> Result<Vec<PathBuf>> {
    let listed = match std::fs::read_dir(dir) {
        Err(e) if e.kind() == std::io::ErrorKind::NotFound => return Ok(Vec::new()),
        listed => listed.map_err(Error::io("list", dir))?,
    };
    let ours = |path: &PathBuf| path.file_name().and_then(|name| name.to_str()).is_some_and(&chosen);
    let mut files: Vec<_> = listed.flatten().map(|entry| entry.path()).filter(ours).collect();
    files.sort();
    Ok(files)
}

/// Writes one file: tensors with name, type and number of columns.
struct Writer<'a> {
    tensors: Vec<(String, Dtype, usize, &'a [u8])>,
}

impl<'a> Writer<'a> {
    fn add<T: Pod>(&mut self, name: impl Into<String>, dtype: Dtype, columns: usize, data: &'a [T]) {
        self.tensors.push((name.into(), dtype, columns, bytemuck::cast_slice(data)));
    }

    /// Writes header and data without copying the data.
    fn write(&self, path: &Path, metadata: &[(&str, String)]) -> Result<()> {
        let dir = path.parent().expect("files of the cache lie in it");
        std::fs::create_dir_all(dir).map_err(Error::io("create", dir))?;
        let blank = self.header(metadata).map_err(|source| Error::Export { path: path.into(), source })?;
        let mut hasher = blake3::Hasher::new();
        hasher.update(blank.as_bytes());
        for (.., bytes) in &self.tensors {
            hasher.update_rayon(bytes);
        }
        let header = blank.replacen(NO_CHECKSUM, &hasher.finalize().to_hex(), 1);
        write_whole(path, |out| {
            let length = (header.len() as u64).to_le_bytes();
            let data = self.tensors.iter().map(|(.., bytes)| *bytes);
            [&length, header.as_bytes()]
                .into_iter()
                .chain(data)
                .try_for_each(|bytes| out.write_all(bytes))
                .map_err(Error::io("write", path))
        })
    }

    /// The header with [`NO_CHECKSUM`], padded so that the data begins at a multiple of 8.
    fn header(&self, metadata: &[(&str, String)]) -> std::result::Result<String, Cause> {
        let mut end = 0;
        let info = |(name, dtype, columns, bytes): &(String, Dtype, usize, &[u8])| {
            let first = end;
            end += bytes.len();
            let rows = bytes.len() / (columns * dtype.bitsize() / 8);
            (name.clone(), TensorInfo { dtype: *dtype, shape: vec![rows, *columns], data_offsets: (first, end) })
        };
        let tensors = self.tensors.iter().map(info).collect();
        let ours = [("relume", FORMAT.to_owned()), ("blake3", NO_CHECKSUM.to_owned())];
        let all = ours.iter().chain(metadata).map(|(k, v)| ((*k).to_owned(), v.clone()));
        let mut header = serde_json::to_value(Metadata::new(Some(all.collect()), tensors)?)?;
        header.sort_all_objects(); // the same bake gives the same bytes
        let mut header = header.to_string();
        header.extend(std::iter::repeat_n(' ', header.len().next_multiple_of(8) - header.len()));
        Ok(header)
    }
}

/// Placeholder for the checksum, which also covers the header that contains it.
const NO_CHECKSUM: &str = "0000000000000000000000000000000000000000000000000000000000000000";

/// One memory-mapped file.
struct Reader {
    file: Mapping,
    metadata: Metadata,
    /// Offset of the data in bytes.
    data: usize,
}

impl Reader {
    /// `None` if the file is not valid safetensors.
    fn new(file: Mapping) -> Option<Self> {
        let (header, metadata) = SafeTensors::read_metadata(&file).ok()?;
        Some(Self { data: size_of::<u64>() + header, file, metadata })
    }

    /// A copy of a tensor's elements.
    fn take<T: Pod>(&self, name: &str) -> Option<Vec<T>> {
        let bytes = &self.file[self.place(name)?];
        bytes.len().is_multiple_of(size_of::<T>()).then(|| bytemuck::pod_collect_to_vec(bytes))
    }

    /// A tensor's elements, mapped.
    fn map<T: Pod>(&self, name: &str) -> Option<Elements<T>> {
        Elements::mapped(&self.file, self.place(name)?)
    }

    fn place(&self, name: &str) -> Option<Range<usize>> {
        let (first, end) = self.metadata.info(name)?.data_offsets;
        Some(self.data + first..self.data + end)
    }

    fn text(&self, name: &str) -> Option<&str> {
        self.metadata.metadata().as_ref()?.get(name).map(String::as_str)
    }

    fn field<T: std::str::FromStr>(&self, name: &str) -> Option<T> {
        self.text(name)?.parse().ok()
    }

    /// Whether the content matches the checksum.
    fn is_whole(&self) -> bool {
        let header = std::str::from_utf8(&self.file[size_of::<u64>()..self.data]).expect("it was parsed");
        let checksum = self.text("blake3").unwrap_or_default();
        let mut hasher = blake3::Hasher::new();
        hasher.update(header.replacen(checksum, NO_CHECKSUM, 1).as_bytes());
        hasher.update_rayon(&self.file[self.data..]);
        hasher.finalize().to_hex().as_str() == checksum
    }
}

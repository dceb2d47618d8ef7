//! Splits `.gltf` and `.glb` files into JSON and binary chunk, and reads their buffers.
//!
//! The gltf crate's own reader subtracts before it checks the header's length, so it is not used.

use std::path::Path;

use crate::error::{Error, Result};
use crate::scene::files;

/// The contents of one file.
pub struct Container {
    pub json: Vec<u8>,
    /// The `BIN` chunk of a `.glb`.
    pub bin: Option<Vec<u8>>,
}

pub const MAGIC: &[u8; 4] = b"glTF";
const JSON: u32 = u32::from_le_bytes(*b"JSON");
const BIN: u32 = u32::from_le_bytes(*b"BIN\0");

impl Container {
    pub fn read(path: &Path) -> Result<Self> {
        let bytes = files::read(path)?;
        let is_glb = path.extension().is_some_and(|e| e.eq_ignore_ascii_case("glb"));
        if bytes.starts_with(MAGIC) {
            Self::split(&bytes).map_err(|reason| Error::import(path, reason))
        } else if is_glb {
            Err(Error::import(path, "does not begin with \"glTF\", so it is not a .glb"))
        } else {
            // Byte order marks are not allowed, but occur.
            let json = bytes.strip_prefix(b"\xef\xbb\xbf").map(<[u8]>::to_vec).unwrap_or(bytes);
            Ok(Self { json, bin: None })
        }
    }

    /// Header of 12 bytes, then chunks of a length, a type and that many bytes [glTF 2.0, 4.4].
    fn split(bytes: &[u8]) -> Result<Self, String> {
        let u32_at = |at: usize| bytes.get(at..at + 4).map(|b| u32::from_le_bytes(b.try_into().expect("four bytes")));
        let (Some(version), Some(length)) = (u32_at(4), u32_at(8)) else {
            return Err("ends inside the .glb header".into());
        };
        if version != 2 {
            return Err(format!("is a .glb of version {version}, expected 2"));
        }
        let length = length as usize;
        if length > bytes.len() {
            return Err(format!("is cut off: {} bytes of {length}", bytes.len()));
        }
        let mut container = Self { json: Vec::new(), bin: None };
        let mut at = 12;
        for chunk_index in 0.. {
            if at >= length {
                break;
            }
            let (Some(size), Some(kind)) = (u32_at(at), u32_at(at + 4)) else {
                return Err(format!("ends inside the header of chunk {chunk_index}"));
            };
            let (begin, size) = (at + 8, size as usize);
            let Some(chunk) = bytes[..length].get(begin..begin + size) else {
                return Err(format!("chunk {chunk_index} claims {size} bytes, more than there are"));
            };
            match (chunk_index, kind) {
                (0, JSON) => container.json = chunk.to_vec(),
                (0, _) => return Err("its first chunk is not JSON".into()),
                (1, BIN) => container.bin = Some(chunk.to_vec()),
                // "Client implementations MUST ignore chunks with unknown types."
                _ => {}
            }
            at = begin + size;
        }
        // Padding should be spaces, but zeros occur.
        let text = container.json.iter().rposition(|&b| b != 0).map_or(0, |last| last + 1);
        container.json.truncate(text);
        if container.json.is_empty() {
            return Err("has no JSON chunk".into());
        }
        Ok(container)
    }
}

/// The bytes of buffer `index`: from its `uri`, or for the first buffer from the binary chunk.
pub fn buffer_bytes(path: &Path, index: usize, uri: Option<&str>, length: u64, bin: Option<&[u8]>) -> Result<Vec<u8>> {
    let what = format!("buffer {index}");
    let mut bytes = match (uri, bin) {
        (Some(uri), _) => files::read_uri(path, uri, &what)?,
        (None, Some(bin)) if index == 0 => bin.to_vec(),
        (None, _) => return Err(Error::import(path, format!("{what} has neither a URI nor a binary chunk"))),
    };
    if (bytes.len() as u64) < length {
        return Err(Error::import(path, format!("{what} claims {length} bytes and holds {}", bytes.len())));
    }
    // The rest is padding.
    bytes.truncate(length as usize);
    bytes.shrink_to_fit();
    Ok(bytes)
}

//! Decompresses geometry before anything else reads the file; the results are appended to the file's own buffers.

use gltf::json;
use json::buffer::View;
use json::validation::USize64;

use super::document::{Document, MESHOPT};
use super::meshopt::Packed;
use crate::error::{Error, Result};
use crate::scene::memory;

// The same limit as for buffers.
const MAX_UNPACKED_BYTES: usize = 1 << 32;

impl Document {
    /// Decompresses all buffer views and primitives.
    pub fn unpack(&mut self) -> Result<()> {
        self.unpack_views()?;
        self.unpack_draco()
    }

    fn unpack_views(&mut self) -> Result<()> {
        let mut total = 0usize;
        for index in 0..self.root.buffer_views.len() {
            let Some((name, packed)) = self.packed_view(index)? else { continue };
            let what = format!("buffer view {index}: {name}");
            let wrong = |document: &Self, reason: String| document.error(format!("{what}: {reason}"));
            let size = packed.unpacked_bytes().map_err(|reason| wrong(self, reason))?;
            total = total.saturating_add(size);
            if total > MAX_UNPACKED_BYTES || memory::available_bytes().is_some_and(|free| size as u64 > free) {
                return Err(wrong(self, format!("{size} bytes exceed the limit or the available memory")));
            }
            let buffer = self.item(&self.buffers, packed.buffer, "buffer", &what)?;
            let range = usize::try_from(packed.byte_offset).ok().zip(usize::try_from(packed.byte_length).ok());
            let bytes = range.and_then(|(begin, length)| buffer.get(begin..begin.checked_add(length)?));
            let bytes = bytes.ok_or_else(|| wrong(self, format!("overruns buffer {}", packed.buffer)))?;
            let unpacked = packed.unpack(bytes).map_err(|reason| wrong(self, reason))?;
            let view = &mut self.root.buffer_views[index];
            view.buffer = json::Index::new((self.buffers.len() + self.unpacked.buffers.len()) as u32);
            (view.byte_offset, view.byte_length) = (None, USize64(unpacked.len() as u64));
            self.unpacked.views.insert(index, self.unpacked.buffers.len());
            self.unpacked.buffers.push(unpacked);
        }
        Ok(())
    }

    fn packed_view(&self, index: usize) -> Result<Option<(&'static str, Packed)>> {
        let Some(extensions) = &self.root.buffer_views[index].extensions else { return Ok(None) };
        let Some((name, packed)) = MESHOPT.iter().find_map(|&name| Some((name, extensions.others.get(name)?))) else {
            return Ok(None);
        };
        let packed = serde_json::from_value(packed.clone())
            .map_err(|e| Error::import_from(&self.path, format!("buffer view {index}: {name}"), e))?;
        Ok(Some((name, packed)))
    }

    /// Adds a buffer and a view of it; returns the view's index.
    pub fn add_unpacked(&mut self, bytes: Vec<u8>) -> usize {
        self.root.buffer_views.push(View {
            buffer: json::Index::new((self.buffers.len() + self.unpacked.buffers.len()) as u32),
            byte_length: USize64(bytes.len() as u64),
            byte_offset: None,
            byte_stride: None,
            name: None,
            target: None,
            extensions: None,
            extras: Default::default(),
        });
        self.unpacked.buffers.push(bytes);
        self.root.buffer_views.len() - 1
    }

    /// Bytes of one of the file's own buffers, or of a decompressed one.
    pub fn buffer(&self, index: usize, asked_by: &str) -> Result<&[u8]> {
        match index.checked_sub(self.buffers.len()).and_then(|index| self.unpacked.buffers.get(index)) {
            Some(unpacked) => Ok(unpacked),
            None => Ok(self.item(&self.buffers, index, "buffer", asked_by)?),
        }
    }
}

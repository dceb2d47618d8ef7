//! EXR files: writes float32 layers, reads any flat RGB or grey layers.
//!
//! One part holds every channel, named `R` or `direct.R` as other programs show them; the `exr` crate's own layers
//! would become parts.

use std::io::Cursor;
use std::path::Path;

use exr::block::UncompressedBlock;
use exr::block::writer::ChunksWriter;
use exr::compression::Compression;
use exr::error::{Error as ExrError, Result as ExrResult};
use exr::math::Vec2;
use exr::meta::BlockDescription;
use exr::meta::attribute::{AttributeValue, ChannelDescription, Chromaticities, LineOrder, SampleType, Text};
use exr::meta::header::Header;
use rayon::prelude::*;

use super::Image;
pub use super::exr_read::read;
use crate::error::{Error, Result};
use crate::storage::file;

/// Metadata of a file.
#[derive(Clone, Debug)]
pub struct ExrMetadata {
    /// The attribute `comments` of OpenEXR.
    pub comments: String,
    /// Samples per pixel, the attribute `samplesPerPixel`.
    pub samples_per_pixel: u32,
}

/// Writes float32 layers atomically.
pub fn write(path: &Path, image: &Image) -> Result<()> {
    write_with_metadata(path, image, None)
}

/// [`write()`], optionally with metadata.
pub fn write_with_metadata(path: &Path, image: &Image, metadata: Option<&ExrMetadata>) -> Result<()> {
    let bytes =
        encode(image, metadata).map_err(|source| Error::Export { path: path.to_owned(), source: source.into() })?;
    file::write_bytes(path, &bytes)
}

/// Encodes one part of scan lines, ZIP-compressed in blocks of sixteen; the bytes do not depend on the number of
/// threads.
fn encode(image: &Image, metadata: Option<&ExrMetadata>) -> ExrResult<Vec<u8>> {
    let channels = sorted_channels(image)?;
    let headers = [header(image, &channels, metadata)?];
    let mut bytes = Vec::new();
    exr::block::write(Cursor::new(&mut bytes), headers.into_iter().collect(), true, |meta, file| {
        let header = &meta.headers[0];
        let blocks: Vec<_> = meta.enumerate_ordered_header_block_indices().collect();
        // The crate's parallel writer starts a thread pool for every file; this uses the existing threads.
        let chunks: ExrResult<Vec<_>> = blocks
            .into_par_iter()
            .map(|(order, index)| {
                let block = UncompressedBlock::from_lines(&header.channels, index, |line| {
                    let channel = &channels[line.location.channel];
                    let Vec2(x, y) = line.location.position;
                    let start = y * image.width + x;
                    line.write_samples(|i| channel.pixels[start + i][channel.component])
                        .expect("a line's buffer is as long as its samples");
                });
                Ok((order, block.compress_to_chunk(&meta.headers)?))
            })
            .collect();
        chunks?.into_iter().try_for_each(|(order, chunk)| file.write_chunk(order, chunk))
    })?;
    // exr 1.74.2 sets this flag only for long attribute names (see its `ChannelDescription::validate`), and OpenEXR
    // rejects long channel names without it. Can be removed when the crate checks channels too.
    if channels.iter().any(|channel| channel.name.len() > 31) {
        bytes[LONG_NAMES.0] |= LONG_NAMES.1;
    }
    Ok(bytes)
}

/// Byte and mask of bit 10 of the version field, which follows the four magic bytes [OpenEXR File Layout].
const LONG_NAMES: (usize, u8) = (4 + 1, 1 << (10 - 8));

struct Channel<'a> {
    name: String,
    component: usize,
    pixels: &'a [[f32; 3]],
}

/// Every layer's channels, sorted by the bytes of their names, as the format requires.
fn sorted_channels(image: &Image) -> ExrResult<Vec<Channel<'_>>> {
    if image.width == 0 || image.height == 0 || image.layers.is_empty() {
        return Err(ExrError::Invalid("an image without pixels".into()));
    }
    let mut channels = Vec::with_capacity(3 * image.layers.len());
    for layer in &image.layers {
        assert_eq!(layer.pixels.len(), image.width * image.height, "pixels of layer `{}`", layer.name);
        // At most 255 bytes with the dot and the letter; names end at the first NUL.
        if layer.name.len() > 253 || layer.name.contains('\0') {
            return Err(ExrError::Invalid(format!("layer {:?}: its name is too long or holds NUL", layer.name).into()));
        }
        for (component, letter) in ["R", "G", "B"].into_iter().enumerate() {
            let name = if layer.name.is_empty() { letter.to_owned() } else { format!("{}.{letter}", layer.name) };
            channels.push(Channel { name, component, pixels: &layer.pixels });
        }
    }
    channels.sort_by(|a, b| a.name.cmp(&b.name));
    Ok(channels)
}

fn header(image: &Image, channels: &[Channel], metadata: Option<&ExrMetadata>) -> ExrResult<Header> {
    let described = channels.iter().map(|channel| ChannelDescription {
        // Names are UTF-8, as in OpenEXR; the crate's own conversion supports only Latin-1.
        name: Text::from_slice_unchecked(channel.name.as_bytes()),
        sample_type: SampleType::F32,
        quantize_linearly: false,
        sampling: Vec2(1, 1),
    });
    let size = Vec2(image.width, image.height);
    if i32::try_from(image.width).is_err() || i32::try_from(image.height).is_err() {
        return Err(ExrError::Invalid(format!("{}x{} pixels", image.width, image.height).into()));
    }
    let mut header = Header::new(Text::from("relume"), size, described.collect()).with_encoding(
        Compression::ZIP16,
        BlockDescription::ScanLines,
        LineOrder::Increasing,
    );
    // Only files of several parts have part names.
    header.own_attributes.layer_name = None;
    header.own_attributes.software_name = Some(Text::from(concat!("relume ", env!("CARGO_PKG_VERSION"))));
    header.shared_attributes.chromaticities = Some(REC_709);
    if let Some(metadata) = metadata {
        header.own_attributes.comments = Some(Text::new_or_panic(&metadata.comments));
        let samples = AttributeValue::I32(metadata.samples_per_pixel.try_into().unwrap_or(i32::MAX));
        // Only one such attribute: the crate writes them in no particular order.
        header.own_attributes.other.insert(Text::from("samplesPerPixel"), samples);
    }
    Ok(header)
}

/// [ITU-R BT.709-6, Section 1].
const REC_709: Chromaticities = Chromaticities {
    red: Vec2(0.64, 0.33),
    green: Vec2(0.30, 0.60),
    blue: Vec2(0.15, 0.06),
    white: Vec2(0.3127, 0.3290),
};

//! EXR files: writes layers and data channels, reads any flat RGB or grey layers.
//!
//! One part holds every channel, or each layer has a part. Channels are named `R` or `direct.R` in both, as other
//! programs show them; the `exr` crate's own layers would lose their prefix.

use std::io::Cursor;
use std::path::Path;

use exr::block::UncompressedBlock;
use exr::block::writer::ChunksWriter;
use exr::compression::Compression;
use exr::error::{Error as ExrError, Result as ExrResult};
use exr::math::{RoundingMode, Vec2};
use exr::meta::BlockDescription;
use exr::meta::attribute::{
    AttributeValue, ChannelDescription, Chromaticities, LevelMode, LineOrder, SampleType, Text, TileDescription,
};
use exr::meta::header::Header;
use half::f16;
use rayon::prelude::*;

use super::Image;
pub use super::exr_read::read;
use super::primaries::Primaries;
use crate::error::{Error, Result};
use crate::storage::file;

/// Metadata of a file; none by default.
#[derive(Clone, Debug, Default)]
pub struct ExrMetadata {
    /// The attribute `comments` of OpenEXR, if not empty.
    pub comments: String,
    /// Samples per pixel, the attribute `samplesPerPixel`, if not 0.
    pub samples_per_pixel: u32,
    /// Further attributes, as texts.
    pub texts: Vec<(String, String)>,
    /// Precision of the layers.
    pub precision: Precision,
    /// Of the layers in the file; those of the image have the primaries of Rec. 709.
    pub primaries: Primaries,
    pub blocks: Blocks,
    /// Whether each layer has a part of its own.
    pub has_parts: bool,
}

/// What is compressed together.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Blocks {
    /// Sixteen lines.
    #[default]
    Lines,
    /// 64 by 64 pixels.
    Tiles,
}

/// Precision of colours. Data channels have 32 bits.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Precision {
    /// 32 bits.
    #[default]
    Float,
    /// 16 bits: three digits, up to 65504; what is brighter becomes that.
    Half,
}

/// Writes float32 layers atomically.
pub fn write(path: &Path, image: &Image) -> Result<()> {
    write_with_metadata(path, image, &ExrMetadata::default())
}

/// [`write()`] with metadata.
pub fn write_with_metadata(path: &Path, image: &Image, metadata: &ExrMetadata) -> Result<()> {
    let bytes =
        encode(image, metadata).map_err(|source| Error::Export { path: path.to_owned(), source: source.into() })?;
    file::write_bytes(path, &bytes)
}

/// Encodes the image, ZIP-compressed; the bytes do not depend on the number of threads.
pub(crate) fn encode(image: &Image, metadata: &ExrMetadata) -> ExrResult<Vec<u8>> {
    let converted = converted(image, metadata.primaries);
    let mut channels = sorted_channels(converted.as_ref().unwrap_or(image))?;
    if metadata.has_parts {
        channels.sort_by(|a, b| a.layer().cmp(b.layer())); // stable; a.R and a.x are no neighbours if there is a.b.R
    }
    let parts: Vec<&[Channel]> = match metadata.has_parts {
        true => channels.chunk_by(|a, b| a.layer() == b.layer()).collect(),
        false => vec![&channels],
    };
    let headers: Vec<Header> = parts.iter().map(|part| header(image, part, metadata)).collect::<ExrResult<_>>()?;
    let part_count = headers.len();
    let mut bytes = Vec::new();
    exr::block::write(Cursor::new(&mut bytes), headers.into_iter().collect(), true, |meta, file| {
        let blocks: Vec<_> = meta.enumerate_ordered_header_block_indices().collect();
        // The crate's parallel writer starts a thread pool for every file; this uses the existing threads.
        let chunks: ExrResult<Vec<_>> = blocks
            .into_par_iter()
            .map(|(order, index)| {
                let block = UncompressedBlock::from_lines(&meta.headers[index.layer].channels, index, |line| {
                    let channel = &parts[index.layer][line.location.channel];
                    let Vec2(x, y) = line.location.position;
                    let start = y * image.width + x;
                    let written = match channel.sample_type(metadata.precision) {
                        SampleType::F16 => line.write_samples(|i| half(channel.value(start + i))),
                        _ => line.write_samples(|i| channel.value(start + i)),
                    };
                    written.expect("a line's buffer is as long as its samples");
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
    let mut at = 8; // after magic number and version
    for _ in 0..part_count {
        at = sort_attributes(&mut bytes, at);
    }
    Ok(bytes)
}

/// Pixels; as most programs write it.
const TILE_SIDE: usize = 64;

/// Byte and mask of bit 10 of the version field, which follows the four magic bytes [OpenEXR File Layout].
const LONG_NAMES: (usize, u8) = (4 + 1, 1 << (10 - 8));

/// Sorts the attributes of the header that begins at a byte, by name: the crate writes those of others in random order.
/// Returns where the next one begins.
fn sort_attributes(bytes: &mut [u8], begin: usize) -> usize {
    let mut attributes = Vec::new();
    let mut at = begin;
    // Name and type end with a NUL, then come four bytes of size and the value [OpenEXR File Layout].
    while bytes[at] != 0 {
        let text = |at: usize| bytes[at..].iter().position(|byte| *byte == 0).map(|length| at + length + 1);
        let size_at = text(at).and_then(text).expect("the header is whole");
        let size = u32::from_le_bytes(bytes[size_at..size_at + 4].try_into().expect("four bytes"));
        let end = size_at + 4 + size as usize;
        attributes.push(bytes[at..end].to_vec());
        at = end;
    }
    attributes.sort();
    bytes[begin..at].copy_from_slice(&attributes.concat());
    at + 1
}

/// The nearest of 16 bits; brighter than these can be becomes the brightest.
fn half(value: f32) -> f16 {
    f16::from_f32(value.clamp(f16::MIN.to_f32(), f16::MAX.to_f32()))
}

struct Channel<'a> {
    name: String,
    values: Values<'a>,
}

enum Values<'a> {
    /// A component of a layer.
    Layer(&'a [[f32; 3]], usize),
    Data(&'a [f32]),
}

impl Channel<'_> {
    /// Name of its layer; empty for `R`.
    fn layer(&self) -> &str {
        self.name.rsplit_once('.').map_or("", |(layer, _)| layer)
    }

    fn value(&self, pixel: usize) -> f32 {
        match self.values {
            Values::Layer(pixels, component) => pixels[pixel][component],
            Values::Data(values) => values[pixel],
        }
    }

    fn sample_type(&self, precision: Precision) -> SampleType {
        match (&self.values, precision) {
            (Values::Layer(..), Precision::Half) => SampleType::F16,
            _ => SampleType::F32,
        }
    }
}

/// Every layer's channels, sorted by the bytes of their names, as the format requires.
fn sorted_channels(image: &Image) -> ExrResult<Vec<Channel<'_>>> {
    if image.width == 0 || image.height == 0 || image.layers.is_empty() && image.data.is_empty() {
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
            channels.push(Channel { name, values: Values::Layer(&layer.pixels, component) });
        }
    }
    for channel in &image.data {
        assert_eq!(channel.values.len(), image.width * image.height, "values of channel `{}`", channel.name);
        channels.push(Channel { name: channel.name.clone(), values: Values::Data(&channel.values) });
    }
    channels.sort_by(|a, b| a.name.cmp(&b.name));
    Ok(channels)
}

fn header(image: &Image, channels: &[Channel], metadata: &ExrMetadata) -> ExrResult<Header> {
    let described = channels.iter().map(|channel| ChannelDescription {
        // Names are UTF-8, as in OpenEXR; the crate's own conversion supports only Latin-1.
        name: Text::from_slice_unchecked(channel.name.as_bytes()),
        sample_type: channel.sample_type(metadata.precision),
        quantize_linearly: false,
        sampling: Vec2(1, 1),
    });
    let size = Vec2(image.width, image.height);
    if i32::try_from(image.width).is_err() || i32::try_from(image.height).is_err() {
        return Err(ExrError::Invalid(format!("{}x{} pixels", image.width, image.height).into()));
    }
    let mut header = Header::new(Text::from("relume"), size, described.collect()).with_encoding(
        Compression::ZIP16,
        match metadata.blocks {
            Blocks::Lines => BlockDescription::ScanLines,
            Blocks::Tiles => BlockDescription::Tiles(TileDescription {
                tile_size: Vec2(TILE_SIDE, TILE_SIDE),
                level_mode: LevelMode::Singular,
                rounding_mode: RoundingMode::Down,
            }),
        },
        LineOrder::Increasing,
    );
    // Only files of several parts have part names.
    let part = match channels[0].layer() {
        "" => "beauty",
        layer => layer,
    };
    header.own_attributes.layer_name = metadata.has_parts.then(|| Text::from_slice_unchecked(part.as_bytes()));
    header.own_attributes.software_name = Some(Text::from(concat!("relume ", env!("CARGO_PKG_VERSION"))));
    header.shared_attributes.chromaticities = Some(chromaticities(metadata.primaries));
    if !metadata.comments.is_empty() {
        header.own_attributes.comments = Some(Text::from_slice_unchecked(metadata.comments.as_bytes()));
    }
    let others = &mut header.own_attributes.other;
    if metadata.samples_per_pixel > 0 {
        let samples = AttributeValue::I32(metadata.samples_per_pixel.try_into().unwrap_or(i32::MAX));
        others.insert(Text::from("samplesPerPixel"), samples);
    }
    for (name, text) in &metadata.texts {
        let text = AttributeValue::Text(Text::from_slice_unchecked(text.as_bytes()));
        others.insert(Text::from_slice_unchecked(name.as_bytes()), text);
    }
    Ok(header)
}

fn chromaticities(Primaries { rgb: [red, green, blue], white }: Primaries) -> Chromaticities {
    let [red, green, blue, white] = [red, green, blue, white].map(|xy| Vec2(xy.x as f32, xy.y as f32));
    Chromaticities { red, green, blue, white }
}

/// The layers in other primaries; `None` if these are those of Rec. 709.
fn converted(image: &Image, primaries: Primaries) -> Option<Image> {
    if primaries == Primaries::REC_709 {
        return None;
    }
    let mut image = image.clone();
    image.map_pixels(primaries.from_rec_709());
    Some(image)
}

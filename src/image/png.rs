//! PNG files: writes 8 or 16 bits a channel, reads any PNG as 8-bit RGBA.

use std::io::BufReader;
use std::path::Path;

use crate::error::{Error, Result};
use crate::storage::file;

/// Pixels of a PNG file, row by row from the top, as stored (sRGB unless the file says otherwise).
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Pixels {
    pub width: usize,
    pub height: usize,
    pub rgba: Vec<[u8; 4]>,
}

/// Bits a channel.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Depth {
    Eight,
    Sixteen,
}

/// Writes 8-bit sRGB pixels (RGB or RGBA by `CHANNELS`) atomically.
pub fn write<const CHANNELS: usize>(path: &Path, width: usize, height: usize, pixels: &[[u8; CHANNELS]]) -> Result<()> {
    assert_eq!(pixels.len(), width * height, "pixels of {width}x{height}");
    write_encoded(path, encode(width, height, pixels))
}

/// Writes values of a display in [0, 1], rounded to `depth`, atomically; `is_srgb`: whether the file says that they are
/// sRGB.
pub fn write_display(
    path: &Path,
    (width, height): (usize, usize),
    pixels: &[[f32; 3]],
    depth: Depth,
    is_srgb: bool,
) -> Result<()> {
    assert_eq!(pixels.len(), width * height, "pixels of {width}x{height}");
    let values = pixels.as_flattened().iter();
    let (bits, bytes) = match depth {
        Depth::Eight => (png::BitDepth::Eight, values.map(|value| (255.0 * value).round() as u8).collect::<Vec<_>>()),
        Depth::Sixteen => {
            let bytes = values.flat_map(|value| ((65535.0 * value).round() as u16).to_be_bytes());
            (png::BitDepth::Sixteen, bytes.collect())
        }
    };
    write_encoded(path, encode_bytes([width, height], (png::ColorType::Rgb, bits), &bytes, is_srgb))
}

/// Encodes a PNG file of 8-bit sRGB pixels.
pub(crate) fn encode<const CHANNELS: usize>(
    width: usize,
    height: usize,
    pixels: &[[u8; CHANNELS]],
) -> Result<Vec<u8>, png::EncodingError> {
    const { assert!(CHANNELS == 3 || CHANNELS == 4, "RGB or RGBA") };
    let color = if CHANNELS == 4 { png::ColorType::Rgba } else { png::ColorType::Rgb };
    encode_bytes([width, height], (color, png::BitDepth::Eight), pixels.as_flattened(), true)
}

fn encode_bytes(
    size: [usize; 2],
    (color, depth): (png::ColorType, png::BitDepth),
    data: &[u8],
    is_srgb: bool,
) -> Result<Vec<u8>, png::EncodingError> {
    // PNG sides are less than 2^31, so a clamped size is refused like the size itself.
    let [width, height] = size.map(|side| u32::try_from(side).unwrap_or(u32::MAX));
    let mut bytes = Vec::new();
    let mut encoder = png::Encoder::new(&mut bytes, width, height);
    encoder.set_color(color);
    encoder.set_depth(depth);
    if is_srgb {
        encoder.set_source_srgb(png::SrgbRenderingIntent::Perceptual);
    }
    let mut writer = encoder.write_header()?;
    writer.write_image_data(data)?;
    writer.finish()?;
    Ok(bytes)
}

fn write_encoded(path: &Path, encoded: Result<Vec<u8>, png::EncodingError>) -> Result<()> {
    let bytes = encoded.map_err(|source| Error::Export { path: path.to_owned(), source: source.into() })?;
    file::write_bytes(path, &bytes)
}

/// Reads any PNG as 8-bit RGBA: grey is replicated, palettes are expanded, 16 bits are reduced to the upper 8.
pub fn read(path: &Path) -> Result<Pixels> {
    let malformed = |cause: png::DecodingError| match cause {
        png::DecodingError::IoError(cause) if cause.kind() != std::io::ErrorKind::UnexpectedEof => {
            Error::io("read", path)(cause)
        }
        cause => Error::import_from(path, "not a readable PNG file", cause),
    };
    let (opened, file_bytes) = file::open(path)?;
    let mut decoder = png::Decoder::new(BufReader::new(opened));
    decoder.set_transformations(png::Transformations::normalize_to_color8());
    let mut reader = decoder.read_info().map_err(malformed)?;

    // Deflate compresses at most 1032:1, and the densest PNG holds 8 pixels per byte, each of which becomes 4 bytes.
    let most = file_bytes.saturating_mul(1032 * 8 * 4);
    let size = reader.output_buffer_size().filter(|&bytes| bytes as u64 <= most);
    let size = size.ok_or_else(|| Error::import(path, "claims more pixels than its bytes could hold"))?;
    let mut stored = vec![0; size];
    let frame = reader.next_frame(&mut stored).map_err(malformed)?;
    let stored = &stored[..frame.buffer_size()];
    let rgba = match frame.color_type {
        png::ColorType::Grayscale => stored.iter().map(|&grey| [grey, grey, grey, 255]).collect(),
        png::ColorType::GrayscaleAlpha => {
            stored.as_chunks::<2>().0.iter().map(|&[grey, alpha]| [grey, grey, grey, alpha]).collect()
        }
        png::ColorType::Rgb => stored.as_chunks::<3>().0.iter().map(|&[r, g, b]| [r, g, b, 255]).collect(),
        png::ColorType::Rgba => stored.as_chunks::<4>().0.to_vec(),
        png::ColorType::Indexed => unreachable!("palettes are expanded by the transformation set above"),
    };
    Ok(Pixels { width: frame.width as usize, height: frame.height as usize, rgba })
}

/// 8-bit sRGB value of a linear one, clamped to [0, 1]; NaN becomes 0 [IEC 61966-2-1, 5.2].
pub fn srgb8_from_linear(linear: f32) -> u8 {
    let linear = if linear.is_nan() { 0.0 } else { linear.clamp(0.0, 1.0) };
    let encoded = if linear <= 0.003_130_8 { 12.92 * linear } else { 1.055 * linear.powf(1.0 / 2.4) - 0.055 };
    (encoded * 255.0).round() as u8
}

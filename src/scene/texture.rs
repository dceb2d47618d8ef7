//! Textures: decoded once, sampled during the bake.

use std::path::Path;
use std::sync::LazyLock;

use glam::{Vec2, Vec4};
use image::ImageDecoder;
use rayon::prelude::*;

use super::memory;
use crate::error::Error;

/// How texture coordinates outside [0, 1] are mapped.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize)]
pub enum Wrap {
    Repeat,
    Mirror,
    Clamp,
}

/// Encoding of the stored RGB; alpha is always linear.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, serde::Serialize)]
pub enum Encoding {
    /// IEC 61966-2-1: base colour, emissive, specular colour.
    Srgb,
    Linear,
}

/// An image as a mip pyramid of RGBA texels with 8 or 16 bits per channel, row 0 at v = 0.
#[derive(Clone)]
pub struct Texture {
    pub name: String,
    pub encoding: Encoding,
    /// Finest first; each level has half the size of the previous one, rounded down; the last is 1x1. Never empty.
    pub levels: Vec<MipLevel>,
    /// Minimum of each channel, as stored; the upper byte of 16-bit channels.
    pub least: [u8; 4],
}

/// One level of a mip pyramid.
#[derive(Clone)]
pub struct MipLevel {
    pub width: usize,
    pub height: usize,
    /// width * height, row by row; the upper bytes of 16-bit channels.
    pub texels: Vec<[u8; 4]>,
    /// The lower bytes of 16-bit channels, else empty.
    pub low: Vec<[u8; 4]>,
}

/// A decoded image file.
#[derive(Clone)]
pub struct Image {
    pub width: usize,
    pub height: usize,
    /// width * height, row by row; the upper bytes of 16-bit channels.
    pub texels: Vec<[u8; 4]>,
    /// The lower bytes of 16-bit channels, else empty.
    pub low: Vec<[u8; 4]>,
}

/// Limit for all textures of a scene together: 2 GiB at 8 bits per channel, without mip levels. A file may refer to one
/// image any number of times, and an empty image compresses to almost nothing.
pub const MAX_TEXELS: u64 = 1 << 29;

// Memory limit for decoding one image: 16,384 x 16,384 RGBA is 1 GiB.
const MAX_DECODED_BYTES: u64 = 1 << 30;
const MAX_SIDE: u32 = 1 << 16;

/// Images of up to this many texels are accepted whatever their file size.
const SMALL: u64 = 1 << 24;
/// Maximum texels per file byte of larger images. PNG compresses 8-bit images to a thousandth at best, so a larger
/// ratio means an empty image, made to exhaust memory.
const MAX_TEXELS_PER_BYTE: u64 = 2_048;

/// Counts texels from file headers, before any image is decoded.
#[derive(Default)]
pub struct TexelCount {
    texels: u64,
    bytes: u64,
    largest: u64,
}

/// Why an image was refused.
pub enum Refusal {
    Undecodable(image::ImageError),
    TooLarge(String),
}

impl Refusal {
    /// The error for image `what` of the scene or library at `path`.
    pub fn at(self, path: &Path, what: &str) -> Error {
        match self {
            Self::Undecodable(cause) => Error::import_from(path, format!("{what} cannot be decoded"), cause),
            Self::TooLarge(reason) => Error::import(path, format!("{what}: {reason}")),
        }
    }
}

impl TexelCount {
    /// Adds a file, or returns which limit it exceeds. `name`: see [`Image::decode`].
    pub fn add(&mut self, file: &[u8], name: &Path) -> Result<(), Refusal> {
        let Header { width, height, texel_bytes } = Header::read(file, name).map_err(Refusal::Undecodable)?;
        let count = u64::from(width) * u64::from(height);
        let bytes = file.len() as u64;
        if count > SMALL && count / MAX_TEXELS_PER_BYTE > bytes {
            return Err(Refusal::TooLarge(format!("{width} x {height} texels in {bytes} bytes are implausible")));
        }
        self.texels += count;
        self.bytes += count * texel_bytes;
        self.largest = self.largest.max(count * texel_bytes);
        if self.texels > MAX_TEXELS {
            return Err(Refusal::TooLarge(format!("the textures have more than {MAX_TEXELS} texels together")));
        }
        // All textures with their mip levels; during decoding, the largest exists twice, with its second level in
        // single precision.
        let needed = self.bytes * 4 / 3 + self.largest * 2;
        match memory::available_bytes() {
            Some(free) if needed > free => {
                let [needed, free] = [needed, free].map(|bytes| bytes as f64 * 1e-9);
                let reason = format!("the textures take {needed:.1} GB of memory, {free:.1} GB are free");
                Err(Refusal::TooLarge(reason))
            }
            _ => Ok(()),
        }
    }
}

/// Size and depth from an image header.
struct Header {
    width: u32,
    height: u32,
    /// Bytes of a stored texel.
    texel_bytes: u64,
}

impl Header {
    fn read(file: &[u8], name: &Path) -> Result<Self, image::ImageError> {
        let mut reader = reader(file, name)?;
        reader.no_limits();
        let decoder = reader.into_decoder()?;
        let (width, height) = decoder.dimensions();
        Ok(Self { width, height, texel_bytes: if is_deep(decoder.color_type()) { 8 } else { 4 } })
    }
}

fn reader<'a>(file: &'a [u8], name: &Path) -> std::io::Result<image::ImageReader<std::io::Cursor<&'a [u8]>>> {
    let mut reader = image::ImageReader::new(std::io::Cursor::new(file));
    if let Ok(format) = image::ImageFormat::from_path(name) {
        reader.set_format(format);
    }
    reader.with_guessed_format()
}

/// Whether channels have more than 8 bits.
fn is_deep(color: image::ColorType) -> bool {
    color.bytes_per_pixel() > color.channel_count()
}

impl Image {
    /// Decodes a PNG, JPEG, WebP, BMP, TIFF or TGA file; channels of more than 8 bits are stored as 16. `name`: tells
    /// TGA, which nothing else does; may be empty.
    pub fn decode(file: &[u8], name: &Path) -> Result<Self, image::ImageError> {
        let mut reader = reader(file, name)?;
        let mut limits = image::Limits::default();
        limits.max_alloc = Some(MAX_DECODED_BYTES);
        limits.max_image_width = Some(MAX_SIDE);
        limits.max_image_height = Some(MAX_SIDE);
        reader.limits(limits);
        let pixels = reader.decode()?;
        let (width, height) = (pixels.width() as usize, pixels.height() as usize);
        if width == 0 || height == 0 {
            let reason = image::error::ParameterErrorKind::DimensionMismatch;
            return Err(image::ImageError::Parameter(image::error::ParameterError::from_kind(reason)));
        }
        let (texels, low) = if is_deep(pixels.color()) {
            let deep = pixels.into_rgba16();
            let texels: &[[u16; 4]] = deep.as_raw().as_chunks().0;
            texels.iter().map(|&texel| halves(texel)).unzip()
        } else {
            (pixels.into_rgba8().into_raw().as_chunks().0.to_vec(), Vec::new())
        };
        Ok(Self { width, height, texels, low })
    }

    /// The texels as linear RGBA.
    pub fn to_linear(self, encoding: Encoding) -> Vec<Vec4> {
        let Self { width, height, texels, low } = self;
        let (decode, level) = (Decode::of(encoding), MipLevel { width, height, texels, low });
        (0..width * height).map(|i| decode.texel(&level, i)).collect()
    }
}

impl Texture {
    /// A texture of width * height 8-bit `texels`, with all its mip levels.
    ///
    /// # Panics
    /// If the number of texels is not width * height, or zero.
    pub fn new(name: String, width: usize, height: usize, texels: Vec<[u8; 4]>, encoding: Encoding) -> Self {
        Self::of(name, Image { width, height, texels, low: Vec::new() }, encoding)
    }

    /// A texture of a decoded image.
    ///
    /// # Panics
    /// As [`Self::new`].
    pub fn of(name: String, image: Image, encoding: Encoding) -> Self {
        let Image { mut width, mut height, texels, low } = image;
        assert_eq!(texels.len(), width * height, "texels of a {width} x {height} texture");
        assert!(!texels.is_empty(), "a texture has at least one texel");
        let is_deep = !low.is_empty();
        let least = texels.iter().fold([255; 4], |least, t| std::array::from_fn(|c| t[c].min(least[c])));
        let mut levels = vec![MipLevel { width, height, texels, low }];
        let decode = Decode::of(encoding);
        // Each level is computed from the previous one before rounding; the finest is exact as stored.
        let mut finer: Vec<Vec4> = Vec::new();
        while width > 1 || height > 1 {
            let half = [(width / 2).max(1), (height / 2).max(1)];
            finer = match levels.len() {
                1 => shrink(|i| decode.texel(&levels[0], i), [width, height], half),
                _ => shrink(|i| finer[i], [width, height], half),
            };
            [width, height] = half;
            let (texels, low) = if is_deep {
                finer.par_iter().map(|&t| halves(stored(t, encoding, 65_535.0))).unzip()
            } else {
                let byte = |&t: &Vec4| stored(t, encoding, 255.0).map(|c| c as u8);
                (finer.par_iter().map(byte).collect(), Vec::new())
            };
            levels.push(MipLevel { width, height, texels, low });
        }
        Self { name, encoding, levels, least }
    }

    /// Texels of the finest level.
    pub fn width(&self) -> usize {
        self.levels[0].width
    }

    /// Texels of the finest level.
    pub fn height(&self) -> usize {
        self.levels[0].height
    }

    /// Linear RGBA at `uv`, trilinear: `footprint` is the pixel width in uv units, 0 reads the finest level.
    ///
    /// A non-finite coordinate reads as 0.
    pub fn sample(&self, uv: Vec2, wrap: [Wrap; 2], footprint: f32) -> Vec4 {
        let finest = &self.levels[0];
        let last = (self.levels.len() - 1) as f32;
        let texels = footprint * finest.width.max(finest.height) as f32;
        // A NaN footprint fails the comparison and reads the finest level.
        let lod = if texels > 1.0 { texels.log2().min(last) } else { 0.0 };
        let (fine, fraction) = (lod.floor() as usize, lod.fract());
        let near = self.bilinear(fine, uv, wrap);
        if fraction == 0.0 { near } else { near.lerp(self.bilinear(fine + 1, uv, wrap), fraction) }
    }

    /// The middle of the finest level's texel at `uv`.
    pub fn texel_center(&self, uv: Vec2) -> Vec2 {
        let size = Vec2::new(self.width() as f32, self.height() as f32);
        ((uv * size).floor() + 0.5) / size
    }

    fn bilinear(&self, level: usize, uv: Vec2, wrap: [Wrap; 2]) -> Vec4 {
        let level = &self.levels[level];
        let (x, tx) = taps(uv.x, wrap[0], level.width);
        let (y, ty) = taps(uv.y, wrap[1], level.height);
        let decode = Decode::of(self.encoding);
        let texel = |x: usize, y: usize| decode.texel(level, y * level.width + x);
        let top = texel(x[0], y[0]).lerp(texel(x[1], y[0]), tx);
        let bottom = texel(x[0], y[1]).lerp(texel(x[1], y[1]), tx);
        top.lerp(bottom, ty)
    }
}

/// The two texels next to coordinate `t` along a side of `size` texels, and the weight of the second.
fn taps(t: f32, wrap: Wrap, size: usize) -> ([usize; 2], f32) {
    let t = if t.is_finite() { t } else { 0.0 };
    // Reduced to one period first, so that huge coordinates fit integers.
    let t = match wrap {
        Wrap::Repeat => t.rem_euclid(1.0),
        Wrap::Mirror => t.rem_euclid(2.0),
        Wrap::Clamp => t.clamp(0.0, 1.0),
    };
    let x = t * size as f32 - 0.5;
    let size = size as i64;
    let index = |i: i64| match wrap {
        Wrap::Repeat => i.rem_euclid(size),
        Wrap::Mirror => {
            let i = i.rem_euclid(2 * size);
            i.min(2 * size - 1 - i)
        }
        Wrap::Clamp => i.clamp(0, size - 1),
    } as usize;
    let left = x.floor();
    ([index(left as i64), index(left as i64 + 1)], x - left)
}

/// Box filter: each new texel is the mean of the area that it covers, also for odd sides.
fn shrink(
    finer: impl Fn(usize) -> Vec4 + Sync,
    [width, height]: [usize; 2],
    [new_width, new_height]: [usize; 2],
) -> Vec<Vec4> {
    let columns = covers(width, new_width);
    let rows = covers(height, new_height);
    let texel = |row: &[(usize, f32)], column: &[(usize, f32)]| {
        let mut sum = Vec4::ZERO;
        for &(y, wy) in row {
            for &(x, wx) in column {
                sum += finer(y * width + x) * (wx * wy);
            }
        }
        sum
    };
    let mut coarser = vec![Vec4::ZERO; new_width * new_height];
    coarser.par_chunks_mut(new_width).zip(&rows).for_each(|(texels, row)| {
        texels.iter_mut().zip(&columns).for_each(|(t, column)| *t = texel(row, column));
    });
    coarser
}

/// For each of `coarse` texels along a side of `fine`: the fine texels that it covers and their weights, which sum to
/// 1.
fn covers(fine: usize, coarse: usize) -> Vec<Vec<(usize, f32)>> {
    let step = fine as f64 / coarse as f64;
    let cover = |i: usize| {
        let (begin, end) = (i as f64 * step, (i + 1) as f64 * step);
        let last = (end.ceil() as usize).min(fine);
        (begin as usize..last).map(|x| (x, ((end.min((x + 1) as f64) - begin.max(x as f64)) / step) as f32)).collect()
    };
    (0..coarse).map(cover).collect()
}

/// Encodes linear RGBA to integer channels from 0 to `most`.
fn stored(linear: Vec4, encoding: Encoding, most: f32) -> [u16; 4] {
    let encode = |c: f32| match encoding {
        Encoding::Srgb if c <= 0.003_130_8 => c * 12.92,
        Encoding::Srgb => 1.055 * c.powf(1.0 / 2.4) - 0.055,
        Encoding::Linear => c,
    };
    let round = |c: f32| (c * most).round() as u16;
    [round(encode(linear.x)), round(encode(linear.y)), round(encode(linear.z)), round(linear.w)]
}

/// The upper and the lower bytes of a texel.
fn halves(texel: [u16; 4]) -> ([u8; 4], [u8; 4]) {
    (texel.map(|c| (c >> 8) as u8), texel.map(|c| c as u8))
}

/// IEC 61966-2-1.
pub(super) fn srgb_to_linear(c: f64) -> f64 {
    if c <= 0.04045 { c / 12.92 } else { ((c + 0.055) / 1.055).powf(2.4) }
}

/// Tables from stored to linear values: sRGB, or the identity.
struct Decode {
    of_8_bits: Vec<f32>,
    of_16_bits: Vec<f32>,
}

impl Decode {
    fn new(linear: impl Fn(f64) -> f64) -> Self {
        let table = |most: u32| (0..=most).map(|i| linear(f64::from(i) / f64::from(most)) as f32).collect();
        Self { of_8_bits: table(255), of_16_bits: table(65_535) }
    }

    fn of(encoding: Encoding) -> &'static Self {
        static SRGB: LazyLock<Decode> = LazyLock::new(|| Decode::new(srgb_to_linear));
        static LINEAR: LazyLock<Decode> = LazyLock::new(|| Decode::new(|c| c));
        match encoding {
            Encoding::Srgb => &SRGB,
            Encoding::Linear => &LINEAR,
        }
    }

    /// Texel `i` as linear RGBA.
    #[inline(always)]
    fn texel(&self, level: &MipLevel, i: usize) -> Vec4 {
        let [r, g, b, a] = level.texels[i];
        let Some(low) = level.low.get(i) else {
            let of = |c: u8| self.of_8_bits[c as usize];
            return Vec4::new(of(r), of(g), of(b), f32::from(a) / 255.0);
        };
        let word = |high: u8, low: u8| u16::from_be_bytes([high, low]);
        let of = |high: u8, low: u8| self.of_16_bits[word(high, low) as usize];
        Vec4::new(of(r, low[0]), of(g, low[1]), of(b, low[2]), f32::from(word(a, low[3])) / 65_535.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const REPEAT: [Wrap; 2] = [Wrap::Repeat; 2];

    fn row(values: &[u8], encoding: Encoding) -> Texture {
        let texels = values.iter().map(|&v| [v, v, v, 255]).collect();
        Texture::new("row".into(), values.len(), 1, texels, encoding)
    }

    #[test]
    fn texel_centres_read_back() {
        let texture = row(&[0, 51, 102, 255], Encoding::Linear);
        for (i, value) in [0.0, 0.2, 0.4, 1.0].into_iter().enumerate() {
            let read = texture.sample(Vec2::new((i as f32 + 0.5) / 4.0, 0.5), REPEAT, 0.0);
            assert!((read.x - value).abs() < 1e-6, "{read}");
        }
    }

    #[test]
    fn sixteen_bits_are_kept() {
        let pixels = image::ImageBuffer::<image::Rgba<u16>, _>::from_fn(64, 64, |x, y| {
            image::Rgba([(x * 1000 + y) as u16, 32_768 + y as u16, 17, 65_535 - x as u16])
        });
        let mut file = Vec::new();
        pixels.write_to(&mut std::io::Cursor::new(&mut file), image::ImageFormat::Png).unwrap();
        let image = Image::decode(&file, Path::new("")).expect("it is a PNG file");
        let texture = Texture::of("deep".into(), image.clone(), Encoding::Linear);
        for (x, y, pixel) in pixels.enumerate_pixels() {
            let uv = Vec2::new((x as f32 + 0.5) / 64.0, (y as f32 + 0.5) / 64.0);
            let read = texture.sample(uv, REPEAT, 0.0).to_array().map(|c| (c * 65_535.0).round() as u16);
            assert_eq!(read, pixel.0, "({x}, {y})");
        }
        // The mean of 1000 x + y.
        let mean = texture.sample(Vec2::ZERO, REPEAT, 1e9).x * 65_535.0;
        assert!((mean - 31_531.5).abs() < 1.0, "{mean}");
        let colour = Texture::of("colour".into(), image, Encoding::Srgb).sample(Vec2::splat(0.5 / 64.0), REPEAT, 0.0);
        let half = (32_768.0f64 / 65_535.0 + 0.055) / 1.055;
        assert!((f64::from(colour.y) - half.powf(2.4)).abs() < 1e-6, "{colour}");
    }

    #[test]
    fn wraps() {
        let texture = row(&[0, 255], Encoding::Linear);
        let read = |u: f32, wrap| texture.sample(Vec2::new(u, 0.0), [wrap; 2], 0.0).x;
        assert_eq!(read(1.25, Wrap::Repeat), 0.0);
        assert_eq!(read(1.25, Wrap::Mirror), 1.0);
        assert_eq!(read(1.25, Wrap::Clamp), 1.0);
        assert_eq!(read(-0.25, Wrap::Repeat), 1.0);
        assert_eq!(read(-0.25, Wrap::Mirror), 0.0);
        assert_eq!(read(0.0, Wrap::Repeat), 0.5);
        assert_eq!(read(0.0, Wrap::Mirror), 0.0);
    }

    #[test]
    fn centers_of_texels_are_texels() {
        let texture = row(&[0, 255, 51], Encoding::Linear);
        for (u, want) in [(0.01, 0.0), (0.32, 0.0), (0.34, 1.0), (0.99, 0.2), (-0.01, 0.2), (7.4, 1.0)] {
            let got = texture.sample(texture.texel_center(Vec2::new(u, 0.3)), REPEAT, 0.0).x;
            assert!((got - want).abs() < 1e-5, "{u}: {got}, not {want}");
        }
    }

    #[test]
    fn odd_sides_keep_their_mean_in_linear_space() {
        let texture = row(&[255, 0, 0], Encoding::Srgb);
        let coarsest = texture.sample(Vec2::ZERO, REPEAT, 1e9).x;
        // Half an 8-bit step near 0.6 sRGB is 0.0025 in linear light.
        assert!((coarsest - 1.0 / 3.0).abs() < 0.0025, "{coarsest}");
    }

    #[test]
    fn wild_coordinates_read_something() {
        let texture = row(&[10, 20, 30, 40, 50], Encoding::Srgb);
        for u in [f32::NAN, f32::INFINITY, -1e38, 1e38, f32::MIN_POSITIVE, -f32::EPSILON, 1.0 - f32::EPSILON] {
            for wrap in [Wrap::Repeat, Wrap::Mirror, Wrap::Clamp] {
                for footprint in [0.0, f32::NAN, -1.0, 0.3, f32::INFINITY] {
                    assert!(texture.sample(Vec2::new(u, u), [wrap; 2], footprint).is_finite());
                }
            }
        }
    }
}

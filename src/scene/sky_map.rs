//! Environment maps: the radiance that arrives from each direction of the sphere, and directions drawn by it.
//!
//! Maps are equirectangular: at (x, y, z) they are read at u = atan2(x, -z) / 2 pi, v = acos(y) / pi, so the middle of
//! a map is +z and its right quarter -x. Radiance is interpolated bilinearly between the middles of texels.

use std::f64::consts::{PI, TAU};
use std::path::Path;
use std::sync::{LazyLock, OnceLock};

use glam::{DVec3, Vec3};
use image::ImageReader;
use image::codecs::hdr::HdrDecoder;

mod cube;
mod dome_map;
mod listing;
mod parts;
mod physical;

pub use self::cube::CubeFace;
pub use self::dome_map::DomeMap;
pub use self::listing::maps_in;
pub use self::parts::{SkyParts, Sun};
pub use self::physical::{PhysicalSky, TURBIDITY};

use super::texture::{TexelCount, srgb_to_linear};
use crate::error::{Error, Result};
use crate::image::{exr, luminance};
use crate::physics::distribution::{GridDistribution, GridPlace};

/// An environment map and its distribution.
pub struct SkyMap {
    texels: Texels,
    /// Its cells divide texels: within a cell, all directions are drawn with the same density.
    distribution: GridDistribution,
    /// Both are made when they are first needed.
    parts: OnceLock<SkyParts>,
    coarse: OnceLock<Texels>,
}

#[derive(Clone)]
struct Texels {
    width: usize,
    height: usize,
    /// Linear Rec. 709, row by row from the top.
    values: Vec<Vec3>,
}

/// A direction drawn from a map.
#[derive(Clone, Copy, Debug)]
pub struct SkyDirection {
    /// Unit, towards the sky, in the frame of the map.
    pub direction: DVec3,
    /// Density with which it is drawn, 1/sr.
    pub density: f64,
}

/// Finer maps are reduced by averages of blocks: twenty bytes a texel, 170 MB.
const MAX_WIDTH: usize = 4096;
/// Texels across [`SkyMap::blurred_at`]: 1.4 degrees each.
const BLURRED_WIDTH: usize = 256;
/// Cells across coarse maps.
const CELLS: usize = 1024;
/// Brightest texel: sums of all remain finite.
const MAX_RADIANCE: f32 = 1e30;
/// The largest number in half precision: what infinite texels were before they overflowed, or more.
const OVERFLOWED: f32 = 65_504.0;

impl SkyMap {
    /// White in all directions.
    pub fn white() -> &'static Self {
        static WHITE: LazyLock<SkyMap> =
            LazyLock::new(|| SkyMap::new(Texels { width: 1, height: 1, values: vec![Vec3::ONE] }));
        &WHITE
    }

    /// Reads an EXR, Radiance (HDR), PNG, JPEG or WebP file; the last three are sRGB. Channels that are negative or no
    /// number become black, infinite ones [`OVERFLOWED`].
    pub fn read(path: &Path, bytes: &[u8]) -> Result<Self> {
        let is_exr = bytes.starts_with(&[0x76, 0x2f, 0x31, 0x01]);
        let mut texels = if is_exr { read_exr(path)? } else { decode(path, bytes)? };
        let bad = clean(&mut texels.values);
        if bad > 0 {
            let path = path.display();
            tracing::warn!(
                "\"{path}\": {bad} texels are negative or no numbers, or infinite; they become 0 or {OVERFLOWED}"
            );
        }
        Ok(Self::new(reduced(texels, MAX_WIDTH)))
    }

    /// `texels`: at least one; finite and not negative.
    fn new(texels: Texels) -> Self {
        let cells_a_side = match texels.values.len() {
            1 => 1,
            _ => (CELLS / texels.width).min(CELLS / texels.height).max(1),
        };
        let size = [texels.width, texels.height].map(|side| side * cells_a_side);
        let solid_angles: Vec<f64> = (0..size[1]).map(|y| row_solid_angle(y, size[1])).collect();
        let weight = |x, y: usize| texels.brightness([x, y], cells_a_side) * solid_angles[y];
        let distribution = GridDistribution::new(size, weight);
        Self { texels, distribution, parts: OnceLock::new(), coarse: OnceLock::new() }
    }

    /// Radiance from a unit direction in the frame of the map.
    pub fn radiance(&self, direction: Vec3) -> Vec3 {
        self.radiance_at(Self::place(direction))
    }

    /// Radiance at a [place](Self::place); u may be beyond 1.
    pub fn radiance_at(&self, [u, v]: [f32; 2]) -> Vec3 {
        self.texels.interpolated(u * self.texels.width as f32, v * self.texels.height as f32)
    }

    /// Where maps are read for a unit direction: u from 0 to 1, v from 0 at the top to 1.
    pub fn place(direction: Vec3) -> [f32; 2] {
        const TURN: f32 = TAU as f32;
        let u = direction.x.atan2(-direction.z) / TURN;
        [if u < 0.0 { u + 1.0 } else { u }, direction.y.clamp(-1.0, 1.0).acos() / PI as f32]
    }

    /// Mean radiance around a [place](Self::place): for small pictures, in which the sun must not fall between two
    /// pixels.
    pub fn blurred_at(&self, [u, v]: [f32; 2]) -> Vec3 {
        let coarse = self.coarse.get_or_init(|| match self.texels.width > BLURRED_WIDTH {
            true => reduced(self.texels.halved(), BLURRED_WIDTH),
            false => self.texels.clone(),
        });
        coarse.interpolated(u * coarse.width as f32, v * coarse.height as f32)
    }

    /// Density with which [`Self::draw`] finds a unit direction in the frame of the map, 1/sr.
    pub fn density(&self, direction: Vec3) -> f64 {
        self.cell_density(self.grid_place(direction).cell)
    }

    /// Draws a direction with a density that follows the map's luminance. `[u, v]`: in the unit square; u leads
    /// downwards, so lattices become spherical lattices [Keinert 2015] under an even sky.
    pub fn draw(&self, at: [f64; 2]) -> SkyDirection {
        let GridPlace { cell: [x, y], within: [within_cell, within_row] } = self.distribution.draw(at);
        let [columns, rows] = self.distribution.size();
        let [top, bottom] = [y, y + 1].map(|edge| (PI * edge as f64 / rows as f64).cos());
        let cosine = top + (bottom - top) * within_row;
        let sine = (1.0 - cosine * cosine).max(0.0).sqrt();
        let (sin, cos) = (TAU * (x as f64 + within_cell) / columns as f64).sin_cos();
        SkyDirection { direction: DVec3::new(sine * sin, cosine, -sine * cos), density: self.cell_density([x, y]) }
    }

    /// The map in two parts that add up to it.
    pub fn parts(&self) -> &SkyParts {
        self.parts.get_or_init(|| SkyParts::new(&self.texels))
    }

    /// Where in the unit square [`Self::draw`] finds a unit direction in the frame of the map.
    pub fn drawn_at(&self, direction: Vec3) -> [f64; 2] {
        self.distribution.invert(&self.grid_place(direction))
    }

    fn grid_place(&self, direction: Vec3) -> GridPlace {
        let [u, v] = Self::place(direction);
        let [columns, rows] = self.distribution.size();
        let cell = [(u, columns), (v, rows)].map(|(at, count)| ((at * count as f32) as usize).min(count - 1));
        let [top, bottom] = [cell[1], cell[1] + 1].map(|edge| (PI * edge as f64 / rows as f64).cos());
        let within_cell = f64::from(u) * columns as f64 - cell[0] as f64;
        let within_row = (f64::from(direction.y) - top) / (bottom - top);
        GridPlace { cell, within: [within_cell, within_row].map(|t| t.clamp(0.0, 1.0)) }
    }

    fn cell_density(&self, cell: [usize; 2]) -> f64 {
        let [columns, rows] = self.distribution.size();
        self.distribution.share(cell) * columns as f64 / row_solid_angle(cell[1], rows)
    }
}

impl Texels {
    /// Mean luminance of a cell, of which `a_side` divide the side of a texel.
    fn brightness(&self, cell: [usize; 2], a_side: usize) -> f64 {
        let at = |axis: usize, offset: f32| (cell[axis] as f32 + offset) / a_side as f32;
        let corner = |i: usize| self.interpolated(at(0, [0.25, 0.75][i % 2]), at(1, [0.25, 0.75][i / 2]));
        0.25 * (0..4).map(|i| f64::from(luminance(corner(i).to_array()))).sum::<f64>()
    }

    /// Means of blocks of two by two, by solid angle. A last column or row without a partner is a block of its own.
    fn halved(&self) -> Self {
        let Self { width, height, values } = self;
        let halves = [*width, *height].map(|side| side.div_ceil(2));
        let row = |y: usize| {
            let rows = [2 * y, 2 * y + 1].map(|y| y.min(height - 1));
            let [upper, lower] = rows.map(|y| row_solid_angle(y, *height));
            let share_of_upper = (upper / (upper + lower)) as f32;
            let [upper, lower] = rows.map(|y| &values[y * width..][..*width]);
            (0..halves[0]).map(move |x| {
                let [left, right] = [2 * x, (2 * x + 1).min(width - 1)];
                let [upper, lower] = [upper, lower].map(|row| (row[left] + row[right]) / 2.0);
                lower.lerp(upper, share_of_upper)
            })
        };
        Self { width: halves[0], height: halves[1], values: (0..halves[1]).flat_map(row).collect() }
    }

    /// At a place in units of texels; x wraps around.
    fn interpolated(&self, x: f32, y: f32) -> Vec3 {
        let (x, y, width) = (x - 0.5, y - 0.5, self.width as f32);
        let x = x - (x / width).floor() * width;
        let x = if x < width { x } else { 0.0 }; // after rounding
        let ([x0, y0], [fx, fy]) = ([x.floor(), y.floor()], [x - x.floor(), y - y.floor()]);
        let left = x0 as usize;
        let right = if left + 1 < self.width { left + 1 } else { 0 };
        let row = |y: f32| (y.max(0.0) as usize).min(self.height - 1);
        let along = |y: f32| {
            let texels = &self.values[row(y) * self.width..][..self.width];
            texels[left].lerp(texels[right], fx)
        };
        along(y0).lerp(along(y0 + 1.0), fy)
    }
}

impl std::fmt::Debug for SkyMap {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        write!(f, "{}x{}", self.texels.width, self.texels.height)
    }
}

/// Of the row between two circles of latitude.
fn row_solid_angle(y: usize, height: usize) -> f64 {
    let [top, bottom] = [y, y + 1].map(|edge| PI * edge as f64 / height as f64);
    // The difference of their cosines without cancellation.
    TAU * 2.0 * ((top + bottom) / 2.0).sin() * ((bottom - top) / 2.0).sin()
}

fn read_exr(path: &Path) -> Result<Texels> {
    let mut image = exr::read(path)?;
    let layer = image.layers.iter().position(|layer| layer.name.is_empty()).unwrap_or(0);
    let pixels = image.layers.swap_remove(layer).pixels;
    let values = pixels.into_iter().map(Vec3::from_array).collect();
    Ok(Texels { width: image.width, height: image.height, values })
}

fn decode(path: &Path, bytes: &[u8]) -> Result<Texels> {
    // Radiance's format as other programs sign it (OpenCV, rgbe.c).
    let renamed = bytes.strip_prefix(b"#?RGBE").map(|rest| [b"#?RADIANCE", rest].concat());
    let bytes = renamed.as_deref().unwrap_or(bytes);
    TexelCount::default().add(bytes, path).map_err(|refusal| refusal.at(path, "the map"))?;
    let reader = ImageReader::new(std::io::Cursor::new(bytes)).with_guessed_format();
    let mut reader = reader.map_err(Error::io("read", path))?;
    reader.no_limits();
    let malformed = |cause| Error::import_from(path, "the map cannot be decoded", cause);
    // What the values of Radiance files were multiplied by.
    let header = HdrDecoder::new(std::io::Cursor::new(bytes)).ok().map(|decoder| decoder.metadata());
    let scale = header.map_or(Vec3::ONE, |header| {
        Vec3::from(header.color_correction.unwrap_or((1.0, 1.0, 1.0))) * header.exposure.unwrap_or(1.0)
    });
    let image = reader.decode().map_err(malformed)?;
    let is_linear = matches!(image, image::DynamicImage::ImageRgb32F(_) | image::DynamicImage::ImageRgba32F(_));
    let (width, height) = (image.width() as usize, image.height() as usize);
    let linear = |x: f32| if is_linear { x } else { srgb_to_linear(x.into()) as f32 };
    let values = image.into_rgb32f().pixels().map(|pixel| Vec3::from_array(pixel.0.map(linear)) / scale).collect();
    Ok(Texels { width, height, values })
}

/// Makes texels finite and not negative; returns how many were not.
fn clean(texels: &mut [Vec3]) -> usize {
    let channel = |x: f32| match x {
        f32::INFINITY => OVERFLOWED,
        x if x >= 0.0 => x.min(MAX_RADIANCE),
        _ => 0.0,
    };
    let mut bad = 0;
    for texel in texels {
        bad += usize::from(!(texel.is_finite() && texel.min_element() >= 0.0));
        *texel = Vec3::from_array(texel.to_array().map(channel));
    }
    bad
}

/// Halves a map until it is at most `most` texels wide.
fn reduced(mut texels: Texels, most: usize) -> Texels {
    while texels.width > most {
        texels = texels.halved();
    }
    texels
}

#[cfg(test)]
mod tests {
    use super::*;

    fn map(width: usize, height: usize, radiance: impl Fn(usize, usize) -> f32) -> SkyMap {
        let values = (0..width * height).map(|i| Vec3::splat(radiance(i % width, i / width))).collect();
        SkyMap::new(Texels { width, height, values })
    }

    #[test]
    fn the_middle_is_before_us_and_the_right_quarter_to_the_left() {
        let map = map(8, 4, |x, y| (8 * y + x) as f32);
        let near = |direction: Vec3, column: f32, row: f32| {
            let want = 8.0 * row + column;
            let got = map.radiance(direction.normalize()).x;
            assert!((got - want).abs() < 1e-3, "{direction}: {got}, want {want}");
        };
        near(Vec3::Z, 3.5, 1.5);
        near(Vec3::NEG_X, 5.5, 1.5);
        near(Vec3::X, 1.5, 1.5);
        near(Vec3::Y, 3.5, 0.0);
    }

    #[test]
    fn radiance_files_say_what_they_were_multiplied_by() {
        let pixels = [128, 128, 128, 129].repeat(8); // 1
        for (lines, want) in [("", 1.0), ("EXPOSURE=2\nEXPOSURE=4\n", 0.125), ("COLORCORR=2 2 2\n", 0.5)] {
            for mark in ["RADIANCE", "RGBE"] {
                let header = format!("#?{mark}\n{lines}FORMAT=32-bit_rle_rgbe\n\n-Y 2 +X 4\n");
                let file = [header.as_bytes(), &pixels].concat();
                let texels = decode(Path::new("a.hdr"), &file).unwrap();
                assert!(
                    texels.values.iter().all(|&value| value == Vec3::splat(want)),
                    "{header}: {}",
                    texels.values[0]
                );
            }
        }
    }

    #[test]
    fn small_pictures_show_means_and_where_they_are() {
        let map = map(1024, 512, |x, y| if (x, y) == (513, 255) { 64.0 } else { 0.0 });
        // In 256 x 128 the texel has a sixteenth of the light; between four texels, a quarter of that.
        let near = |uv: [f32; 2], want: f32| {
            let got = map.blurred_at(uv).x;
            assert!((got - want).abs() < 0.01, "{uv:?}: {got}, want {want}");
        };
        near([128.5 / 256.0, 63.5 / 128.0], 4.0);
        near([129.0 / 256.0, 64.0 / 128.0], 1.0);
        near([0.25, 0.5], 0.0);
    }

    #[test]
    fn bad_texels_are_black_or_bright_and_spoil_no_others() {
        let mut texels = [Vec3::new(f32::NAN, -1.0, 2.0), Vec3::new(f32::INFINITY, f32::NEG_INFINITY, 0.0), Vec3::ONE];
        assert_eq!(clean(&mut texels), 2);
        assert_eq!(texels, [Vec3::new(0.0, 0.0, 2.0), Vec3::new(OVERFLOWED, 0.0, 0.0), Vec3::ONE]);
    }

    /// Rows at the poles are small.
    #[test]
    fn halved_maps_have_all_the_light() {
        for bright in [0, 1, 2, 3, 15] {
            let values = (0..32 * 16).map(|i| Vec3::splat(if i / 32 == bright { 1.0 } else { 0.0 })).collect();
            let whole = Texels { width: 32, height: 16, values };
            let [light, of_half] = [&whole, &whole.halved()].map(|texels| {
                let of_texel = |i: usize| f64::from(texels.values[i].x) * texels.solid_angle(i);
                (0..texels.values.len()).map(of_texel).sum::<f64>()
            });
            assert!((of_half / light - 1.0).abs() < 1e-6, "row {bright}: {of_half}, want {light}");
        }
    }

    #[test]
    fn wide_maps_are_halved_whatever_their_sides() {
        for (width, height, want) in [(4096, 3, (4096, 3)), (8192, 2, (4096, 1)), (8193, 3, (2049, 1))] {
            let reduced = reduced(Texels { width, height, values: vec![Vec3::ONE; width * height] }, MAX_WIDTH);
            assert_eq!((reduced.width, reduced.height), want);
            assert_eq!(reduced.values, vec![Vec3::ONE; want.0 * want.1]);
        }
    }

    #[test]
    fn drawn_directions_have_the_density_that_is_told() {
        let bright = map(16, 8, |x, y| if (x, y) == (3, 2) { 1000.0 } else { (x % 3) as f32 });
        for map in [bright, map(1, 1, |_, _| 2.0), map(7, 3, |_, _| 0.0), map(1, 9, |_, y| y as f32)] {
            let (mut light, mut ones) = (0.0, 0.0);
            for i in 0..4096 {
                let along = f64::from(i) + 0.5;
                let drawn = map.draw([along / 4096.0, (along * 0.618_033_988_749_894_9).fract()]);
                let direction = drawn.direction.as_vec3();
                assert!((drawn.direction.length() - 1.0).abs() < 1e-12);
                let told = map.density(direction * 0.999_999);
                let back = map.drawn_at(direction);
                // Coordinates in single precision.
                let again = map.draw(back).direction.as_vec3();
                assert!(again.distance(direction) < 1e-5, "{map:?}: {direction} is drawn at {back:?}: {again}");
                // At edges, rounding leads to the neighbour.
                ones += f64::from(u8::from((told / drawn.density - 1.0).abs() < 1e-6)) / 4096.0;
                light += f64::from(map.radiance(direction).x) / drawn.density / 4096.0;
            }
            assert!(ones > 0.99, "{map:?}: {ones}");
            // Midpoint rule over the sphere.
            let place = |i: u32| [f64::from(i % 512) / 512.0, f64::from(i / 512) / 512.0].map(|x| x + 0.5 / 512.0);
            let want = (0..1 << 18).map(place).map(|[u, v]| {
                let (sin, cos) = (TAU * u).sin_cos();
                let direction = DVec3::new((PI * v).sin() * sin, (PI * v).cos(), -(PI * v).sin() * cos).as_vec3();
                f64::from(map.radiance(direction).x) * (PI * v).sin() * PI * TAU / f64::from(1 << 18)
            });
            let want: f64 = want.sum();
            assert!((light - want).abs() <= 0.01 * want, "{map:?}: {light}, want {want}");
        }
    }
}

//! The device memory that a [`Relighter`](super::Relighter) takes whatever its budget, from counts that are known
//! before a bake; and whether a device has room for it.

use glam::UVec2;

use super::light_cache::LightCache;
use super::visibility;
use super::{Site, batch_size};
use crate::bake::brdf_factors::HarmonicProjection;
use crate::bake::framebuffer::view_samples::Tiling;
use crate::bake::gather_samples::light_rays::RAYS;
use crate::bake::transport::{max_coefficients, sky};
use crate::gpu::DeviceInfo;
use crate::gpu::frame::UPLOAD_BYTES;
use crate::shared::*;
use crate::trace::bvh::TracedScene;
use crate::trace::packet::PACKET_SIZE;

/// Counts that determine the buffers of a relighter.
#[derive(Clone, Copy, Debug)]
pub struct Footprint {
    /// Width and height of the picture, pixels.
    pub size: [u32; 2],
    /// View samples beyond one for each pixel.
    pub extra_samples: usize,
    pub brdfs: usize,
    /// Emitters that are seen.
    pub emitters: usize,
    pub lights: usize,
    /// Whether any light has a size.
    pub sizes: bool,
    /// Whether any light is a dome.
    pub domes: bool,
    /// Whether any light has a filter, or links that scale its light.
    pub factors: bool,
    /// `None` without indirect light.
    pub gather: Option<GatherFootprint>,
    /// `None` if shadow rays are traced.
    pub maps: Option<MapFootprint>,
}

/// Counts of a transfer that is yet to be baked.
#[derive(Clone, Copy, Debug)]
pub struct GatherFootprint {
    pub samples: usize,
    pub points_per_sample: usize,
    /// Maximum functions of a sample.
    pub functions: usize,
    pub site: Site,
}

/// Shadow maps and what is drawn into them.
#[derive(Clone, Copy, Debug)]
pub struct MapFootprint {
    /// Side of a shadow map, texels.
    pub side: u32,
    pub vertices: usize,
    pub triangles: usize,
    /// Those with alpha.
    pub masked_triangles: usize,
}

/// What the size of a part follows from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Cause {
    Pixels,
    Gather,
    Maps,
    /// Nothing that the user can choose.
    Program,
}

/// Buffers, or the image of the shadow maps.
struct Part {
    what: &'static str,
    /// Of one buffer.
    bytes: u64,
    /// Number of buffers in device memory outside the budget; 0: within the budget or in host memory.
    count: u64,
    cause: Cause,
    is_buffer: bool,
}

/// Why a relighter does not fit a device.
enum Misfit {
    Part(Part),
    /// The largest image side, or the largest index of a vertex.
    Maps(String),
    /// Bytes of all parts together.
    All(u64),
}

const DEPTH_BYTES: u64 = 4;
const FACES: u64 = 6;
/// The smallest block that the allocator shares among small buffers.
const BLOCK_BYTES: u64 = 4 << 20;

impl Part {
    /// Bytes that the device allows.
    fn most(&self, device: &DeviceInfo) -> u64 {
        if self.is_buffer { device.limits.largest_buffer() } else { device.limits.allocation_bytes }
    }

    fn fits(&self, device: &DeviceInfo) -> bool {
        self.bytes <= self.most(device)
    }
}

impl MapFootprint {
    /// `side`: of a shadow map, texels.
    pub fn new(scene: &TracedScene, side: u32) -> Self {
        let triangles = scene.mesh.triangles.len();
        let masked_triangles = (0..triangles as u32).filter(|&triangle| scene.is_masked(triangle)).count();
        Self { side, vertices: scene.mesh.positions.len(), triangles, masked_triangles }
    }
}

impl Footprint {
    fn pixels(&self) -> usize {
        Tiling { width: self.size[0], height: self.size[1] }.len()
    }

    fn parts(&self) -> Vec<Part> {
        let (pixels, extras) = (self.pixels(), self.extra_samples);
        let view_samples = pixels + extras;
        let blocks = Part {
            what: "the allocator's blocks",
            bytes: BLOCK_BYTES,
            count: 2,
            cause: Cause::Program,
            is_buffer: false,
        };
        let mut parts = vec![blocks];
        let mut part = |what, cause, bytes: usize, count: usize| {
            parts.push(Part { what, bytes: bytes as u64, count: count as u64, cause, is_buffer: true });
        };
        part("data of a frame", Cause::Program, UPLOAD_BYTES, 1);
        part("view samples", Cause::Pixels, size_of::<ViewSample>() * view_samples, 1);
        part("BRDFs", Cause::Pixels, size_of::<Brdf>() * self.brdfs, 1);
        part("extra view samples", Cause::Pixels, size_of::<ExtraSample>() * extras, 1);
        part("pixels with extra view samples", Cause::Pixels, size_of::<ExtraPixel>() * extras, 1);
        part("indices of extra view samples", Cause::Pixels, size_of::<u32>() * extras, 1);
        part("radiance of extra view samples", Cause::Pixels, 12 * extras, batch_size(self.lights));
        let images = LightCache::slot_range(self.lights).0 + 1 + self.emitters + 2 * usize::from(self.sizes);
        part("a light image", Cause::Pixels, 12 * pixels, images);
        part("a picture", Cause::Pixels, 4 * pixels, 1);
        let packed = |samples: usize| samples.next_multiple_of(PACKET_SIZE);
        part("visibility", Cause::Pixels, packed(view_samples), visibility::BUFFERS);
        let filtered = if self.factors { visibility::BUFFERS - 1 } else { 0 };
        part("light factors", Cause::Pixels, size_of::<UVec2>() * view_samples, filtered);
        if let Some(GatherFootprint { samples, points_per_sample, functions, site }) = self.gather {
            let points = samples * points_per_sample;
            let coefficients = max_coefficients(samples, functions);
            part("gather samples", Cause::Gather, size_of::<LightSample>() * samples, 1);
            part("points of gather samples", Cause::Gather, size_of::<ViewSample>() * points, 1);
            part("tables of gather samples", Cause::Program, 4 * HarmonicProjection::TABLE_LENGTH, 1);
            part("visibility of gather samples", Cause::Gather, packed(points), visibility::BUFFERS);
            part("light factors at gather samples", Cause::Gather, size_of::<UVec2>() * points, filtered);
            let hits = RAYS.min(samples) * functions;
            part("light rays", Cause::Gather, size_of::<Contribution>() * hits, visibility::BUFFERS);
            // Of one light: direct and bounced light of gather samples; two ranks a block of the nested form, each at
            // most its number of rows.
            part("the light of gather samples", Cause::Pixels, 16 * 2 * (coefficients + view_samples), 1);
            if self.domes {
                part("light of the sky", Cause::Pixels, 16 * (sky::COLUMNS + 2 * view_samples), 1);
            }
            if site == Site::Device {
                // The Haar transform has a rotation and two indices a coefficient.
                part("the Haar transform", Cause::Gather, (size_of::<Rotation>() + 8) * coefficients, 1);
                // Factors of R, G and B in float16, a tint and an index for each column: of a panel, which is not
                // divided.
                part("a panel of the transfer", Cause::Gather, (6 * PANEL_ROWS as usize + 16) * coefficients, 0);
            }
        }
        if let Some(MapFootprint { side, vertices, triangles, masked_triangles }) = self.maps {
            part("vertices of shadow casters", Cause::Maps, 12 * vertices, 1);
            part("indices of shadow casters", Cause::Maps, 12 * (triangles - masked_triangles), 1);
            part("cut-out shadow casters", Cause::Maps, 3 * size_of::<CutoutCorner>() * masked_triangles, 1);
            let bytes = FACES * DEPTH_BYTES * u64::from(side).pow(2);
            parts.push(Part { what: "shadow maps", bytes, count: 1, cause: Cause::Maps, is_buffer: false });
        }
        parts
    }

    /// Bytes of all parts in device memory.
    pub fn total_bytes(&self) -> u64 {
        self.parts().iter().map(|part| part.bytes * part.count).sum()
    }

    fn bytes_of(&self, cause: Cause) -> u64 {
        self.parts().iter().filter(|part| part.cause == cause).map(|part| part.bytes * part.count).sum()
    }

    /// Why `device` has no room, and what would have: for people. `None` if it has.
    pub fn refusal(&self, device: &DeviceInfo) -> Option<String> {
        let name = &device.name;
        let [width, height] = self.size;
        let misfit = self.misfit(device)?;
        let is_part = matches!(misfit, Misfit::Part(_));
        let (reason, causes) = match misfit {
            Misfit::Part(part) => {
                let Part { what, bytes, cause, .. } = part;
                let of = match (cause, self.gather) {
                    (Cause::Pixels, _) => format!(" of {width}x{height} pixels"),
                    (Cause::Gather, Some(gather)) => format!(", for {} gather samples,", gather.samples),
                    _ => String::new(),
                };
                let most = amount(part.most(device));
                (format!("{what}{of} take {} in one piece, but {name} allows {most}", amount(bytes)), vec![cause])
            }
            Misfit::Maps(reason) => (format!("{reason} on {name}"), vec![Cause::Maps]),
            Misfit::All(bytes) => {
                let mut causes = vec![Cause::Pixels, Cause::Gather, Cause::Maps];
                causes.sort_by_key(|&cause| std::cmp::Reverse(self.bytes_of(cause)));
                let (lights, usable) = (self.lights, amount(device.usable_bytes()));
                let all = amount(bytes);
                let reason = format!(
                    "{width}x{height} pixels with {lights} lights take {all} of device memory, but {name} has {usable} to use"
                );
                (reason, causes)
            }
        };
        let remedy = causes.into_iter().find_map(|cause| {
            // Parts of another cause that do not fit are told next.
            let of_cause = |part: &Part| part.cause != cause || part.fits(device);
            match is_part {
                true => self.remedy(cause, &|other| other.parts().iter().all(of_cause)),
                false => self.remedy(cause, &|other| other.misfit(device).is_none()),
            }
        });
        let other = || "choose another --device; `relume devices` lists them".into();
        Some(format!("{reason}; {}", remedy.unwrap_or_else(other)))
    }

    fn misfit(&self, device: &DeviceInfo) -> Option<Misfit> {
        if let Some(part) = self.parts().into_iter().find(|part| !part.fits(device)) {
            return Some(Misfit::Part(part));
        }
        if let Some(MapFootprint { side, vertices, .. }) = self.maps {
            let (most, last) = (device.limits.image_side, device.limits.vertex_index);
            if side > most {
                let reason = format!("shadow maps of {side}x{side} texels are larger than {most}x{most}");
                return Some(Misfit::Maps(reason));
            }
            if vertices > last as usize + 1 {
                return Some(Misfit::Maps(format!("{vertices} vertices are more than shadow maps can draw")));
            }
        }
        let bytes = self.total_bytes();
        (bytes > device.usable_bytes()).then_some(Misfit::All(bytes))
    }

    /// The largest value of an option with which the footprint `fits`.
    fn remedy(&self, cause: Cause, fits: &dyn Fn(&Self) -> bool) -> Option<String> {
        // Below one that does not fit.
        let largest = |mut unfit: u32, with: &dyn Fn(u32) -> Self| {
            let mut fitting = 0;
            while unfit - fitting > 1 {
                let middle = fitting + (unfit - fitting) / 2;
                match fits(&with(middle)) {
                    true => fitting = middle,
                    false => unfit = middle,
                }
            }
            (fitting > 0).then_some(fitting)
        };
        match cause {
            Cause::Pixels => {
                let longest = self.size[0].max(self.size[1]);
                let fitting = largest(longest, &|side| self.resized(side))?;
                let [width, height] = self.resized(fitting).size;
                let or = if self.extra_samples > 0 { ", or fewer --samples or --layers" } else { "" };
                Some(format!("choose --size {width}x{height} or a smaller one{or}"))
            }
            Cause::Gather => {
                let gather = self.gather?;
                let with = |samples: u32| {
                    let samples = samples as usize;
                    Self { gather: Some(GatherFootprint { samples, ..gather }), ..*self }
                };
                let fitting = largest(u32::try_from(gather.samples).unwrap_or(u32::MAX), &with)?;
                Some(format!("choose --gather {fitting} or a smaller one"))
            }
            Cause::Maps => {
                let maps = self.maps?;
                let with = |side: u32| Self { maps: Some(MapFootprint { side, ..maps }), ..*self };
                let fitting =
                    largest(maps.side, &with).map(|side| format!("--shadow-size {side} or a smaller one, or "));
                let traced = Self { maps: None, ..*self };
                fits(&traced).then(|| format!("choose {}--visibility traced", fitting.unwrap_or_default()))
            }
            Cause::Program => None,
        }
    }

    /// With a picture of the same shape whose longest side is `longest`.
    fn resized(&self, longest: u32) -> Self {
        let old = self.size[0].max(self.size[1]);
        let size = self.size.map(|side| (u64::from(side) * u64::from(longest) / u64::from(old)).max(1) as u32);
        let resized = Self { size, ..*self };
        let area = resized.pixels() as f64 / self.pixels() as f64;
        let [extra_samples, brdfs] =
            [self.extra_samples, self.brdfs].map(|count| (area * count as f64).ceil() as usize);
        Self { extra_samples, brdfs, ..resized }
    }
}

/// Bytes of all images of `lights` lights in a picture of `pixels`, padded, and of the fewest that work.
pub fn light_image_bytes(lights: usize, pixels: usize) -> [u64; 2] {
    let (fewest, all) = LightCache::slot_range(lights);
    [all, fewest].map(|images| 12 * (images * pixels) as u64)
}

/// For people.
fn amount(bytes: u64) -> String {
    match bytes {
        1_000_000_000.. => format!("{:.2} GB", bytes as f64 * 1e-9),
        1_000_000.. => format!("{:.1} MB", bytes as f64 * 1e-6),
        _ => format!("{:.1} kB", bytes as f64 * 1e-3),
    }
}

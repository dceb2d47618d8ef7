//! Constants and structs shared by Rust and GLSL: view samples, BRDFs, lights, push constants.

pub mod gpu_struct;

use glam::{Mat4, UVec2, UVec4, Vec2, Vec3, Vec4};

use self::gpu_struct::{Exchange, Read, Write, gpu_shared};

gpu_shared! {
    constants {
        /// Threads in a workgroup of every kernel: one tile of pixels, and a whole number of subgroups everywhere.
        pub const GROUP_SIZE: u32 = 64;
        /// Workgroups in the first dimension of a dispatch: Vulkan guarantees 65,535.
        pub const MAX_COLUMNS: u32 = 1 << 15;
        /// Side of a tile of pixels. Images and layer 1 are stored tile by tile, so that the 64 samples of a ray packet
        /// or of a workgroup, and the samples of a cache line, are neighbours in the picture.
        pub const TILE_SIZE: u32 = 8;
        /// [`ViewSample::brdf`] of a sample that reflects no light directly: background, perfect mirror.
        pub const NO_BRDF: u32 = 0xffff_ffff;

        /// [`PackedLight::kind`]
        pub const LIGHT_POINT: u32 = 0;
        /// [`PackedLight::kind`]
        pub const LIGHT_SPOT: u32 = 1;
        /// [`PackedLight::kind`]
        pub const LIGHT_DIRECTIONAL: u32 = 2;
        /// [`PackedLight::kind`]: a small part of a surface, which emits around `direction`.
        pub const LIGHT_FACET: u32 = 3;
        /// [`PackedLight::kind`]: a facet that emits around the opposite direction too.
        pub const LIGHT_TWO_SIDED_FACET: u32 = 4;

        /// [`ShadeGatherPush::flags`]
        pub const ACCUMULATE: u32 = 1;
        /// [`ShadeGatherPush::flags`]
        pub const HAS_FACTORS: u32 = 2;

        /// [`ShadeSoftConstants::shape`]
        pub const SHAPE_BALL: u32 = 0;
        /// [`ShadeSoftConstants::shape`]
        pub const SHAPE_SPOT: u32 = 1;
        /// [`ShadeSoftConstants::shape`]
        pub const SHAPE_SUN: u32 = 2;
        /// [`ShadeSoftConstants::shape`]
        pub const SHAPE_DISK: u32 = 3;
        /// [`ShadeSoftConstants::shape`]
        pub const SHAPE_RECT: u32 = 4;
        /// [`ShadeSoftConstants::shape`]
        pub const SHAPE_DOME: u32 = 5;
        /// Points of an area light that moves: each sample sees one of them.
        pub const SOFT_POINTS: u32 = 64;
        /// [`Cutout::first`] without a texture.
        pub const NO_TEXELS: u32 = 0xffff_ffff;
        /// [`Cutout::wrap_u`]
        pub const WRAP_REPEAT: u32 = 0;
        /// [`Cutout::wrap_u`]
        pub const WRAP_MIRROR: u32 = 1;
        /// [`Cutout::wrap_u`]
        pub const WRAP_CLAMP: u32 = 2;

        /// Maximum number of images that a pass sums; limited by the size of push constants.
        pub const MAX_TERMS: u32 = 4;

        /// Maximum rows of a [`Panel`].
        pub const PANEL_ROWS: u32 = 256;
        /// Rows of a panel whose factors are contiguous, so that the reads of neighbouring threads are sequential.
        pub const STRIP_ROWS: u32 = 32;
        /// Columns of a column group, the unit of one read: 16 bytes of float16.
        pub const PANEL_COLUMNS: u32 = 8;

        /// Maximum number of degrees of the harmonics that represent light at a gather sample.
        pub const HARMONIC_DEGREES: u32 = 7;
        /// Texels along each side of the map of directions to a disc [Yang 2007, Figure 4.2 b].
        pub const DISC_SIDE: u32 = 32;
        /// Maximum number of lights that one pass of the transfer processes together.
        pub const MAX_LIGHTS_PER_PASS: u32 = 4;
        /// Rows of the tables of k, over roughness.
        pub const TABLE_ROUGHNESSES: u32 = 25;
        /// Columns of the tables of k, over the square root of the cosine.
        pub const TABLE_COSINES: u32 = 81;

        /// Composite writes scene-linear float RGB.
        pub const OUTPUT_LINEAR: u32 = 0;
        /// Composite writes 8-bit sRGB, clamped.
        pub const OUTPUT_CLAMPED: u32 = 1;
        /// Composite writes 8-bit sRGB through AgX.
        pub const OUTPUT_AGX: u32 = 2;
        /// Composite writes 8-bit sRGB through Khronos PBR Neutral.
        pub const OUTPUT_PBR_NEUTRAL: u32 = 3;
        /// Composite writes 8-bit sRGB: [`STOP_COLORS`] by luminance.
        pub const OUTPUT_FALSE_COLOR: u32 = 4;
        /// Composite writes 8-bit values of a display, from a [`DISPLAY_TABLE_SIDE`]³ table.
        pub const OUTPUT_TABLE: u32 = 5;
        /// Number of `OUTPUT_` constants.
        pub const OUTPUT_COUNT: u32 = 6;

        /// Entries along each axis of the table of a display, from 0 to [`DISPLAY_TABLE_END`] of exposed radiance. With
        /// 65, 99 % of plausible colours through ACES 2 are within a third of an 8-bit code; with 97, within a fifth.
        pub const DISPLAY_TABLE_SIDE: u32 = 65;

        /// Number of false-colour bands; each is one stop wide.
        pub const STOP_COUNT: u32 = 16;
        /// The band whose centre is middle grey.
        pub const MIDDLE_STOP: u32 = 8;
        /// Bins of a luminance histogram. The first and last bin count what is darker or brighter than all others.
        pub const HISTOGRAM_BINS: u32 = 66;
        /// Bins per stop.
        pub const BINS_PER_STOP: u32 = 4;
        /// Tiles that a workgroup of inspect.comp counts in shared memory before it adds to the histogram.
        pub const TILES_PER_GROUP: u32 = 16;
    }

    floats {
        /// Lobes with a smaller alpha (roughness 0.3) are narrow: area lights are found by directions drawn from
        /// them, too, as their highlights would show the points of the light.
        pub const NARROW_ALPHA: f32 = 0.09;
        /// Maximum albedo of a gather sample for light from any direction: the albedo of glTF's BRDF exceeds 1 near
        /// grazing angles. At this value single precision resolves 1 - albedo to a relative error of 0.001.
        pub const ALBEDO_CAP: f32 = 0.9999;
        /// Directions drawn from a narrow lobe for each point of an area light that moves, where it shades such a
        /// lobe.
        pub const DIRECTIONS_PER_POINT: f32 = 0.25;
        /// Scene-linear luminance of middle grey.
        pub const MIDDLE_GREY: f32 = 0.18;
        /// Exposed radiance of the last entry of the table of a display, 11.5 stops above middle grey. Brighter light
        /// is clamped to it.
        pub const DISPLAY_TABLE_END: f32 = 512.0;
        /// Entries of the table are spaced evenly in log2(1 + radiance / this): logarithmic, but linear near black.
        pub const DISPLAY_TABLE_TOE: f32 = 0.005;
        /// Share of a light's power at which a point of a gather sample and light rays have equal weight. Below half of
        /// it only the point counts, above 1.5 times it only the rays (docs/method.md, "Light rays").
        pub const EVEN_SHARE: f32 = 0.00390625;
    }

    tables {
        /// False colour of each band, sRGB with red in the lowest byte. Middle grey is grey, lower bands are violet to
        /// teal, higher ones green to red and white. The first and last band also cover what is darker or brighter.
        pub const STOP_COLORS: [u32; 16] = [
            0x14000a, 0x4a0a2a, 0x8c1246, 0xc82f3a, 0xe05b2a, 0xd68a1f, 0xb8ae17, 0x869e1e,
            0x808080, 0x24c06c, 0x1ecfb8, 0x0fc8f2, 0x1494f5, 0x1955ee, 0x241cdd, 0xffffff,
        ];
    }

    specializations {
        /// Constants of shade_light.comp.
        pub struct ShadeLightConstants {
            /// Whether any BRDF of the scene has a specular lobe.
            pub specular: bool = true,
        }

        /// Constants of shade_soft.comp.
        pub struct ShadeSoftConstants {
            /// Whether any BRDF of the scene has a specular lobe.
            pub specular: bool = true,
            /// One of the `SHAPE_` constants.
            pub shape: u32 = SHAPE_RECT,
            /// Whether `factors` multiply the light.
            pub factors: bool = false,
        }

        /// Constants of shade_gather.comp.
        pub struct ShadeGatherConstants {
            /// Maximum number of degrees of any sample.
            pub degrees: u32 = HARMONIC_DEGREES,
            /// Points per sample.
            pub points_per_sample: u32 = 8,
            /// Whether each point sees another point of the light.
            pub soft: bool = false,
        }

        /// Constants of shade_factored.comp.
        pub struct ShadeFactoredConstants {
            /// As [`ShadeGatherConstants::soft`].
            pub soft: bool = false,
        }

        /// Constants of multiply_blocks.comp.
        pub struct MultiplyBlocksConstants {
            /// 3: the first columns have separate factors for R, G and B, the others shared factors and an RGB tint of
            /// their input. 1: R, G and B share all factors.
            pub channels: u32 = 1,
            /// Whether results are added to the radiance of view samples; else they are written to the vector.
            pub to_view_samples: bool = false,
            /// Number of interleaved vectors, which share one read of the factors.
            pub lights: u32 = 1,
            /// Whether each [`PANEL_COLUMNS`] neighbouring threads are in one subgroup, which shares what each of them
            /// read.
            pub wide: bool = false,
        }

        /// Constants of kernels that process the vectors of several lights.
        pub struct LightsConstants {
            /// Number of interleaved vectors.
            pub lights: u32 = 1,
        }

        /// Constants of kernels that write pixels.
        pub struct OutputConstants {
            /// One of the `OUTPUT_` constants.
            pub output: u32 = OUTPUT_LINEAR,
        }

        /// Constants of inspect.comp.
        pub struct InspectConstants {
            /// Whether to compute a histogram of all pixels; else the radiance of one pixel.
            pub histogram: bool = true,
        }

        /// Constants of fit.comp.
        pub struct FitConstants {
            /// Whether the picture shrinks along either axis.
            pub shrinks: bool = false,
        }
    }

    structs {
        /// A surface point that the camera sees, directly or through mirrors; mesh space.
        pub struct ViewSample {
            /// Mesh space.
            pub position: Vec3,
            /// Index of its [`Brdf`], or [`NO_BRDF`].
            pub brdf: u32,
            /// Unit shading normal, octahedral.
            pub normal: Vec2,
            /// Unit direction towards the eye or the mirror that sees it, octahedral.
            pub wo: Vec2,
        }

        /// glTF's BRDF with its parameters multiplied out [glTF 2.0, Appendix B].
        ///
        /// f = diffuse/pi (1 - F_d) + (f0 + (f90 - f0) s) V D with s = (1 - v.h)^5 and
        /// F_d = dielectric_f0 + (dielectric_f90 - dielectric_f0) s, the dielectric part's Fresnel term.
        pub struct Brdf {
            /// Base colour times (1 - metallic).
            pub diffuse: Vec3,
            /// GGX alpha, roughness squared. 0: no specular lobe here; the mirror reflection is in deeper layers.
            pub alpha: f32,
            /// Normal-incidence reflectance, dielectric and metal mixed.
            pub f0: Vec3,
            /// Grazing reflectance, dielectric and metal mixed.
            pub f90: f32,
            /// Largest channel of the dielectric part's normal-incidence reflectance.
            pub dielectric_f0: f32,
            /// The dielectric part's grazing reflectance.
            pub dielectric_f90: f32,
        }

        /// A light at unit intensity in mesh space.
        pub struct PackedLight {
            /// Mesh space. Of a directional light its colour: white, but of a direction of a dome, with 1 in the
            /// greatest channel.
            pub position: Vec3,
            /// One of the `LIGHT_` constants.
            pub kind: u32,
            /// Unit, the direction in which the light travels; a facet's normal.
            pub direction: Vec3,
            /// 1/range in mesh space; 0: no range.
            pub inverse_range: f32,
            /// 1 / max(0.001, cos inner - cos outer) [KHR_lights_punctual].
            pub cone_scale: f32,
            /// 1 - cos outer, compared with 1 - cos of the angle off the axis; accurate for narrow cones.
            pub cone_versine: f32,
            /// Facet: 1 / tan of half its spread. Directional light: what it adds to the squared alpha of lobes, as if
            /// it had a size.
            pub narrowing: f32,
            /// Within this squared distance light does not increase any more; mesh space. Facet: at least the squared
            /// radius of a disk of its area. Of a direction of a dome: 1 / the density with which it was drawn, sr.
            pub squared_radius: f32,
            /// Irradiance at normal incidence, at one unit of mesh space unless the light is directional.
            pub strength: f32,
        }

        /// Weight and layer of an extra view sample: one in a deeper layer than 1, or not the first of its pixel.
        pub struct ExtraSample {
            /// RGB weight in the pixel: reflectance and coverage along the mirror path, divided by samples per pixel.
            pub weight: Vec3,
            /// Layer of the deep framebuffer, from 0.
            pub layer: u32,
        }

        /// A pixel with extra samples.
        pub struct ExtraPixel {
            /// Pixel in tile order.
            pub pixel: u32,
            /// Start of its list of extra samples.
            pub first: u32,
            /// Length of that list.
            pub count: u32,
            /// Weight of the pixel's first sample: 1 / samples per pixel, times its coverage if it blends.
            pub first_weight: f32,
        }

        /// Projection of one face of a light's shadow map.
        pub struct ShadowFace {
            /// Reversed depth: 1 at the near plane, 0 at infinity.
            pub clip_from_mesh: Mat4,
        }

        /// A corner of a triangle with alpha.
        pub struct CutoutCorner {
            /// Mesh space.
            pub position: Vec3,
            /// Alpha before it is multiplied by the texture's.
            pub alpha: f32,
            /// Texture coordinates.
            pub uv: Vec2,
            /// Index of its [`Cutout`].
            pub cutout: u32,
        }

        /// Alpha texture and cutoff of a material.
        pub struct Cutout {
            /// Index of its texture's first texel, or [`NO_TEXELS`].
            pub first: u32,
            /// Texels.
            pub width: u32,
            /// Texels.
            pub height: u32,
            /// One of the `WRAP_` constants, along u.
            pub wrap_u: u32,
            /// The same along v.
            pub wrap_v: u32,
            /// Alpha from which the surface is opaque; negative: the material blends.
            pub cutoff: f32,
        }

        /// One term of a sum of images.
        pub struct SumTerm {
            /// Planes R, G, B.
            pub image: Read<Vec4>,
            /// Factor on each plane.
            pub scale: Vec3,
            /// Padding to a multiple of eight bytes.
            pub unused: u32,
        }

        pub push ShadeLightPush for shade_light(ShadeLightConstants) {
            /// View samples, layer 1 first.
            pub samples: Read<ViewSample>,
            /// Indexed by [`ViewSample::brdf`].
            pub brdfs: Read<Brdf>,
            /// Fraction of the light that each sample sees, 8 bits each, four per word.
            pub visibility: Read<u32>,
            /// Factor on the light that reaches each sample: RGB in half precision; read if `has_factors`.
            pub factors: Read<UVec2>,
            /// Planes R, G, B of `pixel_stride` floats: the light's image.
            pub image: Write<f32>,
            /// Planes R, G, B of `extra_stride` floats: radiance of the extra samples.
            pub extras: Write<f32>,
            /// At unit intensity.
            pub light: PackedLight,
            /// Number of view samples.
            pub sample_count: u32,
            /// Samples of layer 1: pixels padded to whole tiles.
            pub pixel_stride: u32,
            /// Number of extra samples, padded to a multiple of 4.
            pub extra_stride: u32,
            /// Bit l: layer l is shown. Layer 0 needs bit 0, extra samples any bit: resolve.comp selects their layers.
            pub layers: u32,
            /// Whether to add to `image` and `extras`.
            pub accumulate: u32,
            /// Whether `factors` multiply the light.
            pub has_factors: u32,
            /// Area of the light that one direction drawn from a narrow lobe stands for: area (of suns solid angle)
            /// times the number of such directions, over that of points. 0: none are drawn.
            pub drawn_area: f32,
        }

        pub push ShadeSoftPush for shade_soft(ShadeSoftConstants) {
            /// View samples, layer 1 first.
            pub samples: Read<ViewSample>,
            /// Indexed by [`ViewSample::brdf`].
            pub brdfs: Read<Brdf>,
            /// As [`ShadeLightPush::visibility`].
            pub visibility: Read<u32>,
            /// As [`ShadeLightPush::factors`].
            pub factors: Read<UVec2>,
            /// As [`ShadeLightPush::image`].
            pub image: Write<f32>,
            /// As [`ShadeLightPush::extras`].
            pub extras: Write<f32>,
            /// [`SOFT_POINTS`] points of the light, and its middle; at unit intensity.
            pub points: Read<PackedLight>,
            /// Of a rectangle: half its width, along it; mesh space. Of others: radius, along any direction across the
            /// axis; of suns, at unit distance.
            pub across: Vec3,
            /// Of a rectangle: half its height. Of others: the radius.
            pub half_height: f32,
            /// Number of view samples.
            pub sample_count: u32,
            /// As [`ShadeLightPush::pixel_stride`].
            pub pixel_stride: u32,
            /// As [`ShadeLightPush::layers`].
            pub layers: u32,
            pub unused: u32,
        }

        /// Rows of a block matrix that share their columns.
        pub struct Panel {
            /// Start of its factors, in units of eight. Order, outermost first: strip of [`STRIP_ROWS`], column group,
            /// channel if channels have separate factors, row.
            pub first_value: u32,
            /// Start of its lists of inputs and tints, one entry per column.
            pub first_input: u32,
            /// Start of its list of outputs, one entry per row.
            pub first_output: u32,
            /// At most [`PANEL_ROWS`].
            pub row_count: u32,
            /// Number of columns divided by [`PANEL_COLUMNS`].
            pub column_group_count: u32,
            /// Number of column groups, the first ones, with separate factors for R, G and B.
            pub own_column_group_count: u32,
            /// Multiplies the stored factors.
            pub scale: f32,
        }

        /// Rows of a sparse matrix that one workgroup multiplies.
        pub struct Slice {
            /// Start of its terms, in units of two. For each pair of terms, [`GROUP_SIZE`] rows.
            pub first_value: u32,
            /// Start of its list of outputs, one entry per row.
            pub first_output: u32,
            /// At most [`GROUP_SIZE`].
            pub row_count: u32,
            /// Number of terms of the longest row divided by two.
            pub pair_count: u32,
            /// Multiplies the stored factors.
            pub scale: f32,
        }

        /// A gather sample as direct light illuminates it; mesh space.
        pub struct LightSample {
            /// Its reflection, averaged.
            pub brdf: Brdf,
            /// Unit. `normal`, `tangent` and their cross product are the frame of its harmonics.
            pub normal: Vec3,
            /// Unit.
            pub tangent: Vec3,
            /// Position of its roughness in the tables of k, 0 to 1.
            pub roughness: f32,
            /// Index of its first coefficient.
            pub first: u32,
            /// Number of degrees; it has `degrees` squared coefficients.
            pub degrees: u32,
            /// Area of the surface that it represents.
            pub area: f32,
        }

        /// Contribution of a light's rays to one coefficient.
        pub struct Contribution {
            /// RGB, at unit intensity.
            pub value: Vec3,
            /// Index of the coefficient.
            pub index: u32,
        }

        pub push AddSightsPush for add_sights {
            /// In tile order.
            pub pixels: Read<u32>,
            /// RGB of each of these pixels.
            pub values: Read<Vec3>,
            /// Planes R, G, B of `pixel_stride` floats: the light's image.
            pub image: Write<f32>,
            /// Number of pixels.
            pub count: u32,
            /// As [`ShadeLightPush::pixel_stride`].
            pub pixel_stride: u32,
        }

        pub push LoadTermsPush for load_terms {
            /// RGB.
            pub terms: Read<Vec4>,
            pub vector: Write<Vec4>,
            /// Number of terms.
            pub count: u32,
            pub unused: u32,
        }

        pub push AddLightRaysPush for add_light_rays {
            /// At most one per coefficient.
            pub contributions: Read<Contribution>,
            /// Coefficients of all samples, as [`ShadeGatherPush::coefficients`].
            pub coefficients: Write<Vec4>,
            /// Number of contributions.
            pub count: u32,
            /// Distance from one coefficient of this light to the next, in elements.
            pub stride: u32,
            /// Index of the first one.
            pub offset: u32,
            /// Padding to a multiple of eight bytes.
            pub unused: u32,
        }

        pub push ShadeGatherPush for shade_gather(ShadeGatherConstants) {
            /// Gather samples.
            pub samples: Read<LightSample>,
            /// Position and normal of [`ShadeGatherConstants::points_per_sample`] points, sample by sample.
            pub points: Read<ViewSample>,
            /// Fraction of the light that each point sees, 8 bits each, four per word.
            pub visibility: Read<u32>,
            /// Factor on the light that reaches each point: RGB in half precision; read with [`HAS_FACTORS`].
            pub factors: Read<UVec2>,
            /// Tables of k: `Projection::tables`.
            pub tables: Read<f32>,
            /// Coefficients of all samples: RGB and an unused component, interleaved by light.
            pub coefficients: Write<Vec4>,
            /// Points of an area light that moves, [`SOFT_POINTS`]; else unused.
            pub lights: Read<PackedLight>,
            /// At unit intensity.
            pub light: PackedLight,
            /// Number of samples.
            pub sample_count: u32,
            /// Distance from one coefficient of this light to the next, in elements.
            pub stride: u32,
            /// Index of the first one.
            pub offset: u32,
            /// Intensity divided by power, 1/sr, of a light that casts rays; 0 for others.
            pub per_solid_angle: f32,
            /// [`ACCUMULATE`]: add to `coefficients`. [`HAS_FACTORS`]: `factors` multiply the light.
            pub flags: u32,
        }

        /// A gather sample of the thesis's method; mesh space.
        pub struct FactoredSample {
            /// Unit. `normal`, `tangent` and their cross product are the frame of its directions.
            pub normal: Vec3,
            /// Unit.
            pub tangent: Vec3,
            /// Start of its BRDF's table of k: `[texel][term]` over the square around the disc, zero outside the disc.
            pub table: u32,
            /// Number of coefficients, equal to the terms of the BRDF.
            pub terms: u32,
            /// Index of its first coefficient.
            pub first: u32,
        }

        pub push ShadeFactoredPush for shade_factored(ShadeFactoredConstants) {
            /// Gather samples.
            pub samples: Read<FactoredSample>,
            /// Their positions.
            pub points: Read<ViewSample>,
            /// Fraction of the light that each sample sees, 8 bits each, four per word.
            pub visibility: Read<u32>,
            /// Factor on the light that reaches each sample: RGB in half precision; read if `has_factors`.
            pub factors: Read<UVec2>,
            /// RGB of k; the fourth component is 1 if the texel lies on the disc, else 0.
            pub tables: Read<Vec4>,
            /// Coefficients of all samples: RGB and an unused component, interleaved by light.
            pub coefficients: Write<Vec4>,
            /// Points of an area light that moves, [`SOFT_POINTS`]; else unused.
            pub lights: Read<PackedLight>,
            /// At unit intensity.
            pub light: PackedLight,
            /// Number of samples.
            pub sample_count: u32,
            /// Distance from one coefficient of this light to the next, in elements.
            pub stride: u32,
            /// Index of the first one.
            pub offset: u32,
            /// Whether to add to `coefficients`.
            pub accumulate: u32,
            /// Whether `factors` multiply the light.
            pub has_factors: u32,
        }

        /// One step of a Haar transform: a plane rotation of two elements of a vector.
        pub struct Rotation {
            /// Index of the left sum, replaced by the sum of both.
            pub sum: u32,
            /// Index of the right sum, replaced by the Haar term.
            pub term: u32,
            /// Square root of the left side's share of the samples.
            pub cosine: f32,
            /// Square root of the right side's share.
            pub sine: f32,
        }

        pub push HaarPush for haar(LightsConstants) {
            /// By subtree, then by height from the leaves up.
            pub rotations: Read<Rotation>,
            /// Start of each height's rotations, then the end of the last ones: `height_count` + 1 entries per subtree.
            pub ranges: Read<u32>,
            /// RGB and an unused component, interleaved by light.
            pub vector: Exchange<Vec4>,
            /// Number of subtrees, one per workgroup.
            pub subtree_count: u32,
            /// Number of heights, the same for all subtrees.
            pub height_count: u32,
        }

        pub push HaarSumsPush for haar_sums(LightsConstants) {
            /// Indices of the terms of each sum. The first one receives the sum divided by the square root of the
            /// number of terms.
            pub places: Read<u32>,
            /// Start of each sum's entries in `places`, then the end of the last ones.
            pub first_place: Read<u32>,
            /// RGB and an unused component, interleaved by light.
            pub vector: Write<Vec4>,
            pub sum_count: u32,
            pub unused: u32,
        }

        pub push MultiplySparsePush for multiply_sparse(LightsConstants) {
            /// One per workgroup.
            pub slices: Read<Slice>,
            /// Two terms each. A term is two words: red and green; blue and the distance from the previous column.
            pub values: Read<UVec4>,
            /// Indices of view samples, by row.
            pub outputs: Read<u32>,
            /// The factor vector: RGB and an unused component, interleaved by light.
            pub vector: Read<Vec4>,
            /// Per light, planes R, G, B of `pixel_stride` floats; the result is added to them.
            pub images: [Write<f32>; MAX_LIGHTS_PER_PASS as usize],
            /// Per light, planes R, G, B of `extra_stride` floats for extra samples; the result is added to them.
            pub extras: [Write<f32>; MAX_LIGHTS_PER_PASS as usize],
            /// Number of slices.
            pub slice_count: u32,
            /// Number of samples of layer 1.
            pub pixel_stride: u32,
            /// Number of extra samples, padded.
            pub extra_stride: u32,
            /// Number of lights; further entries of `images` and `extras` are not written.
            pub light_count: u32,
        }

        pub push MultiplyBlocksPush for multiply_blocks(MultiplyBlocksConstants) {
            /// One per workgroup.
            pub panels: Read<Panel>,
            /// Eight float16 each.
            pub values: Read<UVec4>,
            /// Indices into `vector`, by column.
            pub inputs: Read<u32>,
            /// Multiply inputs of columns whose factors are shared by R, G and B; only read by kernels of three
            /// channels.
            pub tints: Read<Vec3>,
            /// Indices into `vector`, or of view samples, by row.
            pub outputs: Read<u32>,
            /// RGB and an unused component, interleaved by light: input, and output unless that goes to view samples.
            pub vector: Write<Vec4>,
            /// Per light, planes R, G, B of `pixel_stride` floats; the result is added to them.
            pub images: [Write<f32>; MAX_LIGHTS_PER_PASS as usize],
            /// Per light, planes R, G, B of `extra_stride` floats for extra samples; the result is added to them.
            pub extras: [Write<f32>; MAX_LIGHTS_PER_PASS as usize],
            /// Number of panels.
            pub panel_count: u32,
            /// Number of samples of layer 1.
            pub pixel_stride: u32,
            /// Number of extra samples, padded.
            pub extra_stride: u32,
            /// Number of lights; further entries of `images` and `extras` are not written.
            pub light_count: u32,
        }

        pub push ShadowPcfPush for shadow_pcf {
            /// View samples.
            pub samples: Read<ViewSample>,
            /// One, or six in the order +X, -X, +Y, -Y, +Z, -Z.
            pub faces: Read<ShadowFace>,
            /// 8 bits per sample, four per word.
            pub visibility: Write<u32>,
            /// Mesh space; selects the face.
            pub light_position: Vec3,
            /// 1 or 6.
            pub face_count: u32,
            /// Number of view samples.
            pub sample_count: u32,
            /// Texel size in texture coordinates.
            pub texel: f32,
        }

        pub draw ShadowPush for shadow {
            /// Vertices, three floats each.
            pub positions: Read<f32>,
            /// All faces of the light.
            pub faces: Read<ShadowFace>,
            /// Index of the face that is drawn.
            pub face: u32,
            /// Padding to a multiple of eight bytes.
            pub unused: u32,
        }

        pub draw ShadowCutoutPush for shadow_cutout {
            /// Three per triangle.
            pub corners: Read<CutoutCorner>,
            /// One per material.
            pub cutouts: Read<Cutout>,
            /// Alphas of textures, 8 bits each, four per word.
            pub texels: Read<u32>,
            /// All faces of the light.
            pub faces: Read<ShadowFace>,
            /// Index of the face that is drawn.
            pub face: u32,
            /// Padding to a multiple of eight bytes.
            pub unused: u32,
        }

        pub push ResolvePush for resolve {
            /// Pixels that have extra samples.
            pub pixels: Read<ExtraPixel>,
            /// Their lists of indices into `samples` and `extras`.
            pub indices: Read<u32>,
            /// Weight and layer of each extra sample.
            pub samples: Read<ExtraSample>,
            /// Radiance of the extra samples, planes R, G, B.
            pub extras: Read<f32>,
            /// The light's image, planes R, G, B.
            pub image: Write<f32>,
            /// Number of pixels with extra samples.
            pub pixel_count: u32,
            /// Floats per plane of `image`.
            pub pixel_stride: u32,
            /// Floats per plane of `extras`.
            pub extra_stride: u32,
            /// Bit l: layer l is shown.
            pub layers: u32,
        }

        pub push SumImagesPush for sum_images {
            /// Planes R, G, B.
            pub sum: Write<Vec4>,
            /// Terms of the sum.
            pub terms: [SumTerm; MAX_TERMS as usize],
            /// Number of terms.
            pub term_count: u32,
            /// vec4s per plane.
            pub plane_length: u32,
            /// Factor of the previous contents of `sum`.
            pub kept: f32,
            /// Padding to a multiple of eight bytes.
            pub unused: u32,
        }

        pub push CompareImagesPush for compare_images {
            pub image: Read<Vec4>,
            pub other: Read<Vec4>,
            /// For each thread: sum of squared differences, and of squares of `image`.
            pub sums: Write<Vec2>,
            /// Elements of an image.
            pub count: u32,
            /// Number of threads.
            pub threads: u32,
        }

        pub push CountNonFinitePush for count_non_finite {
            /// Planes R, G, B, as bits.
            pub values: Read<u32>,
            /// One counter per checked pass.
            pub counts: Write<u32>,
            /// Floats of each plane that are checked.
            pub plane_length: u32,
            /// Floats from one plane to the next.
            pub plane_stride: u32,
            /// Index of the counter.
            pub slot: u32,
            /// Padding to a multiple of eight bytes.
            pub unused: u32,
        }

        pub push CompositePush for composite(OutputConstants) {
            /// Terms of the sum, exposed.
            pub terms: [SumTerm; MAX_TERMS as usize],
            /// One packed RGBA8 or three floats per pixel, row by row.
            pub target: Write<u32>,
            /// Of a display: red changes fastest; four 16-bit fractions each. Read for OUTPUT_TABLE only.
            pub display_table: Read<UVec2>,
            /// Number of terms.
            pub term_count: u32,
            /// Pixels.
            pub width: u32,
            /// Pixels.
            pub height: u32,
            /// 1: blue in the lowest byte, for windows with that format.
            pub blue_first: u32,
        }

        pub push SheetPush for sheet(OutputConstants) {
            /// What the cell shows, exposed.
            pub term: SumTerm,
            /// One packed RGBA8 or three floats per pixel, row by row.
            pub target: Write<u32>,
            /// Of a display: red changes fastest; four 16-bit fractions each. Read for OUTPUT_TABLE only.
            pub display_table: Read<UVec2>,
            /// 1; 0: the cell is empty.
            pub term_count: u32,
            /// Width and height of the picture.
            pub size: UVec2,
            /// Left and top of the cell.
            pub corner: UVec2,
            /// Width and height of the cell.
            pub cell: UVec2,
            /// 1: blue in the lowest byte, for windows with that format.
            pub blue_first: u32,
        }

        pub push InspectPush for inspect(InspectConstants) {
            /// Terms of the sum.
            pub terms: [SumTerm; MAX_TERMS as usize],
            /// [`HISTOGRAM_BINS`] counts of pixels, added to; or the RGB bits of one pixel.
            pub result: Write<u32>,
            /// Number of terms.
            pub term_count: u32,
            /// Floats per plane of the terms.
            pub pixel_stride: u32,
            /// Width and height of the picture; when probing, x is the pixel's index in tile order.
            pub pixels: UVec2,
            /// Linear factor, 2^stops.
            pub exposure: f32,
            /// Padding to a multiple of eight bytes.
            pub unused: u32,
        }

        pub push FitPush for fit(FitConstants) {
            /// Four bytes per pixel, row by row.
            pub source: Read<u32>,
            /// Four bytes per pixel, row by row.
            pub target: Write<u32>,
            /// Width and height, pixels.
            pub source_size: UVec2,
            /// Width and height, pixels.
            pub target_size: UVec2,
        }

        pub push YardstickPush for yardstick {
            /// 32 bytes per sample.
            pub samples: Read<Vec4>,
            /// 12 bytes per sample.
            pub results: Write<f32>,
            /// Number of samples.
            pub sample_count: u32,
            /// Multiply-adds per sample.
            pub multiply_adds: u32,
        }
    }
}

//! What Rust and GLSL share: view samples, BRDFs, lights, push constants. The bake fills them, kernels read them.

pub mod gpu_struct;

use glam::{Mat4, UVec2, UVec4, Vec2, Vec3, Vec4};

use self::gpu_struct::{Read, Write, gpu_shared};

gpu_shared! {
    constants {
        /// Threads in a workgroup of every kernel: one tile of pixels, and a whole number of subgroups everywhere.
        pub const GROUP_SIZE: u32 = 64;
        /// Workgroups in the first dimension of a dispatch: Vulkan guarantees 65,535.
        pub const MAX_COLUMNS: u32 = 1 << 15;
        /// Side of a tile of pixels. Images and layer 1 are stored tile by tile, so that 64 neighbours in memory are
        /// neighbours in the picture: a packet of shadow rays, a workgroup, a cache line.
        pub const TILE_SIZE: u32 = 8;
        /// [`ViewSample::brdf`] of a sample that reflects no light directly: background, perfect mirror.
        pub const NO_BRDF: u32 = 0xffff_ffff;

        /// [`PackedLight::kind`]
        pub const LIGHT_POINT: u32 = 0;
        /// [`PackedLight::kind`]
        pub const LIGHT_SPOT: u32 = 1;
        /// [`PackedLight::kind`]
        pub const LIGHT_DIRECTIONAL: u32 = 2;

        /// [`Cutout::first`] without a texture.
        pub const NO_TEXELS: u32 = 0xffff_ffff;
        /// [`Cutout::wrap_u`]
        pub const WRAP_REPEAT: u32 = 0;
        /// [`Cutout::wrap_u`]
        pub const WRAP_MIRROR: u32 = 1;
        /// [`Cutout::wrap_u`]
        pub const WRAP_CLAMP: u32 = 2;

        /// Images that a pass sums at most: so many terms fit its push constants.
        pub const MAX_TERMS: u32 = 4;

        /// Rows of a [`Panel`] at most.
        pub const PANEL_ROWS: u32 = 256;
        /// Rows of a panel whose factors lie together: those of neighbouring threads, so that these read on and on.
        pub const STRIP_ROWS: u32 = 32;
        /// Columns that are read at once: 16 bytes of float16.
        pub const PANEL_COLUMNS: u32 = 8;

        /// Degrees of the harmonics that gather samples keep of light.
        pub const HARMONIC_DEGREES: u32 = 7;
        /// Texels along each side of the map of directions to a disc [Yang 2007, Figure 4.2 b].
        pub const DISC_SIDE: u32 = 32;
        /// Lights whose products a pass takes at once, at most.
        pub const LIGHTS_A_PASS: u32 = 4;
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
        /// How many kinds of output there are.
        pub const OUTPUT_COUNT: u32 = 5;

        /// Bands of false colours; each is a stop wide.
        pub const STOP_COUNT: u32 = 16;
        /// Which of them has middle grey in its middle.
        pub const MIDDLE_STOP: u32 = 8;
        /// Bins of a histogram of luminance: the first holds what is darker than all others, the last what is brighter.
        pub const HISTOGRAM_BINS: u32 = 66;
        /// Bins a stop.
        pub const BINS_A_STOP: u32 = 4;
    }

    floats {
        /// What of the light from any direction a gather sample reflects at most: glTF's BRDF exceeds 1 near grazing. As near
        /// to 1 as single precision still tells how far from it, to a thousandth.
        pub const ALBEDO_CAP: f32 = 0.9999;
        /// Scene-linear luminance of middle grey.
        pub const MIDDLE_GREY: f32 = 0.18;
        /// Share of a light's power at which a point of a gather sample and rays from the light count alike; below half of it
        /// the point alone counts, above one and a half times it rays alone (docs/method.md, "Light rays").
        pub const EVEN_SHARE: f32 = 0.00390625;
    }

    tables {
        /// sRGB, red lowest, of each stop of luminance around middle grey, which is grey: violet and blue below, green,
        /// yellow and red above; the first stands for all that is darker, the last for all that is brighter.
        pub const STOP_COLORS: [u32; 16] = [
            0x14000a, 0x4a0a2a, 0x8c1246, 0xc82f3a, 0xe05b2a, 0xd68a1f, 0xb8ae17, 0x869e1e,
            0x808080, 0x24c06c, 0x1ecfb8, 0x0fc8f2, 0x1494f5, 0x1955ee, 0x241cdd, 0xffffff,
        ];
    }

    specializations {
        /// Of shade_light.comp.
        pub struct ShadeLightConstants {
            /// Whether any BRDF of the scene has a specular lobe.
            pub specular: bool = true,
        }

        /// Of shade_gather.comp.
        pub struct ShadeGatherConstants {
            /// Most degrees that any sample has.
            pub degrees: u32 = HARMONIC_DEGREES,
        }

        /// Of multiply_blocks.comp.
        pub struct MultiplyBlocksConstants {
            /// 3: the first columns have factors for R, G and B each, the others a tint of their input; 1: R, G and B share
            /// all factors.
            pub channels: u32 = 1,
            /// Whether rows are view samples, whose radiance is added to; else elements of the vector itself.
            pub to_view_samples: bool = false,
            /// Vectors, element by element side by side: factors are read once for all.
            pub lights: u32 = 1,
            /// Whether each [`PANEL_COLUMNS`] neighbouring threads are in one subgroup, which shares what each of them read.
            pub wide: bool = false,
        }

        /// Of kernels for the vectors of some lights.
        pub struct LightsConstants {
            /// Vectors, element by element side by side.
            pub lights: u32 = 1,
        }

        /// Of kernels that write pixels.
        pub struct OutputConstants {
            /// One of the `OUTPUT_` constants.
            pub output: u32 = OUTPUT_LINEAR,
        }

        /// Of inspect.comp.
        pub struct InspectConstants {
            /// A histogram of all pixels; else one pixel.
            pub histogram: bool = true,
        }

        /// Of fit.comp.
        pub struct FitConstants {
            /// Whether the picture shrinks along any axis.
            pub shrinks: bool = false,
        }
    }

    structs {
        /// A surface point that the camera sees, straight or through mirrors; mesh space.
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
            /// GGX alpha, roughness squared; 0 has no specular lobe here: its mirror image is in deeper layers.
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
            /// Mesh space; for directional lights unused.
            pub position: Vec3,
            /// One of the `LIGHT_` constants.
            pub kind: u32,
            /// Unit; along the light.
            pub direction: Vec3,
            /// 1/range in mesh space, 0 without one.
            pub inverse_range: f32,
            /// 1 / max(0.001, cos inner - cos outer) [KHR_lights_punctual].
            pub cone_scale: f32,
            /// 1 - cos outer: compared with 1 - cos of the angle, which stays exact for narrow cones.
            pub cone_versine: f32,
            /// Irradiance at normal incidence, of one candela, one unit of mesh space away; for directional lights unused.
            pub strength: f32,
        }

        /// View samples beyond layer 1 of a pixel, or beyond its first sample.
        pub struct ExtraSample {
            /// RGB share of the pixel: BRDF and cosine along the mirror path over the number of samples a pixel.
            pub weight: Vec3,
            /// Layer of the deep framebuffer, from 0.
            pub layer: u32,
        }

        /// A pixel with extra samples.
        pub struct ExtraPixel {
            /// Pixel in tile order.
            pub pixel: u32,
            /// Where its list of extra samples begins.
            pub first: u32,
            /// How many they are.
            pub count: u32,
            /// Share of the pixel's first sample: 1 / samples a pixel, times its coverage where it blends.
            pub first_weight: f32,
        }

        /// One side of a light's shadow map.
        pub struct ShadowFace {
            /// Reversed depth: 1 at the near plane, 0 at infinity.
            pub clip_from_mesh: Mat4,
        }

        /// A corner of a triangle that light may pass.
        pub struct CutoutCorner {
            /// Mesh space.
            pub position: Vec3,
            /// Alpha without its texture.
            pub alpha: f32,
            /// Where it is looked up.
            pub uv: Vec2,
            /// Index of its [`Cutout`].
            pub cutout: u32,
        }

        /// Where a material lets light pass.
        pub struct Cutout {
            /// Its texture's first texel; [`NO_TEXELS`] without one.
            pub first: u32,
            /// Of the texture.
            pub width: u32,
            /// Of the texture.
            pub height: u32,
            /// One of the `WRAP_` constants, along u.
            pub wrap_u: u32,
            /// The same along v.
            pub wrap_v: u32,
            /// Alpha from which all is there; negative where the material blends.
            pub cutoff: f32,
        }

        /// One term of a sum of images.
        pub struct SumTerm {
            /// Planes R, G, B.
            pub image: Read<Vec4>,
            /// Factor on each plane.
            pub scale: Vec3,
            /// Keeps the size a multiple of eight.
            pub unused: u32,
        }

        pub push ShadeLightPush for shade_light(ShadeLightConstants) {
            /// View samples, layer 1 first.
            pub samples: Read<ViewSample>,
            /// BRDFs that they point to.
            pub brdfs: Read<Brdf>,
            /// How much of the light each sample sees, 8 bits each, four a word.
            pub visibility: Read<u32>,
            /// Planes R, G, B of `pixel_stride` floats: the light's image.
            pub image: Write<f32>,
            /// Planes R, G, B of `extra_stride` floats: radiance of the extra samples.
            pub extras: Write<f32>,
            /// At unit intensity.
            pub light: PackedLight,
            /// All view samples.
            pub sample_count: u32,
            /// Samples of layer 1: pixels, padded to whole tiles.
            pub pixel_stride: u32,
            /// Extra samples, padded to a multiple of 4.
            pub extra_stride: u32,
            /// Bit l: layer l counts. Bit 0 matters here, and whether any does; deeper layers are weighed by resolve.comp.
            pub layers: u32,
            /// Keeps the size a multiple of eight.
            pub unused: u32,
        }

        /// Rows of a block matrix that share their columns.
        pub struct Panel {
            /// Where its factors begin, in units of eight: strip by strip of [`STRIP_ROWS`], column group by column
            /// group, channel by channel where these have factors of their own, row by row.
            pub first_value: u32,
            /// Where its lists of inputs and tints begin, one a column.
            pub first_input: u32,
            /// Where its list of outputs begins, one a row.
            pub first_output: u32,
            /// At most [`PANEL_ROWS`].
            pub row_count: u32,
            /// Columns over [`PANEL_COLUMNS`].
            pub column_group_count: u32,
            /// How many of these, the first ones, have factors for R, G and B each.
            pub own_column_group_count: u32,
            /// What stored factors are multiplied by.
            pub scale: f32,
        }

        /// Rows of a sparse matrix, a workgroup's.
        pub struct Slice {
            /// Where its terms begin, in units of two: pair by pair of terms, row by row, [`GROUP_SIZE`] rows.
            pub first_value: u32,
            /// Where its list of outputs begins, one a row.
            pub first_output: u32,
            /// At most [`GROUP_SIZE`].
            pub row_count: u32,
            /// Terms of the longest row over two.
            pub pair_count: u32,
            /// What stored factors are multiplied by.
            pub scale: f32,
        }

        /// What direct light leaves in a gather sample; mesh space.
        pub struct LightSample {
            /// Its reflection, averaged.
            pub brdf: Brdf,
            /// Unit; with `tangent` and their cross product the frame that its functions are counted in.
            pub normal: Vec3,
            /// Unit.
            pub tangent: Vec3,
            /// Where in the tables of k its roughness lies, 0 to 1.
            pub roughness: f32,
            /// Index of its first coefficient.
            pub first: u32,
            /// It has as many coefficients as this squared.
            pub degrees: u32,
            /// Of the surface that it stands for.
            pub area: f32,
        }

        /// What a light's rays add to a coefficient.
        pub struct Contribution {
            /// RGB, at unit intensity.
            pub value: Vec3,
            /// Index of the coefficient.
            pub index: u32,
        }

        pub push AddLightRaysPush for add_light_rays {
            /// No two for one coefficient.
            pub contributions: Read<Contribution>,
            /// Coefficients of all samples, as [`ShadeGatherPush::coefficients`].
            pub coefficients: Write<Vec4>,
            /// How many contributions.
            pub count: u32,
            /// From one coefficient of this light to its next.
            pub stride: u32,
            /// Where its first lies.
            pub offset: u32,
            /// Keeps the size a multiple of eight.
            pub unused: u32,
        }

        pub push ShadeGatherPush for shade_gather(ShadeGatherConstants) {
            /// Gather samples.
            pub samples: Read<LightSample>,
            /// Position and normal of `points_per_sample` points of each sample in turn.
            pub points: Read<ViewSample>,
            /// How much of the light each point sees, 8 bits each, four a word.
            pub visibility: Read<u32>,
            /// Tables of k: `Projection::tables`.
            pub tables: Read<f32>,
            /// Coefficients of all samples, RGB and nothing, of several lights side by side, element by element.
            pub coefficients: Write<Vec4>,
            /// At unit intensity.
            pub light: PackedLight,
            /// How many samples.
            pub sample_count: u32,
            /// How many of each.
            pub points_per_sample: u32,
            /// From one coefficient of this light to its next.
            pub stride: u32,
            /// Where its first lies.
            pub offset: u32,
            /// Intensity over power, in 1/sr, of a light that casts rays; 0 of others.
            pub per_solid_angle: f32,
        }

        /// A gather sample of the thesis; mesh space.
        pub struct FactoredSample {
            /// Unit; with `tangent` and their cross product the frame that its directions are counted in.
            pub normal: Vec3,
            /// Unit.
            pub tangent: Vec3,
            /// Where the table of its BRDF's k begins: `[texel][term]` over a square around the disc, nothing beyond it.
            pub table: u32,
            /// Its coefficients, as many as the BRDF has terms.
            pub terms: u32,
            /// Index of the first.
            pub first: u32,
        }

        pub push ShadeFactoredPush for shade_factored {
            /// Gather samples.
            pub samples: Read<FactoredSample>,
            /// Position of each.
            pub points: Read<ViewSample>,
            /// How much of the light each sees, 8 bits each, four a word.
            pub visibility: Read<u32>,
            /// RGB of k, and 1 where the texel lies on the disc.
            pub tables: Read<Vec4>,
            /// Coefficients of all samples, RGB and nothing, of several lights side by side, element by element.
            pub coefficients: Write<Vec4>,
            /// At unit intensity.
            pub light: PackedLight,
            /// How many samples.
            pub sample_count: u32,
            /// From one coefficient of this light to its next.
            pub stride: u32,
            /// Where its first lies.
            pub offset: u32,
        }

        /// One step of a Haar transform: a plane rotation of two elements of a vector.
        pub struct Rotation {
            /// Where the left sum is, and the sum of both comes.
            pub sum: u32,
            /// Where the right sum is, and the term comes.
            pub term: u32,
            /// Root of the left side's share of the samples.
            pub cosine: f32,
            /// Root of the right side's.
            pub sine: f32,
        }

        pub push HaarPush for haar(LightsConstants) {
            /// By subtree, then height from the bottom up.
            pub rotations: Read<Rotation>,
            /// Where the rotations of each height begin, and where the last ones end: `height_count` + 1 a subtree.
            pub ranges: Read<u32>,
            /// RGB and nothing, of several lights side by side, element by element.
            pub vector: Write<Vec4>,
            /// One a workgroup.
            pub subtree_count: u32,
            /// The same for all.
            pub height_count: u32,
        }

        pub push HaarSumsPush for haar_sums(LightsConstants) {
            /// Of each sum what it adds up; the first gets the sum over the root of their number.
            pub places: Read<u32>,
            /// Where each sum's places begin, and where the last one's end.
            pub first_place: Read<u32>,
            /// RGB and nothing, of several lights side by side, element by element.
            pub vector: Write<Vec4>,
            pub sum_count: u32,
            pub unused: u32,
        }

        pub push MultiplySparsePush for multiply_sparse(LightsConstants) {
            /// One a workgroup.
            pub slices: Read<Slice>,
            /// Two terms each: red and green, blue and how far the column is from the one before, twice.
            pub values: Read<UVec4>,
            /// Indices of view samples.
            pub outputs: Read<u32>,
            /// RGB and nothing, of several lights side by side, element by element: what is multiplied.
            pub vector: Read<Vec4>,
            /// Of each light, planes R, G, B of `pixel_stride` floats, added to.
            pub images: [Write<f32>; LIGHTS_A_PASS as usize],
            /// Of each light, planes R, G, B of `extra_stride` floats: radiance of the extra samples, added to.
            pub extras: [Write<f32>; LIGHTS_A_PASS as usize],
            /// How many slices.
            pub slice_count: u32,
            /// Samples of layer 1.
            pub pixel_stride: u32,
            /// Extra samples, padded.
            pub extra_stride: u32,
            /// Lights whose images are there.
            pub light_count: u32,
        }

        pub push MultiplyBlocksPush for multiply_blocks(MultiplyBlocksConstants) {
            /// One a workgroup.
            pub panels: Read<Panel>,
            /// Eight float16 each.
            pub values: Read<UVec4>,
            /// Indices into `vector`.
            pub inputs: Read<u32>,
            /// What inputs of columns are multiplied by whose factors R, G and B share; read by kernels of three channels.
            pub tints: Read<Vec3>,
            /// Indices into `vector`, or of view samples.
            pub outputs: Read<u32>,
            /// RGB and nothing, of several lights side by side, element by element: what is multiplied, and what results if no view samples do.
            pub vector: Write<Vec4>,
            /// Of each light, planes R, G, B of `pixel_stride` floats, added to.
            pub images: [Write<f32>; LIGHTS_A_PASS as usize],
            /// Of each light, planes R, G, B of `extra_stride` floats: radiance of the extra samples, added to.
            pub extras: [Write<f32>; LIGHTS_A_PASS as usize],
            /// How many panels.
            pub panel_count: u32,
            /// Samples of layer 1.
            pub pixel_stride: u32,
            /// Extra samples, padded.
            pub extra_stride: u32,
            /// Lights whose images are there.
            pub light_count: u32,
        }

        pub push ShadowPcfPush for shadow_pcf {
            /// View samples.
            pub samples: Read<ViewSample>,
            /// One, or six in the order +X, -X, +Y, -Y, +Z, -Z.
            pub faces: Read<ShadowFace>,
            /// 8 bits a sample, four a word.
            pub visibility: Write<u32>,
            /// Where the light is; picks the face.
            pub light_position: Vec3,
            /// 1 or 6.
            pub face_count: u32,
            /// All view samples.
            pub sample_count: u32,
            /// Side of a texel in texture coordinates.
            pub texel: f32,
        }

        pub push ShadowPush for shadow {
            /// Vertices, three floats each.
            pub positions: Read<f32>,
            /// All faces of the light.
            pub faces: Read<ShadowFace>,
            /// Which one is drawn.
            pub face: u32,
            /// Keeps the size a multiple of eight.
            pub unused: u32,
        }

        pub push ShadowCutoutPush for shadow_cutout {
            /// Three a triangle.
            pub corners: Read<CutoutCorner>,
            /// One a material.
            pub cutouts: Read<Cutout>,
            /// Alphas of textures, 8 bits each, four a word.
            pub texels: Read<u32>,
            /// All faces of the light.
            pub faces: Read<ShadowFace>,
            /// Which one is drawn.
            pub face: u32,
            /// Keeps the size a multiple of eight.
            pub unused: u32,
        }

        pub push ResolvePush for resolve {
            /// Pixels that have extra samples.
            pub pixels: Read<ExtraPixel>,
            /// Their lists of extra samples, counted from the first extra one.
            pub indices: Read<u32>,
            /// Weight and layer of each extra sample.
            pub samples: Read<ExtraSample>,
            /// Radiance of the extra samples, planes.
            pub extras: Read<f32>,
            /// The light's image, planes.
            pub image: Write<f32>,
            /// How many pixels.
            pub pixel_count: u32,
            /// Floats a plane of `image`.
            pub pixel_stride: u32,
            /// Floats a plane of `extras`.
            pub extra_stride: u32,
            /// Bit l: layer l counts.
            pub layers: u32,
        }

        pub push SumImagesPush for sum_images {
            /// Planes R, G, B.
            pub sum: Write<Vec4>,
            /// What is summed.
            pub terms: [SumTerm; MAX_TERMS as usize],
            /// How many terms.
            pub term_count: u32,
            /// vec4s a plane.
            pub plane_length: u32,
            /// 1: add to what is there.
            pub accumulate: u32,
            /// Keeps the size a multiple of eight.
            pub unused: u32,
        }

        pub push CountNonFinitePush for count_non_finite {
            /// Planes R, G, B, as bits.
            pub values: Read<u32>,
            /// One count a pass that is looked after.
            pub counts: Write<u32>,
            /// Floats a plane that count.
            pub plane_length: u32,
            /// Floats from one plane to the next.
            pub plane_stride: u32,
            /// Which count.
            pub slot: u32,
            /// Keeps the size a multiple of eight.
            pub unused: u32,
        }

        pub push CompositePush for composite(OutputConstants) {
            /// What is summed.
            pub terms: [SumTerm; MAX_TERMS as usize],
            /// One packed RGBA8 a pixel, or three floats, row by row.
            pub target: Write<u32>,
            /// How many terms.
            pub term_count: u32,
            /// Floats a plane of the terms.
            pub pixel_stride: u32,
            /// Pixels.
            pub width: u32,
            /// Pixels.
            pub height: u32,
            /// Linear factor, 2^stops.
            pub exposure: f32,
            /// 1: blue in the lowest byte, as the window wants it.
            pub blue_first: u32,
        }

        pub push SheetPush for sheet(OutputConstants) {
            /// What the cell shows.
            pub term: SumTerm,
            /// One packed RGBA8 a pixel, or three floats, row by row.
            pub target: Write<u32>,
            /// 1, or 0: the cell is empty.
            pub term_count: u32,
            /// Floats a plane of the term.
            pub pixel_stride: u32,
            /// Width and height of the picture.
            pub size: UVec2,
            /// Left and top of the cell.
            pub corner: UVec2,
            /// Its width and height.
            pub cell: UVec2,
            /// Linear factor, 2^stops.
            pub exposure: f32,
            /// 1: blue in the lowest byte, as the window wants it.
            pub blue_first: u32,
        }

        pub push InspectPush for inspect(InspectConstants) {
            /// What is summed.
            pub terms: [SumTerm; MAX_TERMS as usize],
            /// [`HISTOGRAM_BINS`] counts of pixels, added to; or the RGB bits of one pixel.
            pub result: Write<u32>,
            /// How many terms.
            pub term_count: u32,
            /// Floats a plane of the terms.
            pub pixel_stride: u32,
            /// Width and height of the picture; of one pixel, its place in tile order.
            pub pixels: UVec2,
            /// Linear factor, 2^stops.
            pub exposure: f32,
            /// Keeps the size a multiple of eight.
            pub unused: u32,
        }

        pub push FitPush for fit(FitConstants) {
            /// Four bytes a pixel, row by row.
            pub source: Read<u32>,
            /// The same.
            pub target: Write<u32>,
            /// Width and height.
            pub source_size: UVec2,
            /// Width and height.
            pub target_size: UVec2,
        }

        pub push YardstickPush for yardstick {
            /// 32 bytes a sample.
            pub samples: Read<Vec4>,
            /// 12 bytes a sample.
            pub results: Write<f32>,
            /// How many samples.
            pub sample_count: u32,
            /// Multiply-adds a sample.
            pub multiply_adds: u32,
        }
    }
}

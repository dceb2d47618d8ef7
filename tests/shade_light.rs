//! The kernel that shades view samples against its f64 twin: on random and ragged input, and over the whole BRDF.
//!
//! A kernel starts from the same float32 numbers as its twin. What it makes of them differs by rounding, which narrow
//! lobes and cones magnify without bound; so tolerances are put on angles, where the rounding happens, and follow from
//! there by evaluating the twin at both ends.

mod common;

use std::f64::consts::PI;

use common::kernel::{ANGLE, RAGGED, ROUNDING, SENTINEL, output, pixel, run};
use common::random::Random;
use common::{gpu, largest, plain_surface};
use glam::{DVec3, UVec2, Vec3};
use relume::gpu::{Buffer, Frames, Kernel};
use relume::physics::brdf::{Angles, f_of_angles, ggx};
use relume::physics::{light, octahedral};
use relume::reference;
use relume::scene::{Light, LightKind, MeshSpace, Surface};
use relume::shared::*;
use relume::trace::surface::brdf;

/// Relative error of some 30 float32 operations on the way to a radiance: square roots and divisions included.
const ARITHMETIC: f64 = 30.0 * ROUNDING;

/// Of the facets; 0: no directions are drawn.
const DRAWN_AREAS: [f64; 3] = [0.0, 1.0 / 1024.0, 0.25];

fn random_surface(random: &mut Random) -> Surface {
    Surface {
        base_color: random.color(),
        alpha: 1.0,
        metallic: [0.0, 1.0, random.unit() as f32][random.below(3)],
        roughness: random.pick(&[0.0, 1e-6, 1e-3, 0.03, 0.2, 0.5, 1.0]),
        specular: random.pick(&[0.0, 0.5, 1.0]),
        specular_color: random.pick(&[Vec3::ONE, Vec3::new(1.0, 0.5, 0.2)]),
        ior: random.pick(&[1.0, 1.33, 1.5, 2.4]),
        emissive: Vec3::ZERO,
        diffuse_weight: random.pick(&[0.0, 1.0, 1.0, 1.0]),
        normal_t: Vec3::Z,
    }
}

/// One of each kind, with and without range, and with the cones that are hard: hair-thin, sharp-edged, a hemisphere.
/// Facets are points of area lights.
fn lights(random: &mut Random) -> Vec<PackedLight> {
    let base = || Light::point("light", DVec3::new(0.3, 1.1, -0.2));
    let spot = |inner: f64, outer: f64, direction: DVec3| Light {
        kind: LightKind::Spot,
        direction,
        inner_angle: inner.to_radians(),
        outer_angle: outer.to_radians(),
        ..base()
    };
    let flat = |two_sided: bool, spread: f64, direction: DVec3| Light {
        kind: LightKind::Disk,
        direction,
        radius: 0.1,
        two_sided,
        spread: spread.to_radians(),
        ..base()
    };
    let lights = [
        base(),
        Light { range: Some(1.5), ..base() },
        Light { position: DVec3::new(-40.0, 3.0, 1e3), ..base() },
        Light { kind: LightKind::Directional, direction: random.direction(), ..base() },
        spot(18.0, 28.0, random.direction()),
        spot(0.0, 90.0, random.direction()),
        spot(40.0, 40.0, random.direction()),
        spot(0.0, 0.01, random.direction()),
        spot(0.005, 0.01, random.direction()),
        Light { range: Some(1.2), ..spot(5.0, 60.0, random.direction()) },
        Light { radius: 0.3, ..base() },
        Light { kind: LightKind::Directional, direction: random.direction(), angle: 1.0, ..base() },
        flat(false, 180.0, random.direction()),
        flat(true, 180.0, random.direction()),
        flat(false, 40.0, random.direction()),
    ];
    let mut packed: Vec<PackedLight> =
        lights.iter().map(|light| light.pack_point(MeshSpace::WORLD, [0.3, 0.8], Some(16))).collect();
    // The sun of a dome.
    packed.push(PackedLight { position: Vec3::new(1.0, 0.5, 0.2), narrowing: 1e-3, ..packed[3] });
    packed
}

/// A view sample that is as often as not where something is hard: in the mirror direction, at grazing angles, within
/// a narrow cone, at the light itself.
fn random_sample(random: &mut Random, light: &PackedLight, brdf_count: usize) -> ViewSample {
    let mut position = random.vector(-1.0, 1.0).as_vec3();
    match random.below(6) {
        0 => position = light.position,
        1 => position = light.position + random.direction().as_vec3() * random.magnitude(1e-6, 1e-2) as f32,
        2 | 3 if light.kind == LIGHT_SPOT || light.narrowing > 0.0 => {
            let edge = match light.kind {
                LIGHT_SPOT => f64::from(2.0 * light.cone_versine).sqrt(),
                _ => 1f64.atan2(light.narrowing.into()),
            };
            let angle = edge * random.between(0.0, 1.2);
            let across = random.direction().cross(light.direction.as_dvec3()).normalize();
            let along = light.direction.as_dvec3() * angle.cos() + across * angle.sin();
            position = light.position + (along * random.between(0.1, 3.0)).as_vec3();
        }
        _ => {}
    }
    let wi = light::incident(light, position.as_dvec3()).map_or(DVec3::Y, |arriving| arriving.wi);
    let normal = match random.below(3) {
        0 => random.direction(),
        1 => (wi + random.direction() * 0.7).normalize(),
        // Grazing light, on either side of the horizon.
        _ => {
            let across = wi.cross(random.direction()).normalize();
            (across + wi * random.magnitude(1e-8, 1e-2) * random.pick(&[1.0, 1.0, 1.0, -1.0])).normalize()
        }
    };
    let mirrored = 2.0 * normal.dot(wi) * normal - wi;
    let wo = match random.below(4) {
        0 => random.direction(),
        1 => (normal + random.direction() * 0.99).normalize(),
        _ => (mirrored + random.direction() * random.pick(&[0.0, 1e-6, 1e-3, 0.1])).normalize(),
    };
    ViewSample {
        position,
        brdf: if random.below(16) == 0 { NO_BRDF } else { random.below(brdf_count) as u32 },
        normal: octahedral::encode(normal.as_vec3()),
        wo: octahedral::encode(wo.as_vec3()),
    }
}

/// Least and greatest radiance that float32 angles may give. `drawn_area`: see [`ShadeLightPush::drawn_area`].
fn shade_bounds(
    sample: &ViewSample,
    brdfs: &[Brdf],
    visibility: f64,
    light: &PackedLight,
    drawn_area: f64,
) -> (DVec3, DVec3) {
    let black = (DVec3::ZERO, DVec3::ZERO);
    if sample.brdf == NO_BRDF {
        return black;
    }
    let Some(arriving) = light::incident(light, sample.position.as_dvec3()) else { return black };
    let wi = arriving.wi;
    let ends = |value: f64, by: f64| [value - by, value + by];

    let mut irradiances = [f64::from(light.strength); 2];
    if light.kind != LIGHT_DIRECTIONAL {
        let d = (light.position.as_dvec3() - sample.position.as_dvec3()).length();
        // The fall to the range is taken from 1, so its rounding is absolute.
        irradiances = ends(light::window(light, d), ANGLE)
            .map(|window| window.clamp(0.0, 1.0) * f64::from(light.strength) / (d * d));
    }
    if light.kind == LIGHT_SPOT {
        let [near, far] = ends(light::off_axis(light, wi), ANGLE).map(|chord| light::cone(light, chord.max(0.0)));
        irradiances = [irradiances[0] * near.min(far), irradiances[1] * near.max(far)];
    }
    if light.kind >= LIGHT_FACET {
        // The sine of the angle to the normal is uncertain where the cosine is near 1.
        let cosine = -wi.dot(light.direction.as_dvec3());
        let sine = (1.0 - cosine * cosine).max(0.0).sqrt();
        let slack = ANGLE * (1.0 + f64::from(light.narrowing) * (1.0 / sine.max(ANGLE)).min(1.0 / ANGLE.sqrt()));
        let emission = ends(light::facet(light, cosine), slack).map(|emission| emission.max(0.0));
        irradiances = [0, 1].map(|end| irradiances[end] * emission[end]);
    }

    let (n, wo) = (reference::octahedral(sample.normal), reference::octahedral(sample.wo));
    let a = Angles::new(n, wi, wo);
    // Two nearly opposite directions leave a short sum, whose direction is the more uncertain.
    let half_angle = ANGLE / (wi + wo).length().max(ANGLE);
    let brdf = &reference::widened(&brdfs[sample.brdf as usize], light);
    // Solid angle that a drawn direction stands for.
    let drawn = match light.kind {
        _ if brdf.alpha >= NARROW_ALPHA => [0.0; 2],
        LIGHT_DIRECTIONAL => [drawn_area; 2],
        _ => {
            let d = (light.position.as_dvec3() - sample.position.as_dvec3()).length();
            let cosine = wi.dot(light.direction.as_dvec3()).abs();
            ends(cosine, ANGLE).map(|cosine| drawn_area * cosine.max(0.0) / (d * d))
        }
    };
    // Of the base and the lobe apart: only the lobe grows while its weight falls.
    let (mut low, mut high) = ([DVec3::INFINITY; 2], [DVec3::ZERO; 2]);
    let matt = Brdf { alpha: 0.0, ..*brdf };
    let sines = ends(a.sine_nh, half_angle).map(|sine| sine.max(0.0));
    for ni in ends(a.ni, ANGLE) {
        for no in ends(a.no, ANGLE) {
            // Between its ends, the lobe's radiance is greatest where both densities are equal.
            let equal = drawn.map(|area| sine_of_lobe_density(brdf, a.nh, no, 1.0 / area).clamp(sines[0], sines[1]));
            for sine_nh in sines.into_iter().chain(equal) {
                for oh in ends(a.oh, half_angle) {
                    let angles = Angles { ni, no, nh: a.nh, sine_nh, oh: oh.clamp(0.0, 1.0) };
                    let base = f_of_angles(&matt, &angles);
                    let parts = [base, (f_of_angles(brdf, &angles) - base).max(DVec3::ZERO)];
                    let density = lobe_density(brdf, &angles);
                    for solid_angle in drawn {
                        // Power heuristic [Veach 1995, Eq. 15]; what is no normal number may be zero in the kernel.
                        let weight = 1.0 / (1.0 + (solid_angle * density).powi(2));
                        let least = if weight < f32::MIN_POSITIVE.into() { 0.0 } else { weight };
                        for part in 0..2 {
                            low[part] = low[part].min(parts[part] * ni.max(0.0) * least);
                            high[part] = high[part].max(parts[part] * ni.max(0.0) * weight);
                        }
                    }
                }
            }
        }
    }
    let color = light::color(light);
    let (low, high) = (color * (low[0] + low[1]), color * (high[0] + high[1]));
    let scale = |end: usize, slack: f64| visibility * irradiances[end] * (1.0 + slack);
    (low * scale(0, -ARITHMETIC), high * scale(1, ARITHMETIC))
}

/// Density of directions mirrored at visible normals [Heitz 2018, Eq. 17].
fn lobe_density(brdf: &Brdf, a: &Angles) -> f64 {
    if brdf.has_lobe() { ggx(a.nh, a.sine_nh, brdf.alpha.into()) * visible_normals(brdf, a.no) } else { 0.0 }
}

/// Sine between normal and half vector at which [`lobe_density`] is `density`, 0 where it is less everywhere.
fn sine_of_lobe_density(brdf: &Brdf, nh: f64, no: f64, density: f64) -> f64 {
    let alpha = f64::from(brdf.alpha);
    (alpha * (visible_normals(brdf, no) / (PI * density)).sqrt() - (alpha * nh).powi(2)).max(0.0).sqrt()
}

/// [`lobe_density`] by the density of normals.
fn visible_normals(brdf: &Brdf, no: f64) -> f64 {
    let (alpha, no) = (f64::from(brdf.alpha), no.max(0.0));
    0.5 / (no + (alpha * alpha + (1.0 - alpha * alpha) * no * no).sqrt())
}

#[test]
fn bounds_hold_the_twin_itself() {
    let mut random = Random::new(5);
    let brdfs: Vec<Brdf> = (0..64).map(|_| brdf(&random_surface(&mut random))).collect();
    for light in lights(&mut random) {
        let mut lit = 0;
        for _ in 0..2000 {
            let sample = random_sample(&mut random, &light, brdfs.len());
            let drawn_area = random.pick(&DRAWN_AREAS);
            let value = reference::shade(&sample, &brdfs, 0.5, &light, drawn_area);
            let (low, high) = shade_bounds(&sample, &brdfs, 0.5, &light, drawn_area);
            assert!(low.cmple(value).all() && value.cmple(high).all(), "{value} is not in {low} .. {high}: {sample:?}");
            lit += usize::from(value != DVec3::ZERO);
        }
        assert!(lit > 100, "only {lit} of 2000 samples are lit by {light:?}");
    }
}

#[test]
fn shade_light() {
    let gpu = gpu();
    let mut frames = Frames::new(&gpu).unwrap();
    let mut random = Random::new(1);
    let surfaces: Vec<Surface> = (0..100).map(|_| random_surface(&mut random)).collect();
    let brdfs: Vec<Brdf> = surfaces.iter().map(brdf).collect();
    let brdf_buffer = Buffer::from_slice(&gpu, "test brdfs", &brdfs).unwrap();
    // As the scene's materials without a lobe have it, a kernel without one.
    let matt = brdfs.iter().map(|&b| Brdf { alpha: 0.0, ..b }).collect::<Vec<_>>();
    let kernels =
        [false, true].map(|specular| Kernel::<ShadeLightPush>::new(&gpu, ShadeLightConstants { specular }).unwrap());
    let (mut lit, mut tight) = (0, 0);
    for (light_index, light) in lights(&mut random).iter().enumerate() {
        for (size_index, &count) in RAGGED.iter().enumerate() {
            let light = *light;
            let specular = (light_index + size_index) % 4 != 0;
            // All in layer 1, nearly all, few.
            let pixels = [count, count - count / 3, count.min(1)][size_index % 3];
            let extras = count - pixels;
            let layers = if size_index == 5 { !1 } else { u32::MAX };
            let samples: Vec<_> = (0..count).map(|_| random_sample(&mut random, &light, brdfs.len())).collect();
            let mut visibility: Vec<u8> = (0..count).map(|_| random.pick(&[0, 255, 255, 255, 1, 77])).collect();
            visibility.resize(count.next_multiple_of(4), 13);
            // Powers of two, which round nothing.
            let has_factors = (light_index + size_index) % 3 == 0;
            let factors: Vec<[f32; 3]> =
                (0..count).map(|_| [0; 3].map(|_| random.pick(&[0.0, 0.125, 1.0, 2.0]))).collect();
            let halves: Vec<UVec2> = factors.iter().map(halves).collect();
            let drawn_area = DRAWN_AREAS[(light_index + size_index) % DRAWN_AREAS.len()];
            let factor_buffer = Buffer::from_slice(&gpu, "test factors", &halves).unwrap();
            let sample_buffer = Buffer::from_slice(&gpu, "test samples", &samples).unwrap();
            let words: Vec<u32> = bytemuck::pod_collect_to_vec(&visibility);
            let visibility_buffer = Buffer::from_slice(&gpu, "test visibility", &words).unwrap();
            let image = output(&gpu, 3 * pixels);
            let extra_image = output(&gpu, 3 * extras);
            run(&mut frames, |frame| {
                let mut pass = frame.pass("shade light");
                let push = ShadeLightPush {
                    samples: pass.read(&sample_buffer),
                    brdfs: pass.read(&brdf_buffer),
                    visibility: pass.read(&visibility_buffer),
                    factors: pass.read(&factor_buffer),
                    image: pass.write(&image),
                    extras: pass.write(&extra_image),
                    light,
                    sample_count: count as u32,
                    pixel_stride: pixels as u32,
                    extra_stride: extras as u32,
                    layers,
                    accumulate: 0,
                    has_factors: u32::from(has_factors),
                    drawn_area: drawn_area as f32,
                };
                pass.dispatch(&kernels[usize::from(specular)], &push, push.sample_count);
            });
            assert!(image.host()[3 * pixels..].iter().all(|&x| x == SENTINEL), "wrote past {pixels} pixels");
            assert!(extra_image.host()[3 * extras..].iter().all(|&x| x == SENTINEL), "wrote past {extras} extras");
            for (i, sample) in samples.iter().enumerate() {
                let got = match i.checked_sub(pixels) {
                    None => pixel(image.host(), pixels, i),
                    Some(extra) => pixel(extra_image.host(), extras, extra),
                };
                let counts = i >= pixels || layers & 1 != 0;
                let seen = if counts { f64::from(visibility[i]) / 255.0 } else { 0.0 };
                let (low, high) = shade_bounds(sample, if specular { &brdfs } else { &matt }, seen, &light, drawn_area);
                let factor = if has_factors { Vec3::from(factors[i]).as_dvec3() } else { DVec3::ONE };
                let (low, high) = (low * factor, high * factor);
                // Devices may flush what is below the smallest normal number to zero.
                let low = DVec3::select(low.cmplt(DVec3::splat(f32::MIN_POSITIVE.into())), DVec3::ZERO, low);
                assert!(
                    low.cmple(got).all() && got.cmple(high).all(),
                    "sample {i} of {count}: {got} is not in {low} .. {high}; {sample:?}, {:?}, {light:?}",
                    brdfs.get(sample.brdf as usize),
                );
                if high != DVec3::ZERO {
                    lit += 1;
                    tight += usize::from((high - low).cmple(1e-4 * high).all());
                }
            }
        }
    }
    println!("{tight} of {lit} lit samples have bounds closer than 1e-4");
    assert!(tight > lit / 4 && lit > 10_000, "{tight} of {lit} lit samples have bounds that tell anything");
}

/// RGB in half precision, as kernels read factors.
fn halves(factor: &[f32; 3]) -> UVec2 {
    let [r, g, b] = factor.map(|x| u32::from(half::f16::from_f32(x).to_bits()));
    UVec2::new(r | g << 16, b)
}

/// What the kernel makes of samples in layer 1 that see all of each light.
fn shaded(gpu: &common::Gpu, samples: &[ViewSample], brdfs: &[Brdf], lights: &[PackedLight]) -> Vec<Vec<DVec3>> {
    let mut frames = Frames::new(gpu).unwrap();
    let count = samples.len();
    let samples = Buffer::from_slice(gpu, "test samples", samples).unwrap();
    let brdfs = Buffer::from_slice(gpu, "test brdfs", brdfs).unwrap();
    let visibility = Buffer::from_slice(gpu, "test visibility", &vec![u32::MAX; count.div_ceil(4)]).unwrap();
    let image = output(gpu, 3 * count);
    let none = output(gpu, 0);
    let kernel = Kernel::<ShadeLightPush>::new(gpu, ShadeLightConstants { specular: true }).unwrap();
    let shade = |&light: &PackedLight| {
        run(&mut frames, |frame| {
            let mut pass = frame.pass("shade light");
            let push = ShadeLightPush {
                samples: pass.read(&samples),
                brdfs: pass.read(&brdfs),
                visibility: pass.read(&visibility),
                factors: pass.read_as(&visibility),
                image: pass.write(&image),
                extras: pass.write(&none),
                light,
                sample_count: count as u32,
                pixel_stride: count as u32,
                extra_stride: 0,
                layers: 1,
                accumulate: 0,
                has_factors: 0,
                drawn_area: 0.0,
            };
            pass.dispatch(&kernel, &push, push.sample_count);
        });
        (0..count).map(|i| pixel(image.host(), count, i)).collect()
    };
    lights.iter().map(shade).collect()
}

/// The bounds of `shade_light` are wide in places; of ordinary materials in ordinary light every digit counts.
#[test]
fn shade_light_is_exact_where_nothing_is_narrow() {
    let gpu = gpu();
    let mut random = Random::new(2);
    let ordinary = |random: &mut Random| {
        let roughness = random.between(0.4, 1.0) as f32;
        Surface { roughness, ior: 1.5, specular: 1.0, diffuse_weight: 1.0, ..random_surface(random) }
    };
    let brdfs: Vec<Brdf> = (0..50).map(|_| brdf(&ordinary(&mut random))).collect();
    let light = Light::point("light", DVec3::new(0.0, 2.0, 0.0)).pack(MeshSpace::WORLD);
    let count = 4097usize;
    let samples: Vec<ViewSample> = (0..count)
        .map(|_| {
            let position = random.vector(-1.0, 1.0);
            let wi = (light.position.as_dvec3() - position).normalize();
            let normal = (wi + 0.8 * random.direction()).normalize();
            let wo = (normal + 0.8 * random.direction()).normalize();
            let [normal, wo] = [normal, wo].map(|v| octahedral::encode(v.as_vec3()));
            ViewSample { position: position.as_vec3(), brdf: random.below(brdfs.len()) as u32, normal, wo }
        })
        .collect();
    let shaded = shaded(&gpu, &samples, &brdfs, &[light]).remove(0);
    for (sample, got) in samples.iter().zip(shaded) {
        let want = reference::shade(sample, &brdfs, 1.0, &light, 0.0);
        // Cosines are above 0.3 or so and lobes 0.16 wide: 2 / 0.16 times the angles' rounding, four times over.
        let error = largest(((got - want) / want.max(DVec3::splat(1e-30))).abs().to_array());
        assert!(error < 4.0 * ANGLE / 0.08, "{sample:?}: {got}, not {want}, off by {error:.1e}");
    }
}

/// Degrees from the normal, whose cosine is exactly 1 and 0 at the ends.
const GRID_ANGLES: [f64; 15] =
    [0.0, 1e-5, 1e-3, 0.1, 2.0, 10.0, 30.0, 45.0, 60.0, 75.0, 85.0, 89.0, 89.9, 89.999, 90.0];

fn direction(degrees: f64, azimuth: f64) -> DVec3 {
    let (sine, cosine) = if degrees == 90.0 { (1.0, 0.0) } else { degrees.to_radians().sin_cos() };
    // Multiples of 90 degrees hit the axes, which float32 and the octahedral map hold exactly.
    let (y, x) = match azimuth {
        90.0 => (1.0, 0.0),
        180.0 => (0.0, -1.0),
        _ => azimuth.to_radians().sin_cos(),
    };
    DVec3::new(sine * x, sine * y, cosine)
}

#[test]
fn shade_light_over_a_grid_of_angles_and_roughness() {
    let gpu = gpu();
    let plain = plain_surface(Vec3::new(0.9, 0.5, 0.1), 0.0, 0.0);
    let mut brdfs = Vec::new();
    for roughness in [0.0, 1e-6, 1e-4, 1e-3, 0.01, 0.03, 0.1, 0.2, 0.4, 0.6, 0.8, 1.0] {
        brdfs.extend([0.0, 0.4, 1.0].map(|metallic| brdf(&Surface { metallic, roughness, ..plain })));
    }
    let mut samples = Vec::new();
    for degrees in GRID_ANGLES {
        // From where the light comes over the mirrored direction and close by it; the light's azimuth is 0.
        for azimuth in [0.0, 1e-3, 1.0, 45.0, 90.0, 135.0, 170.0, 179.0, 179.9, 179.999, 180.0] {
            let [normal, wo] = [DVec3::Z, direction(degrees, azimuth)].map(|v| octahedral::encode(v.as_vec3()));
            let at = |brdf: usize| ViewSample { position: Vec3::ZERO, brdf: brdf as u32, normal, wo };
            samples.extend((0..brdfs.len()).map(at));
        }
    }
    let lights = GRID_ANGLES.map(|degrees| {
        let base = Light::point("light", DVec3::ZERO);
        Light { kind: LightKind::Directional, direction: -direction(degrees, 0.0), ..base }.pack(MeshSpace::WORLD)
    });
    let (mut lit, mut tight, mut black) = (0, 0, 0);
    for (light, shaded) in lights.iter().zip(shaded(&gpu, &samples, &brdfs, &lights)) {
        for (sample, got) in samples.iter().zip(shaded) {
            let of = || format!("{sample:?}, {:?}, {light:?}", brdfs[sample.brdf as usize]);
            let (low, high) = shade_bounds(sample, &brdfs, 1.0, light, 0.0);
            assert!(low.cmple(got).all() && got.cmple(high).all(), "{got} is not in {low} .. {high}: {}", of());
            // Off the axes, decoded directions lie on the horizon to rounding only.
            let on_axis = sample.wo.x * sample.wo.y == 0.0;
            if light.direction.z == 0.0 || on_axis && reference::octahedral(sample.wo).z == 0.0 {
                assert_eq!(got, DVec3::ZERO, "at the horizon: {}", of());
                black += 1;
            } else {
                lit += 1;
                tight += usize::from((high - low).cmple(1e-4 * high).all());
            }
        }
    }
    println!("{tight} of {lit} lit samples have bounds closer than 1e-4; {black} lie at the horizon");
    assert!(tight > lit / 4 && black > samples.len(), "{tight} of {lit} tight, {black} black");
}

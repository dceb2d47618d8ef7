//! Indirect light on the device: its kernels against their twins, and whole pictures against the operator on the CPU.

mod common;

use std::sync::Arc;

use common::kernel::{ROUNDING, SENTINEL, output, pixel, run};
use common::random::Random;
use common::stage::{Build, Setup, Stage, emitter, lambert, look, mirror, pixels, rig};
use common::{Gpu, gpu, largest, transfer};
use glam::{DVec3, UVec2, UVec4, Vec3, Vec4};
use relume::bake::baselines::thesis::{Thesis, ThesisSettings, shade_thesis};
use relume::bake::brdf_factors::HarmonicProjection;
use relume::bake::brdf_factors::svd::Terms;
use relume::bake::compression::CompressionSettings;
use relume::bake::framebuffer::view_samples::resolve;
use relume::bake::gather_samples::light_rays::per_solid_angle;
use relume::bake::transfer::Transfer;
use relume::bake::transfer::blocks::{BlockMatrix, Columns, Dense};
use relume::bake::transport::direct;
use relume::bake::transport::directions::Lobe;
use relume::bake::transport::{LightTransport, Outgoing, TransferSettings};
use relume::gpu::{Access, Buffer, Frames, Kernel, Pass, SharedFloat};
use relume::relight::indirect::host_product::{self, LightVectors, Results, ViewSampleRadiance};
use relume::relight::{Layers, Picture, Request, Site, VisibilityMethod};
use relume::scene::rig::Rig;
use relume::scene::{Light, LightKind, Material, Projection, Scene};
use relume::shared::gpu_struct::Write;
use relume::shared::*;
use relume::storage::journal::Journal;
use relume::trace::packet::{PACKET_SIZE, trace_all};

/// Blocks of random shape: rows are dealt out to blocks at random, columns drawn anew for each.
fn random_matrix(random: &mut Random, channels: u32, inputs: usize, outputs: usize) -> BlockMatrix {
    let mut matrix = BlockMatrix::new(channels, inputs, outputs);
    let mut rows: Vec<u32> = (0..outputs as u32).collect();
    (1..rows.len()).rev().for_each(|i| rows.swap(i, random.below(i + 1)));
    let mut left = &rows[..];
    while !left.is_empty() {
        let (now, later) = left.split_at(random.pick(&[1, 3, 16, 48, 64, 65, 256, 300]).min(left.len()));
        // Of either kind of columns, or of both.
        let [own, shared] = random.pick(&[[1, 0], [2, 7], [0, 7], [8, 16], [0, 9], [48, 0], [60, 70]]);
        let mut list = |count: usize| -> Vec<u32> { (0..count).map(|_| random.below(inputs) as u32).collect() };
        let [own, shared] = if channels == 3 { [list(own), list(shared)] } else { [vec![], list(own + shared)] };
        // Panels of very different size: each has a scale of its own.
        let size = random.magnitude(1e-9, 1e9);
        let mut values = |count: usize| -> Vec<f32> {
            (0..count * now.len()).map(|_| (size * random.between(-1.0, 1.0)) as f32).collect()
        };
        let tints = if channels == 3 { shared.len() } else { 0 };
        matrix.push(&Dense {
            rows: now,
            own: Columns { inputs: &own, values: &values(3 * own.len()) },
            shared: Columns { inputs: &shared, values: &values(shared.len()) },
            tints: &(0..tints).map(|_| random.vector(-1.0, 1.0).as_vec3()).collect::<Vec<Vec3>>(),
        });
        left = later;
    }
    matrix
}

/// Of absent lights that of the first.
fn addresses(pass: &mut Pass, buffers: &[Buffer<f32>]) -> [Write<f32>; MAX_LIGHTS_PER_PASS as usize] {
    let written: Vec<_> = buffers.iter().map(|buffer| pass.write(buffer)).collect();
    std::array::from_fn(|light| *written.get(light).unwrap_or(&written[0]))
}

struct Shape {
    wide: bool,
    places: usize,
    lights: usize,
    to_view: bool,
    pixel_count: usize,
    extra_stride: usize,
}

/// Runs the kernel on vectors of `places` lights side by side, of which the first `lights` are there.
fn multiply(
    gpu: &Gpu,
    frames: &mut Frames,
    matrix: &BlockMatrix,
    shape: &Shape,
    vector: &Buffer<Vec4>,
    [images, extras]: [&[Buffer<f32>]; 2],
) {
    let constants = MultiplyBlocksConstants {
        channels: matrix.channels,
        to_view_samples: shape.to_view,
        lights: shape.places as u32,
        wide: shape.wide,
    };
    let kernel = Kernel::<MultiplyBlocksPush>::new(gpu, constants).unwrap();
    let panels = Buffer::from_slice(gpu, "test panels", &matrix.panels).unwrap();
    let factors = Buffer::from_slice(gpu, "test factors", &matrix.values).unwrap();
    let inputs = Buffer::from_slice(gpu, "test inputs", &matrix.inputs).unwrap();
    let tints = Buffer::from_slice(gpu, "test tints", &matrix.tints).unwrap();
    let outputs = Buffer::from_slice(gpu, "test outputs", &matrix.outputs).unwrap();
    run(frames, |frame| {
        let mut pass = frame.pass("multiply");
        let push = MultiplyBlocksPush {
            panels: pass.read(&panels),
            values: pass.read(&factors),
            inputs: pass.read(&inputs),
            tints: pass.read(&tints),
            outputs: pass.read(&outputs),
            vector: pass.write(vector),
            images: addresses(&mut pass, images),
            extras: addresses(&mut pass, extras),
            panel_count: panels.len() as u32,
            pixel_stride: shape.pixel_count as u32,
            extra_stride: shape.extra_stride as u32,
            light_count: shape.lights as u32,
        };
        pass.dispatch(&kernel, &push, push.panel_count * GROUP_SIZE);
    });
}

/// Where this device's products can be computed.
fn sites(gpu: &Gpu) -> impl Iterator<Item = Site> {
    [Site::Device, Site::Host].into_iter().take(1 + usize::from(gpu.is_cpu()))
}

/// Forms of the kernel that the device can run: see [`MultiplyBlocksConstants::wide`].
fn forms(gpu: &Gpu) -> impl Iterator<Item = bool> {
    [false, true].into_iter().take(1 + usize::from(gpu.has_wide_subgroups()))
}

#[test]
fn multiply_blocks() {
    let gpu = gpu();
    let mut frames = Frames::new(&gpu).unwrap();
    let mut random = Random::new(9);
    let shapes = [(1, 1, false), (3, 130, true), (1, 3001, true), (3, 700, false), (1, 700, true), (3, 65, true)];
    // Alone, or with one of several lights absent; with light on all elements, or on so few that it is dark in many a
    // column group.
    let lit = [(1, 1, 1.0), (3, 4, 1.0), (1, 1, 0.1), (3, 4, 0.03), (1, 1, 0.0)];
    let cases = shapes.into_iter().flat_map(|shape| lit.map(|lit| (shape, lit)));
    // The narrow form works everywhere.
    let cases = cases.flat_map(|case| forms(&gpu).map(move |wide| (case, wide)));
    for (((channels, outputs, to_view), (lights, places, share)), wide) in cases {
        let inputs = 333;
        let extras: usize = if to_view { outputs / 3 } else { 0 };
        let (pixel_count, extra_stride) = (outputs - extras, extras.next_multiple_of(4));
        // What results in the vector comes behind what is multiplied.
        let length = if to_view { inputs } else { inputs + outputs };
        let mut matrix = random_matrix(&mut random, channels, inputs, outputs);
        if !to_view {
            [matrix.input_count, matrix.output_count] = [length as u32; 2];
            matrix.outputs.iter_mut().for_each(|o| *o += inputs as u32);
        }
        assert!(matrix.is_consistent());
        let of_element = |i| {
            let is_lit = i < places * inputs && random.unit() < share;
            if is_lit { random.vector(-1.0, 1.0).as_vec3().extend(0.0) } else { Vec4::ZERO }
        };
        let mut vector = Buffer::new(&gpu, "test vector", Access::HostWrites, places * length).unwrap();
        let values: Vec<Vec4> = (0..places * length).map(of_element).collect();
        vector.host_mut().copy_from_slice(&values);
        let image = |length: usize| {
            let mut image = output(&gpu, length);
            image.host_mut()[..length].fill(0.5);
            image
        };
        let images: Vec<_> = (0..lights).map(|_| image(3 * pixel_count)).collect();
        let extra_images: Vec<_> = (0..lights).map(|_| image(3 * extra_stride)).collect();
        let shape = Shape { wide, places, lights, to_view, pixel_count, extra_stride };
        multiply(&gpu, &mut frames, &matrix, &shape, &vector, [&images, &extra_images]);
        for light in 0..lights {
            let exact: Vec<DVec3> =
                values.iter().skip(light).step_by(places).map(|v| v.truncate().as_dvec3()).collect();
            let want = matrix.multiply(&exact);
            let magnitudes = matrix.multiply_magnitudes(&exact);
            for row in 0..outputs {
                let (got, before, place) = match () {
                    () if !to_view => {
                        let element = vector.host()[(inputs + row) * places + light];
                        (element.truncate().as_dvec3(), 0.0, inputs + row)
                    }
                    () if row < pixel_count => (pixel(images[light].host(), pixel_count, row), 0.5, row),
                    () => (pixel(extra_images[light].host(), extra_stride, row - pixel_count), 0.5, row),
                };
                // A rounding for each of at most 130 sums, and those of what was there before.
                let tolerance = 140.0 * ROUNDING * (magnitudes[place].max_element() + before);
                let error = largest((got - want[place] - before).abs().to_array());
                assert!(error <= tolerance, "row {row} of {outputs}: off by {error:.3e}, tolerance {tolerance:.3e}");
            }
            for buffer in [(&images[light], 3 * pixel_count), (&extra_images[light], 3 * extra_stride)] {
                assert!(buffer.0.host()[buffer.1..].iter().all(|&x| x == SENTINEL), "wrote past {} floats", buffer.1);
            }
        }
    }
}

/// As [`multiply_blocks`], on the host.
#[test]
fn products_on_the_host() {
    let mut random = Random::new(10);
    let shapes = [(1, 1, false), (3, 130, true), (1, 3001, true), (3, 700, false), (1, 700, true), (3, 65, true)];
    let lit = [(1, 1, 1.0), (2, 4, 1.0), (3, 4, 0.03), (4, 4, 0.1), (1, 1, 0.1), (1, 1, 0.0)];
    for ((channels, outputs, to_view), (lights, places, share)) in
        shapes.into_iter().flat_map(|shape| lit.map(|lit| (shape, lit)))
    {
        let inputs = 333;
        let extras: usize = if to_view { outputs / 3 } else { 0 };
        let (pixel_count, extra_stride) = (outputs - extras, extras.next_multiple_of(4));
        let mut matrix = random_matrix(&mut random, channels, inputs, outputs);
        if !to_view {
            matrix.outputs.iter_mut().for_each(|o| *o += inputs as u32);
            [matrix.input_count, matrix.output_count] = [(inputs + outputs) as u32; 2];
        }
        // Absent lights left anything in the vector.
        let of_element = |i| match i % places < lights && (i / places >= inputs || random.unit() >= share) {
            true => Vec4::ZERO,
            false => random.vector(-1.0, 1.0).as_vec3().extend(0.0),
        };
        let before: Vec<Vec4> = (0..places * (inputs + outputs)).map(of_element).collect();
        let mut vector = before.clone();
        let mut images = vec![(vec![0.5f32; 3 * pixel_count], vec![0.5f32; 3 * extra_stride]); lights];
        let of_images: Vec<ViewSampleRadiance> = images
            .iter_mut()
            .map(|(pixels, extras)| ViewSampleRadiance {
                pixels: SharedFloat::of(pixels),
                extras: SharedFloat::of(extras),
                pixel_stride: pixel_count,
                extra_stride,
            })
            .collect();
        let vectors = LightVectors { floats: SharedFloat::of(bytemuck::cast_slice_mut(&mut vector)), places, lights };
        let results = if to_view { Results::ToViewSamples(&of_images) } else { Results::ToVectors };
        host_product::multiply(&matrix, vectors, results);
        for light in 0..lights {
            let exact: Vec<DVec3> =
                before.iter().skip(light).step_by(places).map(|v| v.truncate().as_dvec3()).collect();
            let (want, magnitudes) = (matrix.multiply(&exact), matrix.multiply_magnitudes(&exact));
            for row in 0..outputs {
                let (pixels, extra_samples) = &images[light];
                let (got, before, place) = match () {
                    () if !to_view => {
                        (vector[(inputs + row) * places + light].truncate().as_dvec3(), 0.0, inputs + row)
                    }
                    () if row < pixel_count => (pixel(pixels, pixel_count, row), 0.5, row),
                    () => (pixel(extra_samples, extra_stride, row - pixel_count), 0.5, row),
                };
                // As in `multiply_blocks`.
                let tolerance = 140.0 * ROUNDING * (magnitudes[place].max_element() + before);
                let error = largest((got - want[place] - before).abs().to_array());
                assert!(error <= tolerance, "row {row} of {outputs}: off by {error:.3e}, tolerance {tolerance:.3e}");
            }
        }
        let unchanged = |i: usize| (i % places >= lights || i / places < inputs).then_some(i);
        assert!((0..vector.len()).filter_map(unchanged).all(|i| vector[i] == before[i]));
    }
}

/// Their factors are not numbers here; what absent lights left in the vector does not count as light.
#[test]
fn column_groups_in_the_dark_are_passed_over() {
    let gpu = gpu();
    let mut frames = Frames::new(&gpu).unwrap();
    let (columns, column_group) = (16, PANEL_COLUMNS as usize);
    let cases = [(1, 1), (2, 4), (3, 4)].into_iter().flat_map(|case| forms(&gpu).map(move |wide| (case, wide)));
    for ((lights, places), wide) in cases {
        let [own, shared]: [Vec<u32>; 2] = [(0..columns).collect(), (columns..2 * columns).collect()];
        let to = 2 * columns;
        let mut matrix = BlockMatrix::new(3, to as usize + 1, to as usize + 1);
        matrix.push(&Dense {
            rows: &[to],
            own: Columns { inputs: &own, values: &[1.0; 48] },
            shared: Columns { inputs: &shared, values: &[1.0; 16] },
            tints: &[Vec3::ONE; 16],
        });
        // Of one row: column groups of R, G and B in turn, then those that they share. The first of either kind are in
        // the dark.
        let factors = matrix.values.to_mut();
        [0, 1, 2, 6].into_iter().for_each(|place| factors[place] = UVec4::splat(0x7e00_7e00));
        let lit = |element: usize| element / column_group % 2 == 1;
        let values: Vec<Vec4> = (0..places * (to as usize + 1))
            .map(|i| if i % places >= lights || lit(i / places) { Vec4::ONE } else { Vec4::ZERO })
            .collect();
        let mut vector = Buffer::new(&gpu, "test vector", Access::HostWrites, values.len()).unwrap();
        vector.host_mut().copy_from_slice(&values);
        let images = [0, 1].map(|_| (0..lights).map(|_| output(&gpu, 1)).collect::<Vec<_>>());
        let shape = Shape { wide, places, lights, to_view: false, pixel_count: 1, extra_stride: 1 };
        multiply(&gpu, &mut frames, &matrix, &shape, &vector, images.each_ref().map(Vec::as_slice));
        for light in 0..lights {
            let got = vector.host()[to as usize * places + light];
            assert_eq!(got.truncate(), Vec3::splat(2.0 * column_group as f32), "light {light} of {lights}");
        }
        let mut vector: Vec<f32> = values.iter().flat_map(Vec4::to_array).collect();
        let floats = SharedFloat::of(&mut vector);
        host_product::multiply(&matrix, LightVectors { floats, places, lights }, Results::ToVectors);
        for light in 0..lights {
            let got = &vector[4 * (to as usize * places + light)..][..3];
            assert_eq!(got, [2.0 * column_group as f32; 3], "light {light} of {lights}, on the host");
        }
    }
}

#[test]
fn pieces_are_the_whole() {
    let mut random = Random::new(5);
    let matrix = random_matrix(&mut random, 3, 200, 2500);
    let vector: Vec<DVec3> = (0..200).map(|_| random.vector(-1.0, 1.0)).collect();
    let want = matrix.multiply(&vector);
    for bytes in [1, 20_000, usize::MAX] {
        let mut got = vec![DVec3::NAN; 2500];
        let pieces = matrix.pieces(bytes);
        assert!((bytes < usize::MAX) == (pieces.len() > 1));
        for range in pieces {
            let piece = matrix.piece(range);
            let part = BlockMatrix {
                channels: piece.channels,
                panels: piece.panels,
                inputs: piece.inputs.to_vec(),
                tints: piece.tints.to_vec(),
                outputs: piece.outputs.to_vec(),
                values: piece.values.to_vec().into(),
                ..matrix
            };
            assert!(part.is_consistent());
            let product = part.multiply(&vector);
            part.outputs.iter().for_each(|&o| got[o as usize] = product[o as usize]);
        }
        assert_eq!(got, want);
    }
}

#[test]
fn leading_columns_are_those_of_either_kind() {
    let mut random = Random::new(6);
    let [own, shared]: [Vec<u32>; 2] = [(0..16).collect(), (16..40).collect()];
    let rows: Vec<u32> = (0..70).collect();
    let mut values = |count: usize| -> Vec<f32> { (0..count).map(|_| random.between(-1.0, 1.0) as f32).collect() };
    let [of_own, of_shared] = [values(3 * 70 * 16), values(70 * 24)];
    let mut matrix = BlockMatrix::new(3, 40, 70);
    matrix.push(&Dense {
        rows: &rows,
        own: Columns { inputs: &own, values: &of_own },
        shared: Columns { inputs: &shared, values: &of_shared },
        tints: &(0..24).map(|_| random.vector(-1.0, 1.0).as_vec3()).collect::<Vec<Vec3>>(),
    });
    let vector: Vec<DVec3> = (0..40).map(|_| random.vector(-1.0, 1.0)).collect();
    // Half of two column groups, and of three.
    let lit = |i: usize| if i < 8 || (16..32).contains(&i) { vector[i] } else { DVec3::ZERO };
    let want = matrix.multiply(&(0..40).map(lit).collect::<Vec<_>>());
    let leading = matrix.leading(0.3, 0.5);
    assert!(leading.is_consistent());
    let (got, kept) = (leading.multiply(&vector), 24);
    assert!((0..70).all(|r| got[r] == if r < kept { want[r] } else { DVec3::ZERO }));
}

#[test]
fn indices_that_lead_nowhere_are_found() {
    let good = random_matrix(&mut Random::new(1), 3, 50, 400);
    assert!(good.is_consistent());
    let broken = |change: fn(&mut BlockMatrix)| {
        let mut matrix = good.clone();
        change(&mut matrix);
        assert!(!matrix.is_consistent());
    };
    broken(|m| m.inputs[7] = 50);
    broken(|m| m.outputs[7] = 400);
    broken(|m| m.outputs[7] = m.outputs[8]);
    broken(|m| m.channels = 2);
    broken(|m| m.channels = 1);
    broken(|m| m.tints[7].y = f32::NAN);
    broken(|m| m.tints.truncate(m.inputs.len() - 1));
    broken(|m| m.panels[0].own_column_group_count = m.panels[0].column_group_count + 1);
    broken(|m| m.panels[1].row_count = PANEL_ROWS + 1);
    broken(|m| m.panels.last_mut().unwrap().column_group_count += 1);
    broken(|m| m.panels[0].first_value = u32::MAX);
    broken(|m| m.values = m.values[1..].to_vec().into());
}

fn glossy(color: Vec3, roughness: f32, metallic: f32) -> Material {
    Material { base_color: color.extend(1.0), metallic, roughness, ..Default::default() }
}

/// A room with a rough floor, a glossy metal wall, a mirror, a glowing panel and a bent corner.
fn room() -> (Scene, relume::scene::Camera) {
    let mut build = Build::default();
    let white = build.material(lambert(Vec3::new(0.7, 0.6, 0.5)));
    let metal = build.material(glossy(Vec3::new(0.9, 0.6, 0.3), 0.35, 1.0));
    let plastic = build.material(glossy(Vec3::new(0.2, 0.5, 0.7), 0.5, 0.0));
    let glass = build.material(mirror(Vec3::ONE, 1.0));
    let glow = build.material(emitter(Vec3::new(2.0, 1.0, 0.5)));
    build.room(DVec3::ZERO, 1.0, white);
    build.quads[2].1 = plastic;
    build.quads[0].1 = metal;
    build.quad(DVec3::new(0.2, -0.3, -0.95), DVec3::X * 0.5, DVec3::Y * 0.5, glass);
    build.quad(DVec3::new(-0.6, 0.97, 0.3), DVec3::X * 0.2, -DVec3::Z * 0.2, glow);
    build.quad(DVec3::new(0.6, -0.6, -0.1), DVec3::new(0.2, 0.1, 0.1), DVec3::new(0.0, 0.3, -0.1), metal);
    let camera =
        look(DVec3::new(0.1, 0.1, 0.95), DVec3::new(0.0, -0.1, -1.0), DVec3::Y, Projection::Perspective { yfov: 1.3 });
    (build.scene(), camera)
}

fn lights() -> Rig {
    let point = Light::point("point", DVec3::new(-0.2, 0.6, 0.1));
    let spot = Light {
        kind: LightKind::Spot,
        direction: DVec3::new(0.4, -1.0, -0.3).normalize(),
        inner_angle: 0.2,
        outer_angle: 0.6,
        color: Vec3::new(0.5, 1.0, 0.25),
        intensity: 3.0,
        ..Light::point("spot", DVec3::new(-0.5, 0.8, 0.4))
    };
    rig(vec![point, spot])
}

/// Those, and two more: all of the one's light falls on one gather sample, and almost half of the other's.
fn lights_with_rays() -> Rig {
    let mut lights = lights().lights;
    lights.push(Light { name: "narrow".into(), inner_angle: 0.0, outer_angle: 0.01, ..lights[1].clone() });
    lights.push(Light::point("near a wall", DVec3::new(0.3, -0.98, 0.2)));
    rig(lights)
}

fn settings(samples: usize, coarse_samples: usize) -> TransferSettings {
    TransferSettings {
        outgoing: Outgoing::Glossy { functions: Some(9) },
        points: 5,
        ..transfer::settings(samples, coarse_samples, 64)
    }
}

#[test]
fn shade_gather() {
    let gpu = gpu();
    let (scene, camera) = room();
    let stage = Stage::new(scene, &camera, &lights(), &Setup::new(16, 16));
    let all_functions = TransferSettings { outgoing: Outgoing::Glossy { functions: None }, ..settings(700, 70) };
    let transfer = LightTransport::new(&stage.scene, &stage.framebuffer, &all_functions, &|_| ());
    let level = &transfer.fine;
    let length = level.coefficient_count();
    assert!(level.first.windows(2).any(|f| f[1] - f[0] > 9), "some sample is glossy");
    let framebuffer = Transfer::new(level, length, Vec::new());
    let samples = Buffer::from_slice(&gpu, "test samples", &framebuffer.samples).unwrap();
    let points = Buffer::from_slice(&gpu, "test points", &framebuffer.points).unwrap();
    let tables = Buffer::from_slice(&gpu, "test tables", &HarmonicProjection::get().tables()).unwrap();
    let points_per_sample = framebuffer.points_per_sample as u32;
    let kernels = [false, true].map(|soft| {
        let constants = ShadeGatherConstants { points_per_sample, soft, ..ShadeGatherConstants::default() };
        Kernel::<ShadeGatherPush>::new(&gpu, constants).unwrap()
    });
    let add_light_rays = Kernel::<AddLightRaysPush>::new(&gpu, ()).unwrap();
    let mut frames = Frames::new(&gpu).unwrap();
    // A factor of each sample, by powers of two: they round nothing.
    let factor = |sample: usize| [0, 1, 2].map(|c| 0.5f32.powi(((sample + c) % 3) as i32));
    let halves = |p: usize| {
        let [r, g, b] = factor(p / framebuffer.points_per_sample).map(|x| u32::from(half::f16::from_f32(x).to_bits()));
        UVec2::new(r | g << 16, b)
    };
    let factors: Vec<UVec2> = (0..framebuffer.points.len()).map(halves).collect();
    let factors = Buffer::from_slice(&gpu, "test factors", &factors).unwrap();
    let sample_of = |coefficient: usize| level.first.partition_point(|&first| first as usize <= coefficient) - 1;
    let sun = Light {
        kind: LightKind::Directional,
        direction: DVec3::new(0.5, -0.7, 0.1).normalize(),
        ..lights().lights[0].clone()
    };
    for (number, light) in lights_with_rays().lights.iter().chain([&sun]).enumerate() {
        let has_factors = number % 2 == 1;
        let factor = |coefficient: usize| match has_factors {
            true => Vec3::from(factor(sample_of(coefficient))),
            false => Vec3::ONE,
        };
        let packed = light.pack(stage.scene.space);
        let mut found = Vec::new();
        level.light_rays.shade(
            &*stage.scene,
            &framebuffer.samples,
            HarmonicProjection::get(),
            &[packed],
            None,
            |index, value| {
                found.push(Contribution { value: value * factor(index as usize), index });
            },
        );
        assert_eq!(found.is_empty(), light.kind == LightKind::Directional, "rays of {}", light.name);
        let copies = Buffer::from_slice(&gpu, "test points of a light", &[packed; SOFT_POINTS as usize]).unwrap();
        let mut visibility =
            Buffer::new(&gpu, "test visibility", Access::HostWrites, framebuffer.packets.len() * PACKET_SIZE / 4)
                .unwrap();
        trace_all(&*stage.scene, &packed, &framebuffer.packets, bytemuck::cast_slice_mut(visibility.host_mut()));
        let mut coefficients = output(&gpu, 4 * length);
        coefficients.host_mut()[..4 * length].fill(SENTINEL);
        run(&mut frames, |frame| {
            let mut pass = frame.pass("shade gather");
            let push = ShadeGatherPush {
                samples: pass.read(&samples),
                points: pass.read(&points),
                visibility: pass.read(&visibility),
                factors: pass.read(&factors),
                tables: pass.read(&tables),
                coefficients: pass.write_as(&coefficients),
                lights: pass.read(&copies),
                light: packed,
                sample_count: samples.len() as u32,
                stride: 1,
                offset: 0,
                per_solid_angle: per_solid_angle(&packed).unwrap_or(0.0),
                flags: u32::from(has_factors) * HAS_FACTORS,
            };
            // Interleaved points that are all the same are one.
            pass.dispatch(&kernels[number / 2 % 2], &push, push.sample_count);
            let contributions = frame.upload(&found);
            let mut pass = frame.pass("add light rays");
            let push = AddLightRaysPush {
                contributions,
                coefficients: pass.write_as(&coefficients),
                count: found.len() as u32,
                stride: 1,
                offset: 0,
                unused: 0,
            };
            pass.dispatch(&add_light_rays, &push, push.count);
        });
        let want = direct::shade(&stage.scene, level, &packed);
        let most = largest(want.iter().flat_map(|v| v.abs().to_array()));
        for (i, want) in want.iter().enumerate() {
            let want = *want * factor(i).as_dvec3();
            let got = DVec3::from_slice(&[0, 1, 2].map(|c| f64::from(coefficients.host()[4 * i + c])));
            let error = largest((got - want).abs().to_array());
            // Normals and tables in float32; where cosines are small the table is steep.
            assert!(error <= 2e-5 * most, "coefficient {i} of {}: {got}, want {want}", light.name);
        }
        assert!(coefficients.host()[4 * length..].iter().all(|&x| x == SENTINEL), "wrote past {length}");
    }
}

/// The indirect image of all lights, by [`LightTransport::apply`].
fn expected(stage: &Stage, transfer: &LightTransport, rig: &Rig) -> Vec<DVec3> {
    let framebuffer = &stage.framebuffer;
    let all: Vec<u32> = (0..framebuffer.samples.len() as u32).collect();
    let mut direct = vec![DVec3::ZERO; transfer.fine.coefficient_count()];
    for light in &rig.lights {
        let unit = direct::shade(&stage.scene, &transfer.fine, &light.pack(stage.scene.space));
        direct.iter_mut().zip(unit).for_each(|(sum, x)| *sum += light.scale().as_dvec3() * x);
    }
    resolved(stage, &transfer.apply(&[direct], &all, Lobe::All, &|_| ())[0])
}

fn resolved(stage: &Stage, radiance: &[DVec3]) -> Vec<DVec3> {
    let framebuffer = &stage.framebuffer;
    let (pixels, extras) = radiance.split_at(framebuffer.pixel_stride());
    let mut image = pixels.to_vec();
    resolve(
        &framebuffer.extra_pixels,
        &framebuffer.extra_indices,
        &framebuffer.extra_samples,
        extras,
        u32::MAX,
        &mut image,
    );
    row_by_row(stage, &image)
}

/// From tile order.
fn row_by_row(stage: &Stage, image: &[DVec3]) -> Vec<DVec3> {
    let tiling = stage.framebuffer.tiling;
    let mut rows = vec![DVec3::ZERO; (tiling.width * tiling.height) as usize];
    for (i, pixel) in image.iter().enumerate().filter(|(i, _)| tiling.contains(tiling.pixel(*i))) {
        let (x, y) = tiling.pixel(i);
        rows[(y * tiling.width + x) as usize] = *pixel;
    }
    rows
}

fn distance(got: &[[f32; 3]], want: &[DVec3]) -> f64 {
    let square = |v: DVec3| v.length_squared();
    let error: f64 = got.iter().zip(want).map(|(g, w)| square(Vec3::from(*g).as_dvec3() - w)).sum();
    (error / want.iter().map(|w| square(*w)).sum::<f64>()).sqrt()
}

#[test]
fn pictures_are_what_the_operator_says() {
    let gpu = gpu();
    for (coarse_samples, site) in [300, 60].into_iter().flat_map(|samples| sites(&gpu).map(move |site| (samples, site)))
    {
        let (scene, camera) = room();
        let setup = Setup { site: Some(site), ..Setup::new(41, 23) };
        let mut stage = Stage::new(scene, &camera, &lights(), &setup);
        let scene = stage.scene.clone();
        let framebuffer = stage.framebuffer.clone();
        let transfer = LightTransport::new(&scene, &framebuffer, &settings(300, coarse_samples), &|_| ());
        let dense = Transfer::dense(&transfer, &framebuffer, Lobe::All, &mut Journal::default(), &|_| ());
        assert!(dense.is_consistent(framebuffer.samples.len()));
        // As many points, in 64 bits.
        assert!(dense.sample_count().is_multiple_of(2));
        let wraps = Transfer { points_per_sample: dense.points_per_sample + (1 << 63), ..dense.clone() };
        assert!(!wraps.is_consistent(framebuffer.samples.len()));
        assert!(!framebuffer.extra_samples.is_empty(), "the mirror shows something");
        let without = pixels(&mut stage.relighter(&gpu, &lights(), &setup), Layers::All);

        stage.transfer = Some(Arc::new(dense));
        let mut relighter = stage.relighter(&gpu, &lights(), &setup);
        let want = expected(&stage, &transfer, &lights());
        let indirect = pixels(&mut relighter, Layers::Indirect);
        // Factors in float16 are off by 2^-11 of themselves at most, at random.
        let error = distance(&indirect, &want);
        assert!(error < 2e-4, "{coarse_samples} coarse samples: off by {error:.2e}");
        // Factors that the budget has no room for are read from host memory.
        let mut streamed = stage.relighter(&gpu, &lights(), &Setup { budget_bytes: Some(1), ..setup.clone() });
        assert_eq!(pixels(&mut streamed, Layers::Indirect), indirect);
        drop(streamed);

        // Passes add up: emitters' own image holds their indirect light.
        let all = pixels(&mut relighter, Layers::All);
        let emitted = relighter.linear(Picture::Emission).unwrap().to_vec();
        let seen: Vec<DVec3> = {
            let plain = Stage { scene: scene.clone(), framebuffer: framebuffer.clone(), transfer: None };
            let mut relighter = plain.relighter(&gpu, &lights(), &setup);
            relighter.linear(Picture::Emission).unwrap().iter().map(|p| Vec3::from(*p).as_dvec3()).collect()
        };
        let all_samples: Vec<u32> = (0..framebuffer.samples.len() as u32).collect();
        let emitters = transfer.emitted(&framebuffer, Lobe::All);
        let by_each = emitters.radiance(&transfer.rows(&all_samples, Lobe::All), &all_samples);
        let sum = |by_each: &[Vec3]| by_each.iter().map(|radiance| radiance.as_dvec3()).sum();
        let by_emitters = resolved(&stage, &by_each.chunks(emitters.count()).map(sum).collect::<Vec<DVec3>>());
        let want_emission: Vec<DVec3> = seen.iter().zip(&by_emitters).map(|(a, b)| a + b).collect();
        assert!(distance(&emitted, &want_emission) < 1e-5);
        let want_all: Vec<DVec3> = (0..all.len())
            .map(|i| Vec3::from(without[i]).as_dvec3() + Vec3::from(indirect[i]).as_dvec3() + by_emitters[i])
            .collect();
        assert!(distance(&all, &want_all) < 1e-5, "direct, reflection, indirect and emission add up");

        // Of light that falls on one sample, factors are not off at random; all four lights are made together.
        let mut relighter_of_rays = stage.relighter(&gpu, &lights_with_rays(), &setup);
        let error = distance(
            &pixels(&mut relighter_of_rays, Layers::Indirect),
            &expected(&stage, &transfer, &lights_with_rays()),
        );
        assert!(error < 2f64.powi(-11), "{coarse_samples} coarse samples, with light rays: off by {error:.2e}");
        drop(relighter_of_rays);

        // A light that moves leaves nothing behind.
        let mut moved = lights();
        moved.lights[1].position.x += 0.7;
        relighter.set_rig(&moved).unwrap();
        relighter.linear(Layers::Indirect).unwrap();
        relighter.set_rig(&lights()).unwrap();
        let back = relighter.linear(Layers::Indirect).unwrap();
        assert!(distance(back, &want) < 2e-4);
    }
}

/// What the device does with a transfer, in double precision.
fn applied(stage: &Stage, transfer: &LightTransport, framebuffer: &Transfer, light: &Light) -> Vec<DVec3> {
    framebuffer.apply(&direct::shade(&stage.scene, &transfer.fine, &light.pack(stage.scene.space)))
}

#[test]
fn compressed_pictures_are_what_the_factors_say() {
    let gpu = gpu();
    let (scene, camera) = room();
    let mut setup = Setup::new(48, 40);
    let mut stage = Stage::new(scene, &camera, &lights(), &setup);
    let (scene, framebuffer) = (stage.scene.clone(), stage.framebuffer.clone());
    let transfer = LightTransport::new(&scene, &framebuffer, &settings(900, 200), &|_| ());
    let compression = CompressionSettings { error: 0.03, lights: 64, lobe: Lobe::All, seed: 1 };
    let nested = Transfer::nested(&transfer, &compression, &mut Journal::default(), &|_| ()).unwrap();
    assert!(nested.is_consistent(framebuffer.samples.len()) && nested.haar && nested.chain.len() == 3);
    let [light] = &nested.emission[..] else { panic!("there is one emitter") };
    let by_emitters = resolved(&stage, &light.radiance.iter().map(|e| e.as_dvec3()).collect::<Vec<_>>());
    stage.transfer = Some(Arc::new(nested));
    let nested = stage.transfer.as_ref().unwrap();
    for site in sites(&gpu) {
        setup.site = Some(site);
        let mut relighter = stage.relighter(&gpu, &lights(), &setup);
        // Lights that are made together with others are the same to the last bit.
        let mut many = lights();
        for i in 0..3 {
            many.lights.extend(lights().lights.into_iter().map(|light| Light {
                name: format!("{} {i}", light.name),
                position: light.position + DVec3::new(0.0, 0.01 * f64::from(i), 0.0),
                ..light
            }));
        }
        let alone = |light| stage.relighter(&gpu, &many, &setup).linear(Picture::Light(light)).unwrap().to_vec();
        let mut together = stage.relighter(&gpu, &many, &setup);
        together.linear(Picture::Whole).unwrap();
        for light in 0..many.lights.len() {
            assert_eq!(together.linear(Picture::Light(light)).unwrap(), alone(light), "light {light}");
        }
        let indirect = |i| Request { layers: Layers::Indirect, ..Picture::Light(i).into() };
        for (i, light) in lights().lights.iter().enumerate() {
            let scale = light.scale().as_dvec3();
            let want: Vec<DVec3> =
                resolved(&stage, &applied(&stage, &transfer, nested, light)).into_iter().map(|p| scale * p).collect();
            let got = relighter.linear(indirect(i)).unwrap().to_vec();
            let error = distance(&got, &want);
            assert!(error < 1e-5, "{}: off by {error:.2e}", light.name);
            let exact = expected(&stage, &transfer, &rig(vec![light.clone()]));
            let error = distance(&got, &exact);
            assert!(error < 0.2, "{}: {error:.3} from what is compressed", light.name);
        }
    }
    // Emitters' light is not compressed.
    let emitted = stage.relighter(&gpu, &lights(), &setup).linear(Picture::Emission).unwrap().to_vec();
    let plain = Stage { transfer: None, ..stage };
    let seen = plain.relighter(&gpu, &lights(), &setup).linear(Picture::Emission).unwrap().to_vec();
    let want: Vec<DVec3> = seen.iter().zip(by_emitters).map(|(s, e)| Vec3::from(*s).as_dvec3() + e).collect();
    assert!(distance(&emitted, &want) < 1e-5);
}

/// The thesis's operator on the device, its factored BRDFs included, against the same on the CPU.
#[test]
fn pictures_of_the_thesis_are_what_its_operator_says() {
    let gpu = gpu();
    let (scene, camera) = room();
    let setup = Setup::new(24, 20);
    let mut stage = Stage::new(scene, &camera, &lights(), &setup);
    let (scene, framebuffer) = (stage.scene.clone(), stage.framebuffer.clone());
    let settings = ThesisSettings {
        outgoing: Outgoing::Glossy { functions: None },
        samples: 200,
        terms: Terms::Count(4),
        bounces: 3,
        seed: 1,
    };
    let thesis = Thesis::new(&scene, &framebuffer, &settings, &|_| ());
    let transfer = Transfer::thesis(&thesis, &framebuffer, Lobe::All, &mut Journal::default(), &|_| ());
    assert!(transfer.is_consistent(framebuffer.samples.len()) && !transfer.factored.is_empty());
    stage.transfer = Some(Arc::new(transfer));
    let mut relighter = stage.relighter(&gpu, &lights(), &setup);
    let all: Vec<u32> = (0..framebuffer.samples.len() as u32).collect();
    let rows = thesis.rows(&all, Lobe::All);
    relighter.linear(Layers::Indirect).unwrap(); // all lights together; each is looked at below
    for (i, light) in lights().lights.iter().enumerate() {
        let direct = shade_thesis(&scene, &thesis, &light.pack(scene.space));
        let scale = light.scale().as_dvec3();
        let want: Vec<DVec3> =
            resolved(&stage, &rows.multiply(&thesis.bounce(&direct))).into_iter().map(|p| scale * p).collect();
        let indirect = Request { layers: Layers::Indirect, ..Picture::Light(i).into() };
        let error = distance(relighter.linear(indirect).unwrap(), &want);
        // Factors in float16, and sums of terms of either sign.
        assert!(error < 1e-3, "{}: off by {error:.2e}", light.name);
    }
}

/// Shadow maps see gather samples as well as rays do, but for the width of a texel.
#[test]
fn shadow_maps_light_gather_samples() {
    let gpu = gpu();
    let (scene, camera) = room();
    let setup = Setup::new(24, 24);
    let mut stage = Stage::new(scene, &camera, &lights(), &setup);
    stage.transfer = Some(transfer::dense(&stage, &settings(300, 300)));
    let traced = pixels(&mut stage.relighter(&gpu, &lights(), &setup), Layers::Indirect);
    let maps = Setup { visibility: VisibilityMethod::Map, ..setup };
    let mapped = pixels(&mut stage.relighter(&gpu, &lights(), &maps), Layers::Indirect);
    let traced: Vec<DVec3> = traced.iter().map(|p| Vec3::from(*p).as_dvec3()).collect();
    let error = distance(&mapped, &traced);
    assert!(error > 0.0 && error < 0.03, "off by {error}");
}

#[test]
fn scenes_where_nothing_reflects_have_no_indirect_light() {
    let gpu = gpu();
    let mut build = Build::default();
    let glow = build.material(emitter(Vec3::ONE));
    build.room(DVec3::ZERO, 1.0, glow);
    let camera = look(DVec3::ZERO, DVec3::Z, DVec3::Y, Projection::Perspective { yfov: 1.0 });
    let setup = Setup::new(16, 16);
    let mut stage = Stage::new(build.scene(), &camera, &lights(), &setup);
    stage.transfer = Some(transfer::dense(&stage, &settings(100, 100)));
    let mut relighter = stage.relighter(&gpu, &lights(), &setup);
    assert!(pixels(&mut relighter, Layers::Indirect).iter().flatten().all(|v| *v == 0.0));
    assert!(pixels(&mut relighter, Layers::All).iter().flatten().all(|v| *v == 1.0));
}

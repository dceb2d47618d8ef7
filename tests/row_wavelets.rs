//! The largest wavelets of each row: the sparse product on the device against its twin, and the operator against the
//! dense one.

mod command;
mod common;

use std::sync::Arc;

use command::{Run, difference, folder, json, layer, mean, names_in, read_exr, relume};
use common::kernel::{ROUNDING, SENTINEL, output, pixel, run};
use common::random::Random;
use common::stage::{Build, Setup, Stage, lambert, look, mirror, pixels, rig};
use common::{gpu, largest, shipped, transfer};
use glam::{DVec3, Vec3, Vec4};
use relume::bake::baselines::row_wavelets::RowWavelets;
use relume::bake::compression::CompressionSettings;
use relume::bake::compression::haar::Haar;
use relume::bake::csr_matrix::CsrMatrix;
use relume::bake::framebuffer::view_samples::resolve;
use relume::bake::transfer::Transfer;
use relume::bake::transfer::sparse::SellMatrix;
use relume::bake::transport::direct;
use relume::bake::transport::directions::Lobe;
use relume::bake::transport::{LightTransport, Outgoing, TransferSettings};
use relume::gpu::{Buffer, Frames, Kernel};
use relume::relight::Layers;
use relume::scene::rig::Rig;
use relume::scene::{Light, Material, Projection};
use relume::shared::*;
use relume::storage::journal::Journal;

/// Rows of many lengths and magnitudes, some without terms, with columns near each other and far apart.
fn random_matrix(random: &mut Random, inputs: usize, outputs: usize) -> SellMatrix {
    let mut order: Vec<u32> = (0..outputs as u32).collect();
    (1..order.len()).rev().for_each(|i| order.swap(i, random.below(i + 1)));
    let mut matrix = SellMatrix::new(inputs, outputs);
    for window in order.chunks(150) {
        let row = |random: &mut Random| {
            let size = random.magnitude(1e-9, 1e9);
            let mut columns: Vec<u32> = (0..random.pick(&[0, 1, 2, 3, 17, 130]))
                .map(|_| {
                    let below = random.pick(&[50.min(inputs), inputs]);
                    random.below(below) as u32
                })
                .collect();
            columns.sort_unstable();
            columns.dedup();
            let values = columns.iter().map(|_| [0; 3].map(|_| (size * random.between(-1.0, 1.0)) as f32)).collect();
            CsrMatrix { first: vec![0, columns.len()], columns, values }
        };
        let rows = CsrMatrix::concatenated(window.iter().map(|_| row(random)).collect());
        matrix.push(&rows, window);
    }
    matrix
}

#[test]
fn multiply_sparse() {
    let gpu = gpu();
    let mut frames = Frames::new(&gpu).unwrap();
    let mut random = Random::new(3);
    let kernel = Kernel::<MultiplySparsePush>::new(&gpu, LightsConstants { lights: 1 }).unwrap();
    for (inputs, outputs) in [(1, 1), (60, 63), (333, 130), (200_000, 700)] {
        let extras: usize = outputs / 3;
        let (pixel_count, extra_stride) = (outputs - extras, extras.next_multiple_of(4));
        let matrix = random_matrix(&mut random, inputs, outputs);
        assert!(matrix.is_consistent());
        let values: Vec<Vec4> = (0..inputs).map(|_| random.vector(-1.0, 1.0).as_vec3().extend(0.0)).collect();
        let vector = Buffer::from_slice(&gpu, "test vector", &values).unwrap();
        let mut image = output(&gpu, 3 * pixel_count);
        image.host_mut()[..3 * pixel_count].fill(0.5);
        let mut extra_image = output(&gpu, 3 * extra_stride);
        extra_image.host_mut()[..3 * extra_stride].fill(0.5);
        let slices = Buffer::from_slice(&gpu, "test slices", &matrix.slices).unwrap();
        let terms = Buffer::from_slice(&gpu, "test terms", &matrix.values).unwrap();
        let output_list = Buffer::from_slice(&gpu, "test outputs", &matrix.outputs).unwrap();
        run(&mut frames, |frame| {
            let mut pass = frame.pass("multiply");
            let push = MultiplySparsePush {
                slices: pass.read(&slices),
                values: pass.read(&terms),
                outputs: pass.read(&output_list),
                vector: pass.read(&vector),
                images: [pass.write(&image); MAX_LIGHTS_PER_PASS as usize],
                extras: [pass.write(&extra_image); MAX_LIGHTS_PER_PASS as usize],
                slice_count: slices.len() as u32,
                pixel_stride: pixel_count as u32,
                extra_stride: extra_stride as u32,
                light_count: 1,
            };
            pass.dispatch(&kernel, &push, push.slice_count * GROUP_SIZE);
        });
        let exact: Vec<DVec3> = values.iter().map(|v| v.truncate().as_dvec3()).collect();
        let (want, magnitudes) = (matrix.multiply(&exact), matrix.multiply_magnitudes(&exact));
        for row in 0..outputs {
            let got = match row < pixel_count {
                true => pixel(image.host(), pixel_count, row),
                false => pixel(extra_image.host(), extra_stride, row - pixel_count),
            };
            // A rounding for each of at most 130 sums, and those of what was there before.
            let tolerance = 140.0 * ROUNDING * (magnitudes[row].max_element() + 0.5);
            let error = largest((got - want[row] - 0.5).abs().to_array());
            assert!(error <= tolerance, "row {row} of {outputs}: off by {error:.3e}, tolerance {tolerance:.3e}");
        }
        for (buffer, length) in [(&image, 3 * pixel_count), (&extra_image, 3 * extra_stride)] {
            assert!(buffer.host()[length..].iter().all(|&x| x == SENTINEL), "wrote past {length} floats");
        }
    }
}

/// Packed and multiplied, rows are what they were but for float16; cut into pieces too.
#[test]
fn rows_are_kept() {
    let mut random = Random::new(4);
    let (inputs, count) = (180_000, 300);
    let row = |_| {
        let mut columns: Vec<u32> = (0..random.below(40)).map(|_| random.below(inputs) as u32).collect();
        columns.sort_unstable();
        columns.dedup();
        let values = columns.iter().map(|_| [0; 3].map(|_| random.between(0.5, 1.0) as f32)).collect();
        CsrMatrix { first: vec![0, columns.len()], columns, values }
    };
    let rows = CsrMatrix::concatenated((0..count).map(row).collect());
    let mut matrix = SellMatrix::new(inputs, count);
    let outputs: Vec<u32> = (0..count as u32).rev().collect();
    matrix.push(&rows, &outputs);
    let vector: Vec<DVec3> = (0..inputs).map(|_| random.vector(0.5, 1.0)).collect();
    let got = matrix.multiply(&vector);
    for (r, want) in rows.multiply(&vector).into_iter().enumerate() {
        let error = largest((got[outputs[r] as usize] - want).abs().to_array());
        assert!(error <= want.max_element() / 2048.0, "row {r}: {} {want}", got[outputs[r] as usize]);
    }
    for bytes in [1, 9_000, usize::MAX] {
        let mut again = vec![DVec3::ZERO; count];
        let pieces = matrix.pieces(bytes);
        assert!((bytes < usize::MAX) == (pieces.len() > 1));
        for range in pieces {
            let piece = matrix.piece(range);
            let (outputs, values) = (piece.outputs.to_vec(), piece.values.to_vec());
            let part = SellMatrix { slices: piece.slices, outputs, values, ..matrix };
            assert!(part.is_consistent());
            let product = part.multiply(&vector);
            part.outputs.iter().for_each(|&o| again[o as usize] = product[o as usize]);
        }
        assert_eq!(again, got);
    }
}

#[test]
fn indices_that_lead_nowhere_are_found() {
    let good = random_matrix(&mut Random::new(1), 70_000, 400);
    assert!(good.is_consistent());
    let broken = |change: fn(&mut SellMatrix)| {
        let mut matrix = good.clone();
        change(&mut matrix);
        assert!(!matrix.is_consistent());
    };
    broken(|m| m.outputs[7] = 400);
    broken(|m| m.outputs[7] = m.outputs[8]);
    broken(|m| m.slices[1].row_count = GROUP_SIZE + 1);
    broken(|m| m.slices[0].pair_count += 1);
    broken(|m| m.slices.last_mut().unwrap().pair_count += 1);
    broken(|m| m.slices[0].first_value = u32::MAX);
    broken(|m| m.slices[0].first_output = u32::MAX - 64);
    broken(|m| drop(m.values.split_off(m.values.len() - 1)));
    // One step more, somewhere: the longest row's last column is no longer one.
    broken(|m| m.values[0].y |= 0xffff << 16);
    broken(|m| m.input_count = 1);
}

fn room() -> (relume::scene::Scene, relume::scene::Camera) {
    let mut build = Build::default();
    let wall = build.material(lambert(Vec3::new(0.7, 0.5, 0.3)));
    let metal = build.material(Material { metallic: 1.0, roughness: 0.5, ..Default::default() });
    let silver = build.material(mirror(Vec3::splat(0.9), 1.0));
    build.room(DVec3::ZERO, 1.0, wall);
    build.quad(DVec3::new(0.0, -0.9, 0.5), DVec3::X * 0.5, DVec3::NEG_Z * 0.3, metal);
    build.quad(DVec3::new(-0.4, 0.2, 0.9), DVec3::NEG_X * 0.3, DVec3::Y * 0.3, silver);
    let camera = look(DVec3::ZERO, DVec3::new(0.1, -0.1, 1.0), DVec3::Y, Projection::Perspective { yfov: 1.4 });
    (build.scene(), camera)
}

fn lights() -> Rig {
    rig(vec![Light::point("a", DVec3::new(-0.2, 0.6, 0.1)), Light::point("b", DVec3::new(0.5, -0.3, -0.4))])
}

fn settings(samples: usize, coarse_samples: usize) -> TransferSettings {
    TransferSettings {
        outgoing: Outgoing::Glossy { functions: Some(4) },
        ..transfer::settings(samples, coarse_samples, 128)
    }
}

fn to(error: f64) -> CompressionSettings {
    CompressionSettings { error, lights: 256, lobe: Lobe::All, seed: 1 }
}

fn relative(got: &[DVec3], want: &[DVec3]) -> f64 {
    let square = |v: &mut dyn Iterator<Item = DVec3>| v.map(|x| x.length_squared()).sum::<f64>();
    (square(&mut got.iter().zip(want).map(|(a, b)| *a - *b)) / square(&mut want.iter().copied())).sqrt()
}

#[test]
fn all_terms_are_the_dense_operator_and_fewer_are_as_close_as_asked() {
    let (scene, camera) = room();
    let stage = Stage::new(scene, &camera, &lights(), &Setup::new(40, 30));
    for samples in [400, 60] {
        let transfer = LightTransport::new(&stage.scene, &stage.framebuffer, &settings(samples, 60), &|_| ());
        let direct = |light: &PackedLight| direct::shade(&stage.scene, &transfer.fine, light);
        let haar = Haar::new(&transfer.fine.first);
        let all: Vec<u32> = (0..stage.framebuffer.samples.len() as u32).collect();
        let light = direct(&lights().lights[0].pack(stage.scene.space));
        let dense = transfer.apply(std::slice::from_ref(&light), &all, Lobe::All, &|_| ()).remove(0);
        let wavelets = RowWavelets::new(&transfer, &direct, &to(0.02));

        let (fewer, _, report) = wavelets.compress(&mut Journal::default(), &|_| ());
        let asked = report.noise.hypot(0.02);
        let error = relative(&fewer.multiply(&haar.terms(&light)), &dense);
        println!("{samples}: {} terms, {error:.4}, {report:?}", wavelets.kept);
        assert!(report.point > 0.3 * asked && report.point < 1.2 * asked, "{report:?}");
        assert!(error < 1.5 * asked);
        let looser = RowWavelets::new(&transfer, &direct, &to(0.3));
        assert!(looser.kept < 0.7 * wavelets.kept);

        let mut wavelets = RowWavelets::new(&transfer, &direct, &to(1e-6));
        wavelets.omitted_share = 0.0;
        let (whole, _, report) = wavelets.compress(&mut Journal::default(), &|_| ());
        let error = relative(&whole.multiply(&haar.terms(&light)), &dense);
        println!("all: {} terms, {error:.2e}, {report:?}", wavelets.kept);
        // Factors in float16 are off by 2^-11 of themselves at most, at random.
        assert!(whole.is_consistent() && error < 3e-4 && report.point < 3e-4, "{samples} samples");
        assert!(fewer.bytes() < whole.bytes());
    }
}

#[test]
fn pictures_are_what_the_terms_say() {
    let gpu = gpu();
    let (scene, camera) = room();
    let setup = Setup::new(41, 23);
    let mut stage = Stage::new(scene, &camera, &lights(), &setup);
    let (scene, framebuffer) = (stage.scene.clone(), stage.framebuffer.clone());
    assert!(!framebuffer.extra_samples.is_empty(), "the mirror shows something");
    let transfer = LightTransport::new(&scene, &framebuffer, &settings(700, 100), &|_| ());
    let on = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| Transfer::haar(&transfer, &to(0.05), |_| Ok(()), &mut Journal::default(), &|_| ()).unwrap())
    };
    let haar = on(1);
    assert!(haar.is_consistent(framebuffer.samples.len()) && haar.haar && haar.chain.is_empty());
    let (one, three) = (haar.sparse.as_ref().unwrap(), on(3).sparse.unwrap());
    assert!(one.values == three.values && one.outputs == three.outputs);

    let mut sum = vec![DVec3::ZERO; transfer.fine.coefficient_count()];
    for light in &lights().lights {
        let unit = direct::shade(&scene, &transfer.fine, &light.pack(scene.space));
        sum.iter_mut().zip(unit).for_each(|(sum, x)| *sum += light.scale().as_dvec3() * x);
    }
    let radiance = one.multiply(&Haar::new(&transfer.fine.first).terms(&sum));
    let (samples, extras) = radiance.split_at(framebuffer.pixel_stride());
    let mut image = samples.to_vec();
    resolve(
        &framebuffer.extra_pixels,
        &framebuffer.extra_indices,
        &framebuffer.extra_samples,
        extras,
        u32::MAX,
        &mut image,
    );
    let tiling = framebuffer.tiling;
    let mut want = vec![DVec3::ZERO; (tiling.width * tiling.height) as usize];
    for (i, radiance) in image.iter().enumerate().filter(|(i, _)| tiling.contains(tiling.pixel(*i))) {
        let (x, y) = tiling.pixel(i);
        want[(y * tiling.width + x) as usize] = *radiance;
    }
    stage.transfer = Some(Arc::new(haar));
    let got = pixels(&mut stage.relighter(&gpu, &lights(), &setup), Layers::Indirect);
    let got: Vec<DVec3> = got.iter().map(|p| Vec3::from(*p).as_dvec3()).collect();
    let error = relative(&got, &want);
    assert!(error < 1e-5, "off by {error:.2e}");
}

#[test]
fn on_the_command_line() {
    let folder = folder();
    let path = |name: &str| folder.path().join(name);
    let render = |arguments: &[&str]| {
        let mut command = relume();
        command.arg("render").arg(shipped("cornell-glossy.glb")).arg("-o").arg(path("a.exr")).args(arguments);
        command.args(["--gather", "120", "--rays", "32", "--size", "40x30", "--gi", "diffuse"]);
        command.args(["--passes", "indirect", "--cache"]).arg(path("cache")).arg("--stats").arg(path("a.json"));
        Run::of(&mut command)
    };
    let indirect = |arguments: &[&str]| {
        render(arguments).silent();
        layer(&read_exr(&path("a.exr")), "indirect")
    };
    let dense = indirect(&["--transfer", "dense"]);
    let haar = indirect(&["--transfer", "haar", "--error", "0.000001"]);
    let figures = json(&path("a.json"));
    let transfer = &figures["transfer"];
    assert_eq!(transfer["form"], "haar");
    assert!(transfer["held_out"]["worst_tile"].is_null(), "{transfer}");
    assert!(transfer["macs_per_pixel"].as_f64().unwrap() > 3.0 && figures["bake"]["cached"] == false);
    assert!(mean(&dense) > 0.0);
    let distance = dense.iter().zip(&haar).map(|(a, b)| (a - b).abs()).sum::<f32>() / dense.iter().sum::<f32>();
    // Two levels, where the dense operator has one, and noise that is left out.
    assert!(distance < 0.25, "{distance}");
    assert_eq!(indirect(&["--transfer", "haar", "--error", "0.000001"]), haar);
    assert_eq!(json(&path("a.json"))["bake"]["cached"], true);
    assert!(difference(&indirect(&["--transfer", "haar", "--error", "0.3"]), &haar) > 0.0);
    let files = names_in(&path("cache")).len();
    render(&["--transfer", "haar", "--method", "thesis"]).failed(&["--transfer haar", "dense"]);
    assert_eq!(names_in(&path("cache")).len(), files);
}

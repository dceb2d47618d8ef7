//! Every kernel on its own against its f64 twin, on random and ragged input; and what a frame checks.
//!
//! The shading of lights has a file of its own, tests/shade_light.rs.

mod common;

use common::kernel::{ANGLE, RAGGED, ROUNDING, SENTINEL, output, pixel, run};
use common::random::Random;
use common::{gpu, largest};
use glam::{DVec3, UVec2, Vec2, Vec3, Vec4};
use relume::gpu::{Access, Buffer, Frame, Frames, HostPass, Kernel};
use relume::physics::octahedral;
use relume::reference::{self, composite};
use relume::relight::indirect::host_sum;
use relume::shared::gpu_struct::Read;
use relume::shared::*;

/// As push constants hold them.
fn terms(given: impl IntoIterator<Item = (Vec3, Read<Vec4>)>) -> [SumTerm; MAX_TERMS as usize] {
    let mut terms: [SumTerm; MAX_TERMS as usize] = bytemuck::Zeroable::zeroed();
    for (i, (scale, image)) in given.into_iter().enumerate() {
        terms[i] = SumTerm { image, scale, unused: 0 };
    }
    terms
}

#[test]
fn resolve() {
    let gpu = gpu();
    let mut frames = Frames::new(&gpu).unwrap();
    let mut random = Random::new(3);
    let kernel = Kernel::<ResolvePush>::new(&gpu, ()).unwrap();
    for (case, &pixels) in RAGGED.iter().enumerate() {
        let extras = [0, 1, 5, 200, 3, 77, 20_000][case];
        let layers = [u32::MAX, 1, !1, 0b100][case % 4];
        let samples: Vec<ExtraSample> = (0..extras)
            .map(|_| ExtraSample { weight: random.color(), layer: random.pick(&[0, 1, 2, 3, 31, 40]) })
            .collect();
        // Every other pixel or so has a list, some empty; lists share samples out in random order.
        let mut indices = Vec::new();
        let mut listed = Vec::new();
        for pixel in 0..pixels as u32 {
            if random.below(2) == 0 {
                continue;
            }
            let first = indices.len() as u32;
            let count = if extras == 0 { 0 } else { random.below(6) as u32 };
            indices.extend((0..count).map(|_| random.below(extras) as u32));
            listed.push(ExtraPixel { pixel, first, count, first_weight: random.unit() as f32 });
        }
        let extra_stride = extras.next_multiple_of(4);
        let radiance: Vec<f32> = (0..3 * extra_stride).map(|_| random.unit() as f32).collect();
        let before: Vec<f32> = (0..3 * pixels).map(|_| random.unit() as f32).collect();
        let pixel_buffer = Buffer::from_slice(&gpu, "test pixels", &listed).unwrap();
        let index_buffer = Buffer::from_slice(&gpu, "test indices", &indices).unwrap();
        let sample_buffer = Buffer::from_slice(&gpu, "test samples", &samples).unwrap();
        let extra_buffer = Buffer::from_slice(&gpu, "test extras", &radiance).unwrap();
        let mut image = output(&gpu, 3 * pixels);
        image.host_mut()[..3 * pixels].copy_from_slice(&before);
        run(&mut frames, |frame| {
            let mut pass = frame.pass("resolve");
            let push = ResolvePush {
                pixels: pass.read(&pixel_buffer),
                indices: pass.read(&index_buffer),
                samples: pass.read(&sample_buffer),
                extras: pass.read(&extra_buffer),
                image: pass.write(&image),
                pixel_count: listed.len() as u32,
                pixel_stride: pixels as u32,
                extra_stride: extra_stride as u32,
                layers,
            };
            pass.dispatch(&kernel, &push, push.pixel_count);
        });
        let extras: Vec<DVec3> = (0..extras).map(|i| pixel(&radiance, extra_stride, i)).collect();
        let mut want: Vec<DVec3> = (0..pixels).map(|i| pixel(&before, pixels, i)).collect();
        relume::bake::framebuffer::view_samples::resolve(&listed, &indices, &samples, &extras, layers, &mut want);
        for (i, want) in want.iter().enumerate() {
            // Six products and their sum, all positive: a rounding each.
            let error = (pixel(image.host(), pixels, i) - want).abs();
            assert!(error.cmple(12.0 * ROUNDING * want).all(), "pixel {i} of {pixels}: off by {error}");
        }
        assert!(image.host()[3 * pixels..].iter().all(|&x| x == SENTINEL), "wrote past {pixels} pixels");
    }
}

#[test]
fn sum_images() {
    let gpu = gpu();
    let mut frames = Frames::new(&gpu).unwrap();
    let mut random = Random::new(4);
    let kernel = Kernel::<SumImagesPush>::new(&gpu, ()).unwrap();
    for (case, &quarter) in RAGGED.iter().enumerate() {
        let stride = 4 * quarter;
        for term_count in 0..=MAX_TERMS as usize {
            let kept = [0.0, 1.0, 0.375][(case + term_count) % 3];
            let terms: Vec<(Vec3, Vec<f32>)> = (0..term_count)
                .map(|_| (random.color(), (0..3 * stride).map(|_| random.unit() as f32).collect()))
                .collect();
            let buffers: Vec<_> =
                terms.iter().map(|(_, image)| Buffer::from_slice(&gpu, "test image", image).unwrap()).collect();
            let mut sum = output(&gpu, 3 * stride);
            sum.host_mut()[..3 * stride].fill(0.25);
            run(&mut frames, |frame| {
                let mut pass = frame.pass("sum");
                let push = SumImagesPush {
                    terms: crate::terms(terms.iter().zip(&buffers).map(|((scale, _), b)| (*scale, pass.read_as(b)))),
                    sum: pass.write_as(&sum),
                    term_count: term_count as u32,
                    plane_length: quarter as u32,
                    kept,
                    unused: 0,
                };
                pass.dispatch(&kernel, &push, 3 * push.plane_length);
            });
            let images: Vec<Vec<DVec3>> =
                terms.iter().map(|(_, image)| (0..stride).map(|i| pixel(image, stride, i)).collect()).collect();
            let mut want = vec![DVec3::splat(0.25 * f64::from(kept)); stride];
            let pairs: Vec<(Vec3, &[DVec3])> =
                terms.iter().zip(&images).map(|((scale, _), image)| (*scale, image.as_slice())).collect();
            reference::sum_images(&pairs, &mut want);
            for (i, want) in want.iter().enumerate() {
                // A product and a sum a term, all positive.
                let tolerance = (2 * term_count) as f64 * ROUNDING * want;
                let error = (pixel(sum.host(), stride, i) - want).abs();
                assert!(error.cmple(tolerance).all(), "pixel {i} of {stride}, {term_count} terms: off by {error}");
            }
            assert!(sum.host()[3 * stride..].iter().all(|&x| x == SENTINEL), "wrote past {stride} pixels");
            // The same on the host.
            let mut sum = vec![0.25; 3 * stride + 1];
            let read: Vec<(&[f32], Vec3)> = terms.iter().map(|(scale, image)| (&image[..], *scale)).collect();
            host_sum::sum(&mut sum, stride, &read, kept);
            for (i, want) in want.iter().enumerate() {
                let tolerance = (2 * term_count) as f64 * ROUNDING * want;
                let error = (pixel(&sum, stride, i) - want).abs();
                assert!(error.cmple(tolerance).all(), "pixel {i} of {stride}, {term_count} terms: off by {error}");
            }
            assert_eq!(sum[3 * stride], 0.25);
        }
    }
}

#[test]
fn compare_images() {
    let gpu = gpu();
    let mut frames = Frames::new(&gpu).unwrap();
    let mut random = Random::new(5);
    let kernel = Kernel::<CompareImagesPush>::new(&gpu, ()).unwrap();
    for count in RAGGED {
        for threads in [1, count.div_ceil(64), 64] {
            let mut image = || (0..count).map(|_| [0; 4].map(|_| random.between(-2.0, 2.0) as f32)).collect::<Vec<_>>();
            let images = [image(), image()];
            let buffers = images.each_ref().map(|image| {
                let vectors: Vec<Vec4> = image.iter().map(|&vector| Vec4::from(vector)).collect();
                Buffer::from_slice(&gpu, "test image", &vectors).unwrap()
            });
            let sums = output(&gpu, 2 * threads);
            run(&mut frames, |frame| {
                let mut pass = frame.pass("compare");
                let push = CompareImagesPush {
                    image: pass.read(&buffers[0]),
                    other: pass.read(&buffers[1]),
                    sums: pass.write_as(&sums),
                    count: count as u32,
                    threads: threads as u32,
                };
                pass.dispatch(&kernel, &push, push.threads);
            });
            let squares = |f: fn(f64, f64) -> f64| {
                let pairs = images[0].as_flattened().iter().zip(images[1].as_flattened());
                pairs.map(|(&a, &b)| f(a.into(), b.into()).powi(2)).sum::<f64>()
            };
            for (which, want) in [squares(|a, b| b - a), squares(|a, _| a)].into_iter().enumerate() {
                let sum: f64 = sums.host()[..2 * threads].iter().skip(which).step_by(2).map(|&x| f64::from(x)).sum();
                // A square and a sum a number, all positive.
                let tolerance = (4 * count.div_ceil(threads) + 2) as f64 * ROUNDING * want;
                assert!((sum - want).abs() <= tolerance, "{which} of {count} by {threads}: {sum} instead of {want}");
            }
            assert!(sums.host()[2 * threads..].iter().all(|&x| x == SENTINEL), "wrote past {threads} threads");
        }
    }
}

/// Pixel sizes that are a point, less than a tile, no whole number of tiles, lines, and whole tiles.
const SIZES: [(u32, u32); 6] = [(1, 1), (7, 3), (13, 7), (1, 65), (129, 1), (64, 48)];

#[test]
fn composite_sums_and_maps_tones() {
    let gpu = gpu();
    let mut frames = Frames::new(&gpu).unwrap();
    let mut random = Random::new(6);
    let table: Vec<UVec2> = (0..DISPLAY_TABLE_SIDE.pow(3))
        .map(|_| UVec2::new(random.below(1 << 32) as u32, random.below(1 << 16) as u32))
        .collect();
    let table_buffer = Buffer::from_slice(&gpu, "test table", &table).unwrap();
    for output_kind in [OUTPUT_LINEAR, OUTPUT_CLAMPED, OUTPUT_AGX, OUTPUT_PBR_NEUTRAL, OUTPUT_TABLE] {
        let kernel = Kernel::<CompositePush>::new(&gpu, OutputConstants { output: output_kind }).unwrap();
        for (width, height) in SIZES {
            let tiling = relume::bake::framebuffer::view_samples::Tiling { width, height };
            let stride = tiling.len();
            let count = 1 + random.below(MAX_TERMS as usize);
            // From a thousandth of black to a thousand times white; some black, some negative as a gather may leave it.
            let value = |random: &mut Random| match random.below(10) {
                0 => 0.0,
                1 => -random.magnitude(1e-6, 1e-2) as f32,
                _ => random.magnitude(1e-4, 1e3) as f32,
            };
            let images: Vec<Vec<f32>> =
                (0..count).map(|_| (0..3 * stride).map(|_| value(&mut random)).collect()).collect();
            let scales: Vec<Vec3> = (0..count).map(|_| random.color()).collect();
            let buffers: Vec<_> =
                images.iter().map(|image| Buffer::from_slice(&gpu, "test image", image).unwrap()).collect();
            let pixel_count = (width * height) as usize;
            let words = pixel_count * if output_kind == OUTPUT_LINEAR { 3 } else { 1 };
            let mut target: Buffer<u32> = Buffer::new(&gpu, "test picture", Access::HostReads, words + 64).unwrap();
            target.host_mut().fill(0x1234_5678);
            run(&mut frames, |frame| {
                let mut pass = frame.pass("composite");
                let push = CompositePush {
                    terms: terms(scales.iter().zip(&buffers).map(|(scale, b)| (*scale, pass.read_as(b)))),
                    target: pass.write(&target),
                    display_table: pass.read(&table_buffer),
                    term_count: scales.len() as u32,
                    width,
                    height,
                    blue_first: 0,
                };
                pass.dispatch_tiles(&kernel, &push, [width, height]);
            });
            assert!(target.host()[words..].iter().all(|&x| x == 0x1234_5678), "wrote past {width} x {height}");
            for at in 0..pixel_count {
                let place = tiling.index(at as u32 % width, at as u32 / width);
                let parts = || scales.iter().zip(&images).map(|(s, i)| s.as_dvec3() * pixel(i, stride, place));
                let sum: DVec3 = parts().sum();
                let size: DVec3 = parts().map(DVec3::abs).sum();
                if output_kind == OUTPUT_LINEAR {
                    let got: &[f32] = bytemuck::cast_slice(&target.host()[3 * at..3 * at + 3]);
                    let error = (pixel(got, 1, 0) - sum).abs();
                    assert!(error.cmple(6.0 * ROUNDING * size).all(), "pixel {at}: off by {error}");
                    continue;
                }
                // Rounding to 8 bits, and what Vulkan lets `pow` and `log2` be off by: 1e-4 of white. The table is
                // noise: rounding of 64 steps in single precision moves the place in it by 1e-5 of one.
                let want = 255.0 * composite::display(output_kind, sum, &table);
                let [r, g, b, alpha] = target.host()[at].to_le_bytes();
                let got = DVec3::new(r.into(), g.into(), b.into());
                let error = largest((got - want).abs().to_array());
                assert!(error <= 0.5 + 0.0255, "output {output_kind}, {sum}: {got}, not {want}");
                assert_eq!(alpha, 255);
            }
        }
    }
}

/// The twin of fit.comp, both ways: a tent of half-width max(ratio, 1), which for growing pictures is bilinear.
fn fitted(source: &[u32], [width, height]: [u32; 2], size: [u32; 2], at: u32) -> [f64; 4] {
    let axis = |place: u32, pixels: u32, target: u32| {
        let ratio = f64::from(pixels) / f64::from(target);
        let (center, support) = ((f64::from(place) + 0.5) * ratio - 0.5, ratio.max(1.0));
        let taps = ((center - support).ceil() as i64)..=((center + support).floor() as i64);
        let tap = move |i: i64| (i.clamp(0, i64::from(pixels) - 1) as usize, 1.0 - (i as f64 - center).abs() / support);
        taps.map(tap).collect::<Vec<_>>()
    };
    let (columns, rows) = (axis(at % size[0], width, size[0]), axis(at / size[0], height, size[1]));
    let (mut sum, mut weights) = ([0.0; 4], 0.0);
    for (y, weight_y) in &rows {
        for (x, weight_x) in &columns {
            let pixel = source[y * width as usize + x].to_le_bytes();
            (0..4).for_each(|c| sum[c] += weight_x * weight_y * f64::from(pixel[c]));
            weights += weight_x * weight_y;
        }
    }
    sum.map(|x| x / weights)
}

#[test]
fn fit() {
    let gpu = gpu();
    let mut frames = Frames::new(&gpu).unwrap();
    let mut random = Random::new(11);
    for (from, to) in [([7, 5], [7, 5]), ([7, 5], [20, 13]), ([64, 48], [33, 25]), ([1, 1], [9, 3]), ([50, 3], [7, 9])]
    {
        let shrinks = from[0] > to[0] || from[1] > to[1];
        let kernel = Kernel::<FitPush>::new(&gpu, FitConstants { shrinks }).unwrap();
        let pixels: Vec<u32> = (0..from[0] * from[1]).map(|_| random.below(1 << 32) as u32).collect();
        let source = Buffer::from_slice(&gpu, "test picture", &pixels).unwrap();
        let count = (to[0] * to[1]) as usize;
        let mut target: Buffer<u32> = Buffer::new(&gpu, "test picture", Access::HostReads, count + 64).unwrap();
        target.host_mut().fill(0x1234_5678);
        run(&mut frames, |frame| {
            let mut pass = frame.pass("fit");
            let push = FitPush {
                source: pass.read(&source),
                target: pass.write(&target),
                source_size: from.into(),
                target_size: to.into(),
            };
            pass.dispatch(&kernel, &push, count as u32);
        });
        assert!(target.host()[count..].iter().all(|&x| x == 0x1234_5678), "wrote past {to:?}");
        for at in 0..count {
            let want = fitted(&pixels, from, to, at as u32);
            let got = target.host()[at].to_le_bytes();
            for c in 0..4 {
                // Rounding to 8 bits, and of weights in single precision.
                let error = (f64::from(got[c]) - want[c]).abs();
                assert!(error < 0.51, "{from:?} to {to:?}, pixel {at}: {got:?}, not {want:?}");
            }
        }
    }
}

#[test]
fn yardstick() {
    let gpu = gpu();
    let mut frames = Frames::new(&gpu).unwrap();
    let mut random = Random::new(7);
    let kernel = Kernel::<YardstickPush>::new(&gpu, ()).unwrap();
    for count in RAGGED {
        let samples: Vec<Vec4> = (0..2 * count).map(|_| random.color().extend(random.unit() as f32)).collect();
        let sample_buffer = Buffer::from_slice(&gpu, "test samples", &samples).unwrap();
        let results = output(&gpu, 3 * count);
        run(&mut frames, |frame| {
            let mut pass = frame.pass("yardstick");
            let push = YardstickPush {
                samples: pass.read(&sample_buffer),
                results: pass.write(&results),
                sample_count: count as u32,
                multiply_adds: 128,
            };
            pass.dispatch(&kernel, &push, push.sample_count);
        });
        for i in 0..count {
            let (start, b) = (samples[2 * i].as_dvec4(), samples[2 * i + 1].as_dvec4());
            let a = (0..32).fold(start, |a, _| a * b + b);
            let want = DVec3::new(a.x, a.y, a.z + a.w);
            let error = (DVec3::from_slice(&[0, 1, 2].map(|c| f64::from(results.host()[3 * i + c]))) - want).abs();
            // 32 steps of two roundings each, all positive.
            assert!(error.cmple(65.0 * ROUNDING * want).all(), "sample {i} of {count}: off by {error}");
        }
        assert!(results.host()[3 * count..].iter().all(|&x| x == SENTINEL), "wrote past {count} samples");
    }
}

/// Chains of passes through few buffers: each must see what the one before wrote.
#[test]
fn passes_see_what_earlier_ones_wrote() {
    let gpu = gpu();
    let mut frames = Frames::new(&gpu).unwrap();
    let kernel = Kernel::<SumImagesPush>::new(&gpu, ()).unwrap();
    let quarter = 50_000;
    let mut buffers: Vec<Buffer<Vec4>> =
        (0..3).map(|_| Buffer::new(&gpu, "test chain", Access::HostReads, 3 * quarter).unwrap()).collect();
    buffers[0].host_mut().fill(Vec4::ONE);
    buffers[1].host_mut().fill(Vec4::ONE);
    run(&mut frames, |frame| {
        // Fibonacci: two reads, and a write over what was read two passes ago.
        for i in 0..20 {
            let mut pass = frame.pass("chain");
            let push = SumImagesPush {
                terms: terms([i, i + 1].map(|k| (Vec3::ONE, pass.read(&buffers[k % 3])))),
                sum: pass.write(&buffers[(i + 2) % 3]),
                term_count: 2,
                plane_length: quarter as u32,
                kept: 0.0,
                unused: 0,
            };
            pass.dispatch(&kernel, &push, 3 * push.plane_length);
        }
    });
    let last = buffers[21 % 3].host();
    assert!(last.iter().all(|&v| v == Vec4::splat(17_711.0)), "the 22nd Fibonacci number, not {}", last[0]);
    assert_eq!(frames.times().len(), 20);
}

#[test]
#[should_panic(expected = "reads \"test of nobody\", which nothing wrote")]
fn reading_what_nothing_wrote_stops() {
    let gpu = gpu();
    let mut frames = Frames::new(&gpu).unwrap();
    let buffer: Buffer<f32> = Buffer::new(&gpu, "test of nobody", Access::Device, 4).unwrap();
    let mut frame = frames.begin().unwrap();
    let _ = frame.pass("reader").read(&buffer);
}

#[test]
#[should_panic(expected = "declares \"test of two\" twice")]
fn reading_and_writing_in_one_pass_stops() {
    let gpu = gpu();
    let mut frames = Frames::new(&gpu).unwrap();
    let buffer = Buffer::from_slice(&gpu, "test of two", &[1.0f32]).unwrap();
    let mut frame = frames.begin().unwrap();
    let mut pass = frame.pass("both");
    let _ = pass.read(&buffer);
    let _ = pass.write(&buffer);
}

/// Passes of the device and of the host in turns, where kernels run on the CPU.
#[test]
fn passes_on_the_host_come_in_order() {
    let gpu = gpu();
    if !gpu.is_cpu() {
        return;
    }
    let mut frames = Frames::new(&gpu).unwrap();
    let kernel = Kernel::<SumImagesPush>::new(&gpu, ()).unwrap();
    let quarter = 5_000;
    let buffer = |access| Buffer::<Vec4>::new(&gpu, "test chain", access, 3 * quarter).unwrap();
    let mut first = buffer(Access::HostWrites);
    first.host_mut().fill(Vec4::ONE);
    let (middle, last) = (buffer(Access::Device), buffer(Access::HostReads));
    let mut frame = frames.begin().unwrap();
    let twice = |frame: &mut Frame, from: &Buffer<Vec4>, to: &Buffer<Vec4>| {
        let mut pass = frame.pass("twice");
        let push = SumImagesPush {
            terms: terms([(Vec3::splat(2.0), pass.read(from))]),
            sum: pass.write(to),
            term_count: 1,
            plane_length: quarter as u32,
            kept: 0.0,
            unused: 0,
        };
        pass.dispatch(&kernel, &push, 3 * push.plane_length);
    };
    twice(&mut frame, &first, &middle);
    for _ in 0..2 {
        let add_one = |pass: &HostPass| {
            let ones = pass.read(&first);
            pass.write(&middle).iter_mut().zip(ones).for_each(|(float, one)| *float += one);
        };
        frame.host_pass("add one", add_one).unwrap();
    }
    twice(&mut frame, &middle, &last);
    frame.finish().unwrap();
    assert!(last.host().iter().all(|&v| v == Vec4::splat(8.0)), "{}", last.host()[0]);
    let names: Vec<_> = frames.times().iter().map(|time| time.name).collect();
    assert_eq!(names, ["add one", "add one", "twice", "twice"]);
}

#[test]
#[should_panic(expected = "declares \"test of two\" twice")]
fn writing_twice_in_one_pass_stops() {
    let gpu = gpu();
    let mut frames = Frames::new(&gpu).unwrap();
    let buffer = Buffer::from_slice(&gpu, "test of two", &[1.0f32]).unwrap();
    let mut frame = frames.begin().unwrap();
    let mut pass = frame.pass("both");
    let _ = pass.write(&buffer);
    let _ = pass.write(&buffer);
}

/// lavapipe forgives a missing barrier and validation cannot see addresses, so the barriers themselves are counted.
#[test]
fn barriers_follow_from_declared_accesses() {
    let gpu = gpu();
    let mut frames = Frames::new(&gpu).unwrap();
    let kernel = Kernel::<YardstickPush>::new(&gpu, ()).unwrap();
    let samples = Buffer::from_slice(&gpu, "test samples", &[Vec4::ONE; 4]).unwrap();
    let (a, b) = (output(&gpu, 8), output(&gpu, 8));
    // Which buffer each pass reads (`None`: the samples) and writes, and the barriers up to and with it.
    let passes = [
        (None, &a, 0, "the first pass waits for nothing"),
        (None, &b, 0, "nor does one that touches other buffers"),
        (Some(&a), &b, 1, "reading and writing what was written"),
        (None, &a, 2, "writing what was read since the last barrier"),
        (None, &a, 3, "writing what was written"),
    ];
    for count in 1..=passes.len() {
        let mut frame = frames.begin().unwrap();
        for (read, written, ..) in &passes[..count] {
            let mut pass = frame.pass("pass");
            let push = YardstickPush {
                samples: match read {
                    Some(buffer) => pass.read_as(*buffer),
                    None => pass.read(&samples),
                },
                results: pass.write(*written),
                sample_count: 1,
                multiply_adds: 4,
            };
            pass.dispatch(&kernel, &push, 1);
        }
        frame.finish().unwrap();
        let (.., want, why) = passes[count - 1];
        assert_eq!(frames.barrier_count(), want, "{why}");
    }
}

/// What a panic leaves half recorded must not disturb the next frame.
#[test]
fn frames_go_on_after_one_was_dropped() {
    let gpu = gpu();
    let mut frames = Frames::new(&gpu).unwrap();
    let kernel = Kernel::<YardstickPush>::new(&gpu, ()).unwrap();
    let samples = Buffer::from_slice(&gpu, "test samples", &[Vec4::ONE; 2]).unwrap();
    let results = output(&gpu, 3);
    let record = |frame: &mut Frame| {
        let mut pass = frame.pass("yardstick");
        let push = YardstickPush {
            samples: pass.read(&samples),
            results: pass.write(&results),
            sample_count: 1,
            multiply_adds: 4,
        };
        pass.dispatch(&kernel, &push, 1);
    };
    record(&mut frames.begin().unwrap());
    assert_eq!(results.host()[0], SENTINEL, "a frame without `finish` does nothing");
    run(&mut frames, record);
    assert_eq!(results.host()[..3], [2.0, 2.0, 4.0]);
}

#[test]
fn octahedral_normals_decode_alike_on_both_sides() {
    let mut random = Random::new(8);
    for _ in 0..100_000 {
        let axis = random.pick(&[DVec3::X, DVec3::NEG_X, DVec3::Y, DVec3::NEG_Y, DVec3::Z, DVec3::NEG_Z]);
        let anywhere = random.direction();
        let v = random.pick(&[anywhere, axis, axis + 1e-5 * anywhere]).normalize();
        let e = octahedral::encode(v.as_vec3());
        let got = reference::octahedral(e);
        assert!(got.distance(v) < ANGLE, "{v} came back as {got}");
        // At a seam of the map both sides must fold alike.
        assert!(octahedral::decode(e).as_dvec3().distance(got) < ANGLE, "{e}");
    }
    assert_eq!(reference::octahedral(Vec2::ZERO), DVec3::Z);
}

/// glslang lets GLSL write through `readonly` references, which no barrier then waits for: every store to `.at[...]`
/// must go through a field of the kernel's push constants that is declared `Write`, also in what it includes.
#[test]
fn shaders_store_only_through_write_references() {
    let root = std::path::Path::new(env!("CARGO_MANIFEST_DIR"));
    let shared = std::fs::read_to_string(root.join("src/shared/mod.rs")).unwrap();
    let mut stores_seen = 0;
    for entry in std::fs::read_dir(root.join("glsl")).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            continue;
        }
        let source = with_includes(&std::fs::read_to_string(&path).unwrap(), &root.join("glsl"));
        let stores = stores(&source);
        stores_seen += stores.len();
        let kernel = path.file_stem().unwrap().to_str().unwrap();
        let wrong = stores_not_declared(&stores, kernel, &shared);
        assert!(wrong.is_empty(), "{} stores through {wrong:?}", path.display());
    }
    assert!(stores_seen >= 10, "only {stores_seen} stores found in all shaders");
}

/// A shader with the text of the files in `glsl/lib` that it includes.
fn with_includes(source: &str, folder: &std::path::Path) -> String {
    let line = |line: &str| match line.strip_prefix("#include \"lib/").and_then(|rest| rest.strip_suffix('"')) {
        Some(name) => with_includes(&std::fs::read_to_string(folder.join("lib").join(name)).unwrap(), folder),
        None => line.to_owned() + "\n",
    };
    source.lines().map(line).collect()
}

#[test]
fn stores_through_read_references_are_found() {
    let shared =
        "pub push P for kernel { pub a: Read<f32>, pub b: Write<f32>, pub c: [Write<f32>; 4], pub d: [Read<f32>; 4], }";
    let check = |code: &str| stores_not_declared(&stores(&format!("void main() {{ {code} }}")), "kernel", shared);
    let fine = [
        "push.b.at[i] = 1.0;",
        "push.b.at[i + n[2]].x += push.a.at[3];",
        "if (push.a.at[0] == 1.0) {}",
        "push.c[n[1]].at[i] += push.d[2].at[0];",
    ];
    for code in fine {
        assert!(check(code).is_empty(), "{code}");
    }
    let wrong = [
        "push.a.at[i] = 1.0;",
        "push.d[l].at[i] = 1.0;",
        "push.a.at[push.a.at[0]].xy *= 2.0;",
        "push.a.at[i]++;",
        "++push.a.at[i];",
        "Read_float r = push.a; r.at[0] = 1.0;",
        "Read_float(push.b).at[0]\n    = 1.0;",
        "atomicAdd(push.a.at[0], 1);",
    ];
    for code in wrong {
        assert_eq!(check(code).len(), 1, "{code}");
    }
}

/// What each store to `.at[...]` goes through: `push.field`, or whatever else it is.
fn stores(source: &str) -> Vec<String> {
    let uncommented: String =
        source.lines().map(|line| line.split("//").next().unwrap_or("").to_owned() + "\n").collect();
    let mut found = Vec::new();
    for (at, _) in uncommented.match_indices(".at[") {
        let before = &uncommented[..at];
        let base_start = start_of_expression(before);
        let base = &before[base_start..];
        let mut rest = after_bracket(&uncommented[at + 3..]).trim_start();
        // Members and elements of what is stored.
        loop {
            if let Some(member) = rest.strip_prefix('.') {
                rest = member.trim_start_matches(|c: char| c.is_alphanumeric() || c == '_').trim_start();
            } else if rest.starts_with('[') {
                rest = after_bracket(rest).trim_start();
            } else {
                break;
            }
        }
        let assigns = rest.starts_with('=') && !rest.starts_with("==");
        let compound = ["+=", "-=", "*=", "/=", "%=", "&=", "|=", "^=", "<<=", ">>=", "++", "--"];
        let lead = before[..base_start].trim_end();
        let called = lead.strip_suffix('(').unwrap_or("");
        let function = &called[start_of_expression(called)..];
        let steps = lead.ends_with("++") || lead.ends_with("--");
        if assigns || compound.iter().any(|op| rest.starts_with(op)) || steps || function.starts_with("atomic") {
            found.push(base.to_owned());
        }
    }
    found
}

/// Where the expression of names, dots, brackets and calls begins that ends `text`.
fn start_of_expression(text: &str) -> usize {
    let mut depth = 0;
    for (at, c) in text.char_indices().rev() {
        match c {
            ')' | ']' => depth += 1,
            '(' | '[' if depth > 0 => depth -= 1,
            _ if depth > 0 || c.is_alphanumeric() || c == '_' || c == '.' => {}
            _ => return at + c.len_utf8(),
        }
    }
    0
}

/// What follows the bracket that `text` begins with.
fn after_bracket(text: &str) -> &str {
    let mut depth = 0;
    for (at, c) in text.char_indices() {
        match c {
            '[' => depth += 1,
            ']' if depth == 1 => return &text[at + 1..],
            ']' => depth -= 1,
            _ => {}
        }
    }
    ""
}

fn stores_not_declared(stores: &[String], kernel: &str, shared: &str) -> Vec<String> {
    let mut pushes = shared.split("pub push ").skip(1);
    let push = pushes.find(|push| push.split([' ', '(']).nth(2) == Some(kernel));
    let fields = push.and_then(|push| push.split('}').next()).unwrap_or("");
    let is_written = |base: &str| {
        let (field, array) = match base.strip_prefix("push.").unwrap_or("").split_once('[') {
            Some((field, _)) => (field, "["),
            None => (base.strip_prefix("push.").unwrap_or(""), ""),
        };
        let is_of = |kind: &str| fields.contains(&format!("pub {field}: {array}{kind}<"));
        !field.is_empty() && (is_of("Write") || is_of("Exchange"))
    };
    stores.iter().filter(|base| !is_written(base)).cloned().collect()
}

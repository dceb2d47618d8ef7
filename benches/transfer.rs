//! Criterion benchmarks of the products that indirect light takes, by shape and bytes; set them against
//! `relume bench`'s copy rate.

use std::sync::Arc;
use std::time::Duration;

use criterion::{BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use glam::{Vec3, Vec4};
use relume::bake::transfer::blocks::{BlockMatrix, Columns, Dense};
use relume::gpu::{Access, Buffer, Context, Frames, Kernel, SharedFloat, Validation};
use relume::relight::indirect::host_product::{self, LightVectors, Results};
use relume::shared::*;

/// Blocks alike: how many, rows of each, columns with factors for each channel and with a tint, channels.
const SHAPES: [(&str, usize, usize, [usize; 2], u32); 4] = [
    ("project", 60, 200, [1000, 0], 3),
    ("project", 60, 200, [200, 800], 3),
    ("tiles", 1300, 48, [0, 200], 1),
    ("pixels", 1300, 256, [0, 48], 1),
];

fn products(criterion: &mut Criterion) {
    let context = Context::new(None, Validation::Off, None).expect("a Vulkan device");
    let mut group = criterion.benchmark_group("products");
    for (name, blocks, rows, columns, channels) in SHAPES {
        let matrix = matrix(blocks, rows, columns, channels);
        group.throughput(Throughput::Bytes(matrix.bytes() as u64));
        let shape = format!("{blocks} of {rows}x({}x3 + {})", columns[0], columns[1]);
        let mut vector = vec![1.0f32; 4 * matrix.input_count as usize];
        group.bench_function(BenchmarkId::new(name, format!("{shape}, on the host")), |bencher| {
            bencher.iter(|| {
                let vectors = LightVectors { floats: SharedFloat::of(&mut vector), places: 1, lights: 1 };
                host_product::multiply(&matrix, vectors, Results::ToVectors);
            });
        });
        for lights in [1, MAX_LIGHTS_PER_PASS] {
            let mut product = Product::new(&context, &matrix, lights);
            group.bench_function(
                BenchmarkId::new(name, if lights == 1 { shape.clone() } else { format!("{shape}, {lights} lights") }),
                |bencher| {
                    bencher.iter_custom(|iterations| (0..iterations).map(|_| product.run()).sum());
                },
            );
        }
    }
}

/// Inputs are strewn over a vector of 65,536.
fn matrix(blocks: usize, rows: usize, [own, shared]: [usize; 2], channels: u32) -> BlockMatrix {
    let count = 1 << 16;
    let mut matrix = BlockMatrix::new(channels, count + blocks * rows, count + blocks * rows);
    let values: Vec<f32> = (0..rows * (3 * own + shared)).map(|i| (i % 17) as f32 - 8.0).collect();
    let (of_own, of_shared) = values.split_at(3 * rows * own);
    let tints = vec![Vec3::splat(0.5); if channels == 3 { shared } else { 0 }];
    for block in 0..blocks {
        let inputs: Vec<u32> = (0..own + shared).map(|c| ((block + c) * 40_503 % count) as u32).collect();
        let rows: Vec<u32> = (0..rows).map(|r| (count + block * rows + r) as u32).collect();
        matrix.push(&Dense {
            rows: &rows,
            own: Columns { inputs: &inputs[..own], values: of_own },
            shared: Columns { inputs: &inputs[own..], values: of_shared },
            tints: &tints,
        });
    }
    matrix
}

struct Product {
    frames: Frames,
    kernel: Kernel<MultiplyBlocksPush>,
    panels: Buffer<Panel>,
    values: Buffer<glam::UVec4>,
    inputs: Buffer<u32>,
    tints: Buffer<Vec3>,
    outputs: Buffer<u32>,
    vector: Buffer<Vec4>,
    image: Buffer<f32>,
    extras: Buffer<f32>,
}

impl Product {
    fn new(context: &Arc<Context>, matrix: &BlockMatrix, lights: u32) -> Self {
        let vector = vec![Vec4::ONE; (lights * matrix.input_count) as usize];
        let channels = matrix.channels;
        let constants =
            MultiplyBlocksConstants { channels, to_view_samples: false, lights, wide: context.has_wide_subgroups() };
        let buffers = || -> relume::error::Result<Self> {
            Ok(Self {
                frames: Frames::new(context)?,
                kernel: Kernel::new(context, constants)?,
                panels: Buffer::from_slice(context, "panels", &matrix.panels)?,
                values: Buffer::from_slice(context, "values", &matrix.values)?,
                inputs: Buffer::from_slice(context, "inputs", &matrix.inputs)?,
                tints: Buffer::from_slice(context, "tints", &matrix.tints)?,
                outputs: Buffer::from_slice(context, "outputs", &matrix.outputs)?,
                vector: Buffer::from_slice(context, "vector", &vector)?,
                image: Buffer::new(context, "image", Access::Device, 4)?,
                extras: Buffer::new(context, "extras", Access::Device, 4)?,
            })
        };
        buffers().expect("the device has memory for a small matrix")
    }

    fn run(&mut self) -> Duration {
        let mut frame = self.frames.begin().expect("it did before");
        let mut pass = frame.pass("multiply");
        let push = MultiplyBlocksPush {
            panels: pass.read(&self.panels),
            values: pass.read(&self.values),
            inputs: pass.read(&self.inputs),
            tints: pass.read(&self.tints),
            outputs: pass.read(&self.outputs),
            vector: pass.write(&self.vector),
            images: [pass.write(&self.image); MAX_LIGHTS_PER_PASS as usize],
            extras: [pass.write(&self.extras); MAX_LIGHTS_PER_PASS as usize],
            panel_count: self.panels.len() as u32,
            pixel_stride: 0,
            extra_stride: 0,
            light_count: 0,
        };
        pass.dispatch(&self.kernel, &push, push.panel_count * GROUP_SIZE);
        frame.finish().expect("it did before");
        Duration::from_secs_f64(self.frames.times()[0].ms * 1e-3)
    }
}

criterion_group! {
    name = benches;
    config = Criterion::default().sample_size(20).measurement_time(Duration::from_secs(2));
    targets = products
}
criterion_main!(benches);

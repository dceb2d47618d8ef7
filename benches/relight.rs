//! Criterion benchmarks: each kernel on its own, shadow rays, whole frames. `relume bench` tells more of any scene.

use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use criterion::{BenchmarkId, Criterion, criterion_group, criterion_main};
use relume::gpu::Context;
use relume::relight::{Picture, RelightSettings, Relighter, VisibilityMethod};
use relume::trace::packet::{PACKET_SIZE, trace_packets};
use relume::{Session, SessionSettings};

struct Setup {
    session: Session,
    context: Arc<Context>,
}

impl Setup {
    fn new() -> Self {
        Self::of("balls-2.glb").expect("the scene ships with the project")
    }

    /// The furnished room, if `make_scenes` has made it.
    fn room() -> Option<Self> {
        let room = Self::of("generated/room.glb");
        if room.is_none() {
            println!("not run: the furnished room (cargo run --release --bin make_scenes -- scenes large)");
        }
        room
    }

    fn of(name: &str) -> Option<Self> {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes").join(name);
        let mut settings = SessionSettings { cache_dir: None, indirect: None, ..Default::default() };
        settings.open.size = Some([720, 480]);
        let session = Session::open(&path, None, &settings, &()).ok()?;
        let context = session.context(None).expect("a Vulkan device");
        Some(Self { session, context })
    }

    fn relighter(&self, visibility: VisibilityMethod) -> Relighter {
        let settings = RelightSettings { visibility, ..Default::default() };
        self.session
            .relighter(&self.context, &self.session.rig, &settings)
            .expect("the device has memory for a small picture")
    }
}

/// Passes of a frame in which one light moved, each by its own timestamps.
fn kernels(criterion: &mut Criterion) {
    let setup = Setup::new();
    let mut group = criterion.benchmark_group("kernels");
    for (visibility, passes) in [
        (VisibilityMethod::Traced, &["shade light", "resolve", "composite"][..]),
        (VisibilityMethod::Map, &["draw shadow map", "look up shadow map"][..]),
    ] {
        let mut relighter = setup.relighter(visibility);
        for pass in passes {
            group.bench_function(*pass, |bencher| {
                bencher.iter_custom(|iterations| {
                    (0..iterations).map(|i| frame_with_moved_light(&mut relighter, i, Some(pass))).sum()
                });
            });
        }
    }
}

fn frames(criterion: &mut Criterion) {
    let setup = Setup::new();
    let mut group = criterion.benchmark_group("frames");
    for visibility in [VisibilityMethod::Traced, VisibilityMethod::Map] {
        let mut relighter = setup.relighter(visibility);
        group.bench_function(BenchmarkId::new("move a light", format!("{visibility:?}")), |bencher| {
            let mut i = 0;
            bencher.iter(|| {
                i += 1;
                frame_with_moved_light(&mut relighter, i, None)
            });
        });
    }
    if let Some(room) = Setup::room() {
        let mut relighter = room.relighter(VisibilityMethod::Traced);
        group.bench_function(BenchmarkId::new("move a light", "Traced, furnished room"), |bencher| {
            let mut i = 0;
            bencher.iter(|| {
                i += 1;
                frame_with_moved_light(&mut relighter, i, None)
            });
        });
    }
    let mut relighter = setup.relighter(VisibilityMethod::Traced);
    group.bench_function("recolour a light", |bencher| {
        let mut rig = setup.session.rig.clone();
        bencher.iter(|| {
            rig.lights[0].stops = 1.0 - rig.lights[0].stops;
            relighter.set_rig(&rig).expect("no light was added");
            relighter.display(Picture::Whole).expect("it did before").len()
        });
    });
}

/// Makes a frame; returns what one pass of it took.
fn frame_with_moved_light(relighter: &mut Relighter, frame: u64, pass: Option<&str>) -> Duration {
    let mut rig = relighter.rig().clone();
    rig.lights[0].position.x += if frame.is_multiple_of(2) { 0.1 } else { -0.1 };
    relighter.set_rig(&rig).expect("no light was added");
    relighter.display(Picture::Whole).expect("it did before");
    let ms: f64 = relighter.times().iter().filter(|time| Some(time.name) == pass).map(|time| time.ms).sum();
    Duration::from_secs_f64(ms * 1e-3)
}

/// On one thread: the same rays in packets and singly.
fn shadow_rays(criterion: &mut Criterion) {
    let Session { scene, framebuffer, rig, .. } = Setup::new().session;
    let light = rig.lights[0].pack(scene.space);
    let packets = &framebuffer.packets;
    let mut visibility = vec![0; packets.len() * PACKET_SIZE];
    let mut group = criterion.benchmark_group("shadow rays");
    group.bench_function("packets", |bencher| {
        bencher.iter(|| trace_packets(&*scene, &light, packets, &mut visibility));
    });
    group.bench_function("singly", |bencher| {
        bencher.iter(|| {
            let rays =
                packets.iter().flat_map(|p| (0..PACKET_SIZE).filter_map(|lane| p.shadow_ray(&scene.bvh, &light, lane)));
            rays.filter(|ray| scene.occluded(ray.origin, ray.direction, ray.length)).count()
        });
    });
}

criterion_group! {
    name = benches;
    config = Criterion::default().sample_size(20).measurement_time(Duration::from_secs(2));
    targets = kernels, frames, shadow_rays
}
criterion_main!(benches);

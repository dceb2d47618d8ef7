//! Rays on the CPU: a scene's shadow rays, in packets and the same singly; the path tracer's segments; final gathers.

use std::time::Instant;

use rayon::prelude::*;
use relume::bake::transport::directions::Lobe;
use relume::bake::transport::{LightTransport, Outgoing, TransferSettings};
use relume::reference::path_tracer::{Filter, PathTracer, Settings};
use relume::session::{Session, cpu_seconds};
use relume::shared::PackedLight;
use relume::trace::packet::{PACKET_SIZE, trace_all};

use super::percentile::percentile;

/// Best times of tracing all lights' shadow rays, on all cores.
#[derive(serde::Serialize)]
pub struct RayTimes {
    /// Rays that face their light and lie in its cone.
    rays: usize,
    packets_ms: f64,
    singly_ms: f64,
    /// Of the rays, where the two disagree: both are right, but for edges that a ray meets within rounding.
    disagreements: usize,
}

const REPETITIONS: usize = 9;
const PACKETS_A_TASK: usize = 16;

pub fn measure(session: &Session) -> RayTimes {
    let lights: Vec<PackedLight> = session.rig.lights.iter().take(4).map(|l| l.pack(session.scene.space)).collect();
    let framebuffer = &session.framebuffer;
    let scene = &*session.scene;
    let mut visibility = vec![vec![0u8; framebuffer.packets.len() * PACKET_SIZE]; lights.len()];
    let mut singly = visibility.clone();
    let (mut packets_ms, mut singly_ms) = (Vec::new(), Vec::new());
    let mut rays = 0;
    for _ in 0..REPETITIONS {
        let start = Instant::now();
        for (light, visibility) in lights.iter().zip(&mut visibility) {
            trace_all(scene, light, &framebuffer.packets, visibility);
        }
        packets_ms.push(start.elapsed().as_secs_f64() * 1e3);

        let start = Instant::now();
        rays = 0;
        for (light, visibility) in lights.iter().zip(&mut singly) {
            rays += visibility
                .par_chunks_mut(PACKETS_A_TASK * PACKET_SIZE)
                .zip(framebuffer.packets.par_chunks(PACKETS_A_TASK))
                .map(|(visibility, packets)| {
                    let mut rays = 0;
                    for (packet, visibility) in packets.iter().zip(visibility.chunks_exact_mut(PACKET_SIZE)) {
                        for (lane, visible) in visibility.iter_mut().enumerate() {
                            *visible = 0;
                            if let Some(ray) = packet.shadow_ray(&scene.bvh, light, lane) {
                                rays += 1;
                                let share = scene.transmittance(ray.origin, ray.direction, ray.length);
                                *visible = (255.0 * share).round() as u8;
                            }
                        }
                    }
                    rays
                })
                .sum::<usize>();
        }
        singly_ms.push(start.elapsed().as_secs_f64() * 1e3);
    }
    let differ = |(a, b): (&Vec<u8>, &Vec<u8>)| a.iter().zip(b).filter(|(a, b)| a != b).count();
    RayTimes {
        rays,
        packets_ms: percentile(&mut packets_ms, 0.0),
        singly_ms: percentile(&mut singly_ms, 0.0),
        disagreements: visibility.iter().zip(&singly).map(differ).sum(),
    }
}

/// Path segments a CPU second, one being a closest-hit ray with its shading and shadow rays: best of a few runs on all
/// cores.
pub fn segments_per_s_core(session: &Session) -> f64 {
    let (width, height) = session.size();
    // A quarter of the picture's sides, and paths for about a second of one core.
    let (width, height) = (width.div_ceil(4), height.div_ceil(4));
    let samples_a_half = (150_000 / (width * height)).max(1) as u32;
    let settings = Settings {
        width: width as u32,
        height: height as u32,
        layers: session.framebuffer.asked_layers,
        max_bounces: None,
        filter: Filter::Centre,
        bounce_layers: 0,
        light_layers: false,
        seed: 1,
    };
    let rate = |_| {
        let tracer = PathTracer::new(&session.scene, &session.framebuffer.camera, &session.rig, &settings);
        let start = cpu_seconds();
        tracer.trace(samples_a_half, &|| false, &|_| ());
        // 0.01: the clock's tick, for scenes of nothing.
        tracer.segments() as f64 / (cpu_seconds() - start).max(0.01)
    };
    (0..3).map(rate).fold(0.0, f64::max)
}

/// Rays of final gathers a second on all cores, with what is done at their ends: best of a few runs.
pub fn gather_rays_per_s(session: &Session) -> f64 {
    let framebuffer = &session.framebuffer;
    let settings = TransferSettings {
        outgoing: Outgoing::Glossy { functions: None },
        samples: 1024,
        paths: TransferSettings::paths_for(1024),
        coarse_samples: 1024,
        points: 1,
        rays: 256,
        layers: framebuffer.asked_layers,
        bounces: None,
        seed: 1,
    };
    let transfer = LightTransport::new(&session.scene, framebuffer, &settings, &|_| ());
    let reflecting = framebuffer.reflecting();
    let some: Vec<u32> = reflecting.iter().step_by(reflecting.len().div_ceil(4096).max(1)).copied().collect();
    let gatherer = transfer.row_gatherer(Lobe::All);
    let rate = |_| {
        let start = Instant::now();
        gatherer.map(&some, |_| ());
        (some.len() * settings.rays as usize) as f64 / start.elapsed().as_secs_f64()
    };
    (0..3).map(rate).fold(0.0, f64::max)
}

impl std::fmt::Display for RayTimes {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { rays, packets_ms, singly_ms, disagreements } = self;
        let ratio = singly_ms / packets_ms;
        let rate = *rays as f64 / packets_ms * 1e-3;
        write!(
            f,
            "{rays}: in packets {packets_ms:.2} ms ({rate:.0} million a second), singly {singly_ms:.2} ms, ratio \
             {ratio:.2}; {disagreements} differ"
        )
    }
}

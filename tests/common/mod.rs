//! What several test programs need: a validated device, the shared scenes, scenes made in code.

// Each test program uses a part of this.
#![allow(dead_code)]

pub mod domes;
pub mod drawn;
pub mod kernel;
pub mod pictures;
pub mod random;
pub mod ratio;
pub mod stage;
pub mod transfer;

use std::ops::Deref;
use std::path::PathBuf;
use std::sync::{Arc, Mutex, MutexGuard, OnceLock, PoisonError};

use glam::Vec3;
use relume::gpu::{Context, Validation};
use relume::scene::Surface;

/// glTF's default dielectric or a metal, or a mixture, with a flat normal and no textures.
pub fn plain_surface(base_color: Vec3, metallic: f32, roughness: f32) -> Surface {
    Surface {
        base_color,
        alpha: 1.0,
        metallic,
        roughness,
        specular: 1.0,
        specular_color: Vec3::ONE,
        ior: 1.5,
        emissive: Vec3::ZERO,
        diffuse_weight: 1.0,
        normal_t: Vec3::Z,
    }
}

/// The one device of a test program, for one test at a time: its queue belongs to one thread. RELUME_DEVICE names it,
/// as --device would; default: the best one by its kind.
///
/// When it goes, the validation layer must have said nothing and everything made on the device must be gone; so take
/// it first.
pub struct Gpu {
    context: Arc<Context>,
    messages_before: usize,
    memory_before: Vec<(String, u64)>,
    _turn: MutexGuard<'static, ()>,
}

pub fn gpu() -> Gpu {
    static TURN: Mutex<()> = Mutex::new(());
    static CONTEXT: OnceLock<Arc<Context>> = OnceLock::new();
    // A test that panicked leaves nothing half done behind.
    let turn = TURN.lock().unwrap_or_else(PoisonError::into_inner);
    let open = || {
        let wanted = std::env::var("RELUME_DEVICE").ok();
        Context::new(wanted.as_deref(), Validation::On, None).expect("tools/setup installs a Vulkan device")
    };
    let context = CONTEXT.get_or_init(open).clone();
    if !context.is_validated() {
        not_run("Vulkan validation: its layer is not installed");
    }
    let messages_before = context.validation_messages().len();
    let memory_before = context.memory_by_owner();
    Gpu { context, messages_before, memory_before, _turn: turn }
}

impl Deref for Gpu {
    type Target = Arc<Context>;

    fn deref(&self) -> &Arc<Context> {
        &self.context
    }
}

impl Drop for Gpu {
    fn drop(&mut self) {
        if std::thread::panicking() {
            return;
        }
        let messages = self.context.validation_messages();
        assert!(messages.len() == self.messages_before, "validation: {:#?}", &messages[self.messages_before..]);
        assert_eq!(self.context.memory_by_owner(), self.memory_before, "device memory outlives its test");
    }
}

/// A file of the scenes and references that are not part of the repository, unless it is absent.
pub fn shared(path: &str) -> Option<PathBuf> {
    let default = || PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../shared"));
    let file = std::env::var_os("RELUME_SHARED").map_or_else(default, PathBuf::from).join(path);
    if file.exists() {
        return Some(file);
    }
    not_run(&format!("needs {path} among the shared files"));
    None
}

/// Tells what a test leaves out; tools/test collects these lines.
pub fn not_run(why: &str) {
    println!("not run: {}: {why}", std::thread::current().name().unwrap_or("?"));
}

/// How many damaged files an importer is given.
pub fn mutants() -> usize {
    if std::env::var_os("RELUME_FULL").is_some() { 10_000 } else { 500 }
}

/// A scene of this repository.
pub fn shipped(name: &str) -> PathBuf {
    PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/scenes")).join(name)
}

/// Where tests leave pictures of what went wrong.
pub fn output_dir() -> PathBuf {
    let dir = PathBuf::from(env!("CARGO_TARGET_TMPDIR"));
    std::fs::create_dir_all(&dir).expect("cargo made the folder above");
    dir
}

/// The largest of some numbers, 0 of none; not a number if one of them is not, which the standard's `max` passes over.
pub fn largest(numbers: impl IntoIterator<Item = f64>) -> f64 {
    numbers.into_iter().reduce(|most, x| if most.is_nan() || most >= x { most } else { x }).unwrap_or(0.0)
}

/// Asserts that two values agree to `tolerance` of the second.
#[track_caller]
pub fn assert_near(got: f64, want: f64, tolerance: f64, what: impl std::fmt::Display) {
    let error = (got - want).abs();
    assert!(error <= tolerance * want.abs(), "{what}: got {got}, want {want}, off by {:.3e}", error / want.abs());
}

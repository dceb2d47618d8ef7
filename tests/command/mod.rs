//! Runs the relume binary on small pictures and looks at what it says.

// Every test binary compiles this for itself and uses its own part of it.
#![allow(dead_code)]

use std::ffi::OsStr;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use relume::image::{Image, exr, png};
use serde_json::Value;

/// What a run of relume left.
pub struct Run {
    pub code: Option<i32>,
    pub stdout: String,
    pub stderr: String,
}

/// The binary, whose caches are under `target`.
pub fn relume() -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_relume"));
    command.env("XDG_CACHE_HOME", Path::new(env!("CARGO_TARGET_TMPDIR")).join("cache"));
    command.env("COLUMNS", "80").env_remove("RUST_BACKTRACE");
    command
}

/// Runs relume with arguments of any kind.
#[macro_export]
macro_rules! run {
    ($($argument:expr),* $(,)?) => {
        $crate::command::Run::of($crate::command::relume().args([""; 0])$(.arg($argument))*)
    };
}

/// Renders a scene at 64x48 without a cache; more arguments follow.
#[macro_export]
macro_rules! render {
    ($scene:expr, $output:expr $(, $argument:expr)* $(,)?) => {
        run!("render", $scene, "-o", $output, "--size", "64x48", "--no-cache" $(, $argument)*)
    };
}

/// Baking indirect light takes many seconds: a command that says nothing of it is run without.
pub fn without_indirect(command: &mut Command) -> &mut Command {
    let bakes = ["render", "bake", "view", "bench"].map(OsStr::new);
    let is_gi = |argument: &OsStr| argument.as_encoded_bytes().starts_with(b"--gi");
    if command.get_args().next().is_some_and(|a| bakes.contains(&a)) && !command.get_args().any(is_gi) {
        command.args(["--gi", "off"]);
    }
    command
}

impl Run {
    #[track_caller]
    pub fn of(command: &mut Command) -> Self {
        let output = without_indirect(command).output().unwrap();
        Self::from(output)
    }

    /// The warnings among the lines of stderr.
    pub fn warnings(&self) -> Vec<&str> {
        self.stderr.lines().filter(|line| line.starts_with(" WARN ")).collect()
    }

    /// Done, and without a word on stderr.
    #[track_caller]
    pub fn silent(self) -> Self {
        assert_eq!(self.stderr, "", "status {:?}", self.code);
        self.done()
    }

    #[track_caller]
    pub fn done(self) -> Self {
        assert_eq!(self.code, Some(0), "{}", self.stderr);
        self.sane()
    }

    /// Failed: status 1, and one line that holds all of `says`.
    #[track_caller]
    pub fn failed(self, says: &[&str]) -> Self {
        assert_eq!(self.code, Some(1), "{}{}", self.stderr, self.stdout);
        let lines: Vec<_> = self.stderr.lines().filter(|line| !line.starts_with(" WARN ")).collect();
        assert_eq!(lines.len(), 1, "{}", self.stderr);
        assert!(lines[0].starts_with("relume: "), "{}", lines[0]);
        for part in says {
            assert!(lines[0].contains(part), "says: {}\nnot: {part}", lines[0]);
        }
        self.sane()
    }

    /// Refused as bad usage, with a text that holds `says`.
    #[track_caller]
    pub fn refused(self, says: &str) -> Self {
        assert_eq!(self.code, Some(2), "{}", self.stderr);
        assert!(self.stderr.contains(says), "says: {}\nnot: {says}", self.stderr);
        self.sane()
    }

    #[track_caller]
    pub fn sane(self) -> Self {
        assert!(self.code.is_some(), "ended by a signal: {}", self.stderr);
        assert!(!self.stderr.contains("panicked"), "{}", self.stderr);
        self
    }
}

impl From<Output> for Run {
    fn from(output: Output) -> Self {
        Self {
            code: output.status.code(),
            stdout: String::from_utf8_lossy(&output.stdout).into_owned(),
            stderr: String::from_utf8_lossy(&output.stderr).into_owned(),
        }
    }
}

pub fn folder() -> tempfile::TempDir {
    tempfile::tempdir().unwrap()
}

/// A scene that comes with relume.
pub fn shipped(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes").join(name)
}

/// Writes a shipped scene with another camera, that looks as its first one does from another place.
pub fn with_second_camera(scene: &str, name: &str, translation: [f64; 3], output: &Path) -> PathBuf {
    let glb = std::fs::read(shipped(scene)).unwrap();
    let length = u32::from_le_bytes(glb[12..16].try_into().unwrap()) as usize;
    let mut scene: Value = serde_json::from_slice(&glb[20..20 + length]).unwrap();
    let nodes = scene["nodes"].as_array_mut().unwrap();
    let mut second = nodes.iter().find(|node| node["camera"].is_u64()).unwrap().clone();
    second["name"] = name.into();
    second["translation"] = serde_json::json!(translation);
    let index = nodes.len();
    nodes.push(second);
    scene["scenes"][0]["nodes"].as_array_mut().unwrap().push(index.into());
    let mut text = scene.to_string().into_bytes();
    text.resize(text.len().next_multiple_of(4), b' ');
    let rest = &glb[20 + length..];
    let all = (20 + text.len() + rest.len()) as u32;
    let header = [&glb[..8], &all.to_le_bytes(), &(text.len() as u32).to_le_bytes(), b"JSON"].concat();
    std::fs::write(output, [&header[..], &text, rest].concat()).unwrap();
    output.to_owned()
}

/// Manifest of the second Vulkan driver, where tools/setup found it.
pub const SWIFTSHADER: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/.deps/swiftshader/vk_swiftshader_icd.json");

#[track_caller]
pub fn json(path: &Path) -> Value {
    parse(&std::fs::read_to_string(path).unwrap_or_else(|e| panic!("{}: {e}", path.display())))
}

#[track_caller]
pub fn parse(text: &str) -> Value {
    serde_json::from_str(text).unwrap_or_else(|e| panic!("{e}: {text}"))
}

#[track_caller]
pub fn read_exr(path: &Path) -> Image {
    exr::read(path).unwrap_or_else(|e| panic!("{e}"))
}

#[track_caller]
pub fn read_png(path: &Path) -> Vec<[u8; 4]> {
    png::read(path).unwrap_or_else(|e| panic!("{e}")).rgba
}

/// The floats of one layer of an EXR.
#[track_caller]
pub fn layer(image: &Image, name: &str) -> Vec<f32> {
    let names: Vec<_> = image.layers.iter().map(|layer| layer.name.as_str()).collect();
    let layer = image.layer(name).unwrap_or_else(|| panic!("no layer {name} in {names:?}"));
    layer.pixels.as_flattened().to_vec()
}

pub fn mean(values: &[f32]) -> f64 {
    values.iter().map(|&v| f64::from(v)).sum::<f64>() / values.len() as f64
}

/// Largest difference over the largest value; all values are finite.
#[track_caller]
pub fn difference(a: &[f32], b: &[f32]) -> f32 {
    assert_eq!(a.len(), b.len());
    assert!(a.iter().chain(b).all(|x| x.is_finite()), "not all values are finite");
    let largest = a.iter().chain(b).fold(f32::MIN_POSITIVE, |m, v| m.max(v.abs()));
    a.iter().zip(b).fold(0.0, |m: f32, (a, b)| m.max((a - b).abs())) / largest
}

/// Names of what a folder holds, sorted.
pub fn names_in(folder: &Path) -> Vec<String> {
    let entries = std::fs::read_dir(folder).unwrap();
    let mut names: Vec<_> = entries.map(|entry| entry.unwrap().file_name().to_string_lossy().into_owned()).collect();
    names.sort();
    names
}

/// Runs a shell script as root of mounts of its own; `None`, and a line that says so, where that is not permitted.
///
/// The script ends with status 77 if it cannot mount. `$0` is relume, `$1` and so on are `arguments`.
pub fn with_own_mounts(what: &str, script: &str, arguments: &[&OsStr]) -> Option<Run> {
    for namespaces in [&["--user", "--map-root-user", "--mount"][..], &["--mount"]] {
        let mut command = Command::new("unshare");
        command.args(namespaces).args(["sh", "-c", script, env!("CARGO_BIN_EXE_relume")]).args(arguments);
        let Ok(output) = command.env_remove("RUST_BACKTRACE").output() else { break };
        // unshare itself ends with 1 where it is not permitted, and then the script has said nothing.
        if output.status.code() != Some(77) && !(output.status.code() == Some(1) && output.stdout.is_empty()) {
            return Some(output.into());
        }
    }
    println!("not run: {what}: no file system can be mounted here");
    None
}

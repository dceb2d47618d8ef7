//! A display without a screen, a small window manager, and a person's hands: Xvfb, openbox, xdotool.

// Every test binary compiles this for itself and uses its own part of it.
#![allow(dead_code)]

pub mod pictures;

use std::fs::File;
use std::io::{BufRead, BufReader, Read};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use crate::command::without_indirect;
use x11rb::connection::Connection;
use x11rb::protocol::xproto::{ConnectionExt, ImageFormat};
use x11rb::rust_connection::RustConnection;

pub struct Desktop {
    display: String,
    manager: Child,
    server: Child,
}

/// Longest that a window may take to do anything; machines are shared.
const PATIENCE: Duration = Duration::from_secs(60);

/// Servers that come and go at the same time take the same number for free: one after another, among all processes.
fn turn() -> File {
    let file = File::create(std::env::temp_dir().join("relume-xvfb-turn")).unwrap();
    file.lock().unwrap();
    file
}

impl Desktop {
    /// `None`, and a line that says so, where the programs are missing.
    pub fn start() -> Option<Self> {
        let _turn = turn();
        let mut server = match Command::new("Xvfb")
            .args(["-displayfd", "1", "-screen", "0", "1400x900x24", "-nolisten", "tcp"])
            .args(["-r", "-noreset"]) // no key repeats by itself; nothing starts anew when a client goes
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn()
        {
            Ok(server) => server,
            Err(error) => {
                println!("not run: the window, since Xvfb does not start: {error}");
                return None;
            }
        };
        let mut number = String::new();
        BufReader::new(server.stdout.as_mut().unwrap()).read_line(&mut number).unwrap();
        let display = format!(":{}", number.trim());
        let manager = Command::new("openbox")
            .env("DISPLAY", &display)
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .expect("tools/setup installs openbox beside Xvfb");
        let desktop = Self { display, manager, server };
        // A window that comes while the manager takes over may be lost to it.
        let start = Instant::now();
        while desktop.xdotool(&["get_num_desktops"]).is_empty() {
            assert!(start.elapsed() < PATIENCE, "openbox does not start");
            std::thread::sleep(Duration::from_millis(20));
        }
        Some(desktop)
    }

    /// Runs relume here, watched by the validation layer.
    pub fn relume(&self, arguments: &[&str]) -> App<'_> {
        let child = self.command(arguments).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn();
        App { child: child.unwrap(), desktop: self, window: String::new() }
    }

    /// Runs relume here to its end.
    pub fn output(&self, arguments: &[&str]) -> std::process::Output {
        self.command(arguments).output().unwrap()
    }

    /// Runs relume here to its end, with a fault that it is to meet.
    pub fn faulty(&self, arguments: &[&str], fault: &str) -> std::process::Output {
        self.command(arguments).env("RELUME_FAULT", fault).output().unwrap()
    }

    fn command(&self, arguments: &[&str]) -> Command {
        let mut command = Command::new(env!("CARGO_BIN_EXE_relume"));
        command
            .args(arguments)
            .env("DISPLAY", &self.display)
            .env_remove("WAYLAND_DISPLAY")
            .env("XDG_CACHE_HOME", Path::new(env!("CARGO_TARGET_TMPDIR")).join("cache"))
            .env("VK_INSTANCE_LAYERS", "VK_LAYER_KHRONOS_validation")
            .env("VK_LAYER_ENABLES", "VK_VALIDATION_FEATURE_ENABLE_SYNCHRONIZATION_VALIDATION_EXT");
        without_indirect(&mut command);
        // Pictures stay as they are first made, unless a test asks for more.
        for [option, value] in [["--samples", "1"], ["--final", "off"]] {
            if arguments[0] == "view" && !arguments.contains(&option) {
                command.args([option, value]);
            }
        }
        command
    }

    fn xdotool(&self, arguments: &[&str]) -> String {
        let output = Command::new("xdotool")
            .args(arguments)
            .env("DISPLAY", &self.display)
            .output()
            .expect("tools/setup installs xdotool beside Xvfb");
        String::from_utf8_lossy(&output.stdout).trim().to_owned()
    }
}

impl Drop for Desktop {
    fn drop(&mut self) {
        let _turn = turn();
        let _ = self.manager.kill();
        let _ = self.manager.wait();
        // Asked, not killed: it takes its socket and its lock with it.
        let _ = Command::new("kill").arg(self.server.id().to_string()).status();
        let _ = self.server.wait();
    }
}

/// A running relume and its window.
pub struct App<'a> {
    child: Child,
    desktop: &'a Desktop,
    window: String,
}

/// Pixels of a window, RGB, row by row.
#[derive(Clone, PartialEq)]
pub struct Shot {
    pub width: usize,
    pub height: usize,
    pub rgb: Vec<[u8; 3]>,
}

impl App<'_> {
    /// Waits for the window, activates it, and waits for its first picture.
    pub fn wait_for_window(&mut self) {
        self.wait_for_window_saying("stops");
    }

    /// [`Self::wait_for_window`], whose title holds `says`.
    pub fn wait_for_window_saying(&mut self, says: &str) {
        let start = Instant::now();
        while self.window.is_empty() {
            let ended = self.child.try_wait().unwrap();
            if let Some(status) = ended {
                let mut said = String::new();
                self.child.stderr.take().unwrap().read_to_string(&mut said).unwrap();
                panic!("{status}, and no window: {said}");
            }
            assert!(start.elapsed() < PATIENCE, "no window came");
            let found = self.desktop.xdotool(&["search", "--onlyvisible", "--name", "relume$"]);
            self.window = found.lines().next().unwrap_or_default().to_owned();
            std::thread::sleep(Duration::from_millis(50));
        }
        self.desktop.xdotool(&["windowactivate", "--sync", &self.window]);
        // The manager calls a window active before keys go to it, and rarely does not hear at all.
        while self.desktop.xdotool(&["getwindowfocus"]) != self.window {
            assert!(start.elapsed() < PATIENCE, "the window gets no keys");
            std::thread::sleep(Duration::from_millis(100));
            self.desktop.xdotool(&["windowfocus", &self.window]);
        }
        self.wait_for_title(says);
    }

    /// The title tells what was done last.
    #[track_caller]
    pub fn wait_for_title(&self, part: &str) {
        let start = Instant::now();
        loop {
            let title = self.desktop.xdotool(&["getwindowname", &self.window]);
            if title.contains(part) {
                return;
            }
            assert!(start.elapsed() < PATIENCE, "{title:?} never became {part:?}");
            std::thread::sleep(Duration::from_millis(20));
        }
    }

    /// Presses a key as xdotool calls it; afterwards the title holds `says`.
    #[track_caller]
    pub fn key(&self, key: &str, says: &str) {
        self.desktop.xdotool(&["key", key]);
        self.wait_for_title(says);
    }

    pub fn keys(&self, keys: &[&str]) {
        self.desktop.xdotool(&[&["key", "--delay", "40"], keys].concat());
    }

    pub fn text(&self, text: &str) {
        self.desktop.xdotool(&["type", "--delay", "20", text]);
    }

    pub fn mouse_to(&self, x: i32, y: i32) {
        self.desktop.xdotool(&["mousemove", "--window", &self.window, &x.to_string(), &y.to_string()]);
    }

    /// Presses the mouse's button at one point of the window, and lets it go at another.
    pub fn drag(&self, from: [i32; 2], to: [i32; 2]) {
        let pause = || std::thread::sleep(Duration::from_millis(200));
        self.mouse_to(from[0], from[1]);
        pause(); // the interface sees where the mouse is one frame later
        self.desktop.xdotool(&["mousedown", "1"]);
        for step in 1..=4 {
            pause();
            self.mouse_to(from[0] + (to[0] - from[0]) * step / 4, from[1] + (to[1] - from[1]) * step / 4);
        }
        pause();
        self.desktop.xdotool(&["mouseup", "1"]);
    }

    /// Ends the program as a crash does, without a word to it.
    pub fn kill(mut self) {
        self.child.kill().unwrap();
        self.child.wait().unwrap();
    }

    pub fn do_with_window(&self, verb: &str, arguments: &[&str]) {
        self.desktop.xdotool(&[&[verb, &self.window], arguments].concat());
    }

    pub fn wait_for_size(&self, width: usize, height: usize) {
        let start = Instant::now();
        loop {
            let shot = self.screenshot();
            if (shot.width, shot.height) == (width, height) {
                return;
            }
            assert!(start.elapsed() < PATIENCE, "{}x{} is not {width}x{height}", shot.width, shot.height);
        }
    }

    /// What the window shows, once two looks at it agree and nobody worked on another picture in between.
    pub fn screenshot(&self) -> Shot {
        let (connection, _) = RustConnection::connect(Some(&self.desktop.display)).unwrap();
        let start = Instant::now();
        let mut last = None;
        loop {
            let rested = (0..15).fold(true, |rested, _| {
                std::thread::sleep(Duration::from_millis(20));
                rested && !self.works()
            });
            let shot = self.look(&connection);
            if rested && last.as_ref() == Some(&shot) {
                return shot;
            }
            assert!(start.elapsed() < PATIENCE, "the window never rests");
            last = Some(shot);
        }
    }

    /// Whether a thread runs, or waits for a processor.
    fn works(&self) -> bool {
        let threads = std::fs::read_dir(format!("/proc/{}/task", self.child.id())).unwrap();
        let state = |thread: std::io::Result<std::fs::DirEntry>| {
            let stat = std::fs::read_to_string(thread.ok()?.path().join("stat")).ok()?;
            stat[stat.rfind(')')? + 2..].chars().next()
        };
        threads.filter_map(state).any(|state| state != 'S')
    }

    fn look(&self, connection: &RustConnection) -> Shot {
        let window: u32 = self.window.parse().unwrap();
        let geometry = connection.get_geometry(window).unwrap().reply().unwrap();
        let (width, height) = (geometry.width, geometry.height);
        let image = connection.get_image(ImageFormat::Z_PIXMAP, window, 0, 0, width, height, u32::MAX);
        let image = image.unwrap().reply().unwrap();
        assert_eq!(connection.setup().image_byte_order, x11rb::protocol::xproto::ImageOrder::LSB_FIRST);
        let rgb = image.data.chunks_exact(4).map(|bgrx| [bgrx[2], bgrx[1], bgrx[0]]).collect();
        Shot { width: usize::from(width), height: usize::from(height), rgb }
    }

    pub fn click(&self, x: i32, y: i32) {
        self.mouse_to(x, y);
        std::thread::sleep(Duration::from_millis(200)); // the interface sees where the mouse is one frame later
        self.desktop.xdotool(&["click", "1"]);
    }

    /// Quits, and when asked what shall become of unsaved edits, lets them go.
    #[track_caller]
    pub fn quits_unsaved(self) {
        self.keys(&["ctrl+q", "q"]);
        self.ends_silently();
    }

    /// Waits for the end: a clean one, without a word from anybody.
    #[track_caller]
    pub fn ends_silently(mut self) {
        let start = Instant::now();
        let status = loop {
            if let Some(status) = self.child.try_wait().unwrap() {
                break status;
            }
            assert!(start.elapsed() < PATIENCE, "the window stays");
            std::thread::sleep(Duration::from_millis(20));
        };
        let (mut stdout, mut stderr) = (String::new(), String::new());
        self.child.stdout.take().unwrap().read_to_string(&mut stdout).unwrap();
        self.child.stderr.take().unwrap().read_to_string(&mut stderr).unwrap();
        assert!(status.success(), "{status}: {stderr}");
        assert_eq!((stdout.as_str(), stderr.as_str()), ("", ""));
    }
}

impl Drop for App<'_> {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

//! Bakes in parts: joined they are what one machine bakes, to the last bit; what fails fails in one line.

mod command;

use std::ffi::OsStr;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::Duration;

use command::{Run, folder, names_in, relume, shipped, with_own_mounts};

/// A small bake of a shipped scene, with the lights of a dome.
struct Bake {
    folder: tempfile::TempDir,
    scene: PathBuf,
    rig: PathBuf,
}

const DOME: &str = "[[light]]\nname = \"sky\"\nkind = \"dome\"\nradiance = [1, 2, 3]\n\
                    [[light]]\nname = \"lamp\"\nkind = \"point\"\nposition = [0, 1.5, 0]\nintensity = 5\n";

impl Bake {
    fn new() -> Self {
        let folder = folder();
        let rig = folder.path().join("rig.toml");
        fs::write(&rig, DOME).unwrap();
        Self { folder, scene: shipped("balls-2.glb"), rig }
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// `relume bake` with a cache of that name.
    fn command(&self, cache: &str, arguments: &[&str]) -> Command {
        let mut command = relume();
        command.arg("bake").arg(&self.scene).arg("--rig").arg(&self.rig).arg("--cache").arg(self.path(cache));
        command.args(["--gather", "256", "--rays", "16", "--size", "96x64", "--gi", "glossy"]).args(arguments);
        command
    }

    #[track_caller]
    fn run(&self, cache: &str, arguments: &[&str]) -> Run {
        Run::of(&mut self.command(cache, arguments))
    }

    /// The finished bakes of a cache: name and bytes.
    fn bakes(&self, cache: &str) -> Vec<(String, Vec<u8>)> {
        let names = names_in(&self.path(cache)).into_iter().filter(|name| name.ends_with(".safetensors"));
        names.map(|name| (name.clone(), fs::read(self.path(cache).join(name)).unwrap())).collect()
    }

    /// Bakes part `number` of `count`; returns its file.
    #[track_caller]
    fn part(&self, cache: &str, number: usize, count: usize) -> String {
        let made = self.run(cache, &["--part", &format!("{number}/{count}")]).done();
        let file = made.stdout.trim_end();
        assert!(Path::new(file).exists(), "{}", made.stdout);
        file.to_owned()
    }

    #[track_caller]
    fn join(&self, cache: &str, parts: &[String]) -> Run {
        let arguments: Vec<&str> = ["--join"].into_iter().chain(parts.iter().map(String::as_str)).collect();
        self.run(cache, &arguments)
    }
}

#[test]
fn joined_parts_are_the_bake() {
    let bake = Bake::new();
    bake.run("whole", &[]).done();
    let whole = bake.bakes("whole");
    assert_eq!(whole.len(), 3, "deep framebuffer, transfer, light of the sky");
    for count in [1, 2, 7, 40] {
        let cache = format!("of {count}");
        bake.run(&cache, &["--shared"]).done();
        let mut parts: Vec<String> = (1..=count).map(|number| bake.part(&cache, number, count)).collect();
        parts.rotate_left(count / 2); // in any order
        bake.join(&cache, &parts).done();
        assert!(bake.bakes(&cache) == whole, "{count} parts");
        let left: Vec<_> = names_in(&bake.path(&cache)).into_iter().filter(|name| name.starts_with("bake-")).collect();
        assert_eq!(left.len(), whole.len() + count, "the parts are left: {left:?}");
    }
    // Found in the cache, beside one that another division left.
    bake.part("of cache", 1, 3);
    for number in [2, 1] {
        bake.part("of cache", number, 2);
    }
    bake.join("of cache", &[]).done();
    assert!(bake.bakes("of cache") == whole);
    assert_eq!(names_in(&bake.path("of cache")).iter().filter(|name| name.ends_with(".part")).count(), 1);
    // Machines that share no folder, with other numbers of threads.
    let parts = [1, 2].map(|number| {
        let file = bake.path(&format!("part {number}")).to_str().unwrap().to_owned();
        let (cache, part) = (format!("machine {number}"), format!("{number}/2"));
        bake.run(&cache, &["--part", &part, "-o", &file, "--threads", &number.to_string()]).done();
        file
    });
    bake.join("third machine", &parts).done();
    assert!(bake.bakes("third machine") == whole);
}

/// Parts that are killed at any time, again and again, and several processes at the same part.
#[test]
fn killed_parts_go_on() {
    let bake = Bake::new();
    bake.run("whole", &[]).done();
    let start = |part: &str| -> Child {
        bake.command("parts", &["--part", part]).stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap()
    };
    for delay in [20, 150, 300, 600, 900, 1200] {
        let mut children = [start("1/2"), start("1/2"), start("2/2")];
        std::thread::sleep(Duration::from_millis(delay));
        for child in &mut children {
            child.kill().unwrap();
            child.wait().unwrap();
        }
    }
    for number in [1, 2] {
        let path = bake.part("parts", number, 2);
        assert_eq!(bake.part("parts", number, 2), path, "what is there is not made again");
    }
    for delay in [10, 50, 100, 150] {
        let mut join = bake.command("parts", &["--join"]).stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap();
        std::thread::sleep(Duration::from_millis(delay));
        join.kill().unwrap();
        join.wait().unwrap();
    }
    for _ in 0..2 {
        bake.join("parts", &[]).done();
        assert!(bake.bakes("parts") == bake.bakes("whole"));
    }
    // A job that runs again finds all done.
    bake.run("parts", &["--shared"]).done();
    assert_eq!(bake.run("parts", &["--part", "1/2"]).done().stdout, "");
    let left: Vec<_> = names_in(&bake.path("parts")).into_iter().filter(|name| name.starts_with("bake-")).collect();
    assert_eq!(left.len(), bake.bakes("whole").len(), "{left:?}");
}

#[test]
fn what_cannot_be_joined_is_told() {
    let bake = Bake::new();
    let parts = [1, 2].map(|number| bake.part("parts", number, 2));
    let [one, two] = parts.clone();
    let told = |parts: &[&String], says: &[&str]| {
        let parts: Vec<String> = parts.iter().map(|part| (*part).clone()).collect();
        bake.join("parts", &parts).failed(says);
        let bakes = bake.bakes("parts").len();
        assert_eq!(bakes, 1, "nothing but the deep framebuffer was baked");
    };
    told(&[&one], &["--join: part 2/2 is missing"]);
    told(&[&one, &two, &one], &["--join: part 1/2 is there twice"]);
    bake.join("nothing there", &[]).failed(&["--join", "has no parts of this bake"]);
    let third = bake.part("parts", 3, 3);
    told(&[&one, &third], &["one of 2 parts", "one of 3"]);
    told(&[&one, &"missing".to_owned()], &["missing"]);

    let mut other = Bake::new();
    other.scene = shipped("cornell-diffuse.glb");
    let of_scene = other.part("parts", 2, 2);
    told(&[&one, &of_scene], &[&of_scene, "a part of another bake", "geometry"]);
    other.scene.clone_from(&bake.scene);
    let file = other.path("no dome").to_str().unwrap().to_owned();
    fs::write(&other.rig, DOME.split_once("\n[[light]]").unwrap().1.replacen("", "[[light]]", 1)).unwrap();
    other.run("parts", &["--part", "2/2", "-o", &file]).done();
    told(&[&one, &file], &["its lights had no dome"]);
    bake.run("parts", &["--part", "2/2", "-o", &file, "--error", "0.1"]).done();
    told(&[&one, &file], &["options of indirect light differ"]);

    let whole = fs::read(&two).unwrap();
    let damaged = |bytes: &[u8]| fs::write(&file, bytes).unwrap();
    for end in [0, 1, 40, whole.len() / 2, whole.len() - 1] {
        damaged(&whole[..end]);
        told(&[&one, &file], &[&file, "damaged"]);
    }
    let mut flipped = whole.clone();
    flipped[whole.len() / 3] ^= 4;
    damaged(&flipped);
    told(&[&one, &file], &[&file, "damaged"]);
    let line = whole.iter().position(|byte| *byte == b'\n').unwrap();
    let content = [b"relume part, format 1 of 0.0.1".as_slice(), &whole[line..whole.len() - 32]].concat();
    damaged(&[&content[..], blake3::hash(&content).as_bytes()].concat());
    told(&[&one, &file], &[&file, "format 1 of 0.0.1"]);

    // Another machine's shared file has other bytes, as with other vector instructions.
    let part = fs::read(&one).unwrap();
    let names = names_in(&bake.path("parts")).into_iter().filter(|name| name.ends_with(".shared"));
    let checksums = names.map(|name| {
        let shared = fs::read(bake.path("parts").join(name)).unwrap();
        shared[shared.len() - 32..].to_vec()
    });
    let place = checksums.filter_map(|checksum| part.windows(32).position(|bytes| bytes == checksum)).next().unwrap();
    let mut content = part[..part.len() - 32].to_vec();
    content[place] ^= 1;
    damaged(&[&content[..], blake3::hash(&content).as_bytes()].concat());
    told(&[&file, &two], &[&two, "another shared file"]);

    bake.join("parts", &parts).done();
    bake.join("parts", &[one]).failed(&["part 2/2 is missing"]);
}

#[test]
fn a_damaged_shared_file_is_made_again() {
    let bake = Bake::new();
    bake.run("parts", &["--shared"]).done();
    let shared = names_in(&bake.path("parts")).into_iter().find(|name| name.ends_with(".shared")).unwrap();
    let shared = bake.path("parts").join(shared);
    let whole = fs::read(&shared).unwrap();
    fs::write(&shared, &whole[..whole.len() / 2]).unwrap();
    bake.run("parts", &["--shared"]).done();
    assert!(fs::read(&shared).unwrap() == whole);
    fs::write(&shared, &whole[..whole.len() / 2]).unwrap();
    let parts = [1, 2].map(|number| bake.part("parts", number, 2));
    assert!(fs::read(&shared).unwrap() == whole);
    bake.join("parts", &parts).done();
    bake.run("whole", &[]).done();
    assert!(bake.bakes("parts") == bake.bakes("whole"));
}

#[test]
fn what_cannot_be_divided_is_told() {
    let bake = Bake::new();
    bake.run("parts", &["--part", "3/2"]).refused("expected I/N");
    bake.run("parts", &["--part", "1/2", "--join", "x"]).refused("cannot be used with");
    bake.run("parts", &["-o", "x"]).refused("--part");
    bake.run("parts", &["--part", "1/2", "--transfer", "dense"]).failed(&["only nested blocks"]);
    bake.run("parts", &["--shared", "--method", "thesis"]).failed(&["only nested blocks"]);
    let mut command = relume();
    command.args(["bake", "--gi", "off", "--part", "1/2", "--size", "9x9"]).arg(&bake.scene);
    Run::of(&mut command).failed(&["without indirect light"]);
    let mut command = relume();
    command.args(["bake", "--gi", "diffuse", "--no-cache", "--part", "1/2", "--size", "9x9"]).arg(&bake.scene);
    Run::of(&mut command).failed(&["there is no cache"]);
    if Path::new("/dev/full").exists() {
        bake.run("parts", &["--part", "1/2", "-o", "/dev/full"]).failed(&["/dev/full", "No space left"]);
    }
}

/// A disk that is full at any time: an error, and after that the right bake.
#[test]
fn a_full_disk_is_told() {
    let bake = Bake::new();
    bake.run("whole", &[]).done();
    // All of it takes some megabytes.
    let script = r#"dir=$1 scene=$2 size=$3 rig=$4 failed=no
        mount -t tmpfs -o size=$size none "$dir" || exit 77
        bake() { "$0" bake "$scene" --rig "$rig" --cache "$dir" --gather 256 --rays 16 --size 96x64 --gi glossy "$@"; }
        one=$(bake --part 1/2) || failed=yes
        two=$(bake --part 2/2) || failed=yes
        bake --join $one $two >/dev/null || failed=yes
        mount -o remount,size=1G "$dir"
        one=$(bake --part 1/2) || exit 3
        two=$(bake --part 2/2) || exit 4
        bake --join $one $two >/dev/null || exit 5
        echo $failed; md5sum "$dir"/*.safetensors | cut -d' ' -f1"#;
    let want = {
        let mut command = Command::new("sh");
        command.args(["-c", r#"md5sum "$0"/*.safetensors | cut -d' ' -f1"#]).arg(bake.path("whole"));
        String::from_utf8(command.output().unwrap().stdout).unwrap()
    };
    for size in ["64k", "1m", "3m", "8m", "30m"] {
        let mounted = bake.path("mounted");
        fs::create_dir_all(&mounted).unwrap();
        let arguments: [&OsStr; 4] = [mounted.as_ref(), bake.scene.as_ref(), size.as_ref(), bake.rig.as_ref()];
        let Some(run) = with_own_mounts("bakes in parts on a full disk", script, &arguments) else { return };
        let run = run.done();
        let (failed, sums) = run.stdout.split_once('\n').unwrap();
        assert_eq!(sums, want, "{size}: {failed} {}", run.stderr);
        for line in run.stderr.lines().filter(|line| line.starts_with("relume: ")) {
            assert!(line.contains("No space left") || line.contains("--join"), "{size}: {line}");
        }
    }
}

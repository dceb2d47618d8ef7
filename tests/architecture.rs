//! Which folder of `src` may use which: data flows one way, and no arrow points back.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

/// Each folder, and those that it may use. A folder stands below all that it uses, so that there are no circles.
const ALLOWED: [(&str, &[&str]); 18] = [
    ("error", &[]),
    ("shared", &[]),
    ("physics", &["shared"]),
    ("storage", &["error"]),
    ("image", &["error", "storage"]),
    ("scene", &["error", "image", "physics", "shared", "storage"]),
    ("desk", &["error", "scene"]),
    ("trace", &["physics", "scene", "shared"]),
    ("bake", &["error", "physics", "scene", "shared", "storage", "trace"]),
    ("final_gather", &["bake", "physics", "scene", "shared", "trace"]),
    ("gpu", &["error", "shared", "storage"]),
    ("relight", &["bake", "error", "gpu", "image", "physics", "scene", "shared", "trace"]),
    ("session", &["bake", "error", "final_gather", "gpu", "image", "relight", "scene", "shared", "storage", "trace"]),
    ("wire", &["desk", "error", "image", "relight", "scene", "storage"]),
    ("reference", &["bake", "image", "physics", "scene", "shared", "trace"]),
    ("report", &["error", "image", "storage"]),
    (
        "view",
        &[
            "bake",
            "desk",
            "error",
            "final_gather",
            "gpu",
            "image",
            "relight",
            "scene",
            "session",
            "shared",
            "storage",
            "trace",
            "wire",
        ],
    ),
    (
        "cli",
        &[
            "bake",
            "gpu",
            "image",
            "reference",
            "relight",
            "report",
            "scene",
            "session",
            "shared",
            "storage",
            "trace",
            "view",
        ],
    ),
];

/// All of the code, by path below `src`.
fn sources() -> Vec<(PathBuf, String)> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let mut folders = vec![root.clone()];
    let mut sources = Vec::new();
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(folder).unwrap().flatten() {
            let path = entry.path();
            if path.is_dir() {
                folders.push(path);
            } else if path.extension().is_some_and(|extension| extension == "rs") {
                let text = std::fs::read_to_string(&path).unwrap();
                sources.push((path.strip_prefix(&root).unwrap().to_owned(), text));
            }
        }
    }
    sources
}

/// The folder of `src`, or the file there, that a path below it belongs to.
fn home(path: &Path) -> String {
    path.components().next().unwrap().as_os_str().to_string_lossy().trim_end_matches(".rs").to_owned()
}

/// Names that follow `crate::` or `relume::` in code, comments left out.
fn used(text: &str) -> Vec<String> {
    let code: String = text.lines().map(|line| line.split("//").next().unwrap_or_default().to_owned() + "\n").collect();
    let mut names = Vec::new();
    for start in ["crate::", "relume::"] {
        for rest in code.split(start).skip(1) {
            match rest.strip_prefix('{') {
                Some(group) => {
                    // What stands at the first level of the braces.
                    let mut depth = 0;
                    let mut item = String::new();
                    for c in group.chars() {
                        match c {
                            '}' if depth == 0 => break,
                            '{' => depth += 1,
                            '}' => depth -= 1,
                            ',' if depth == 0 => names.push(std::mem::take(&mut item)),
                            _ if depth == 0 => item.push(c),
                            _ => (),
                        }
                    }
                    names.push(item);
                }
                None => names.push(rest.to_owned()),
            }
        }
    }
    let first = |name: String| name.trim().split(|c: char| !c.is_alphanumeric() && c != '_').next().unwrap().to_owned();
    names.into_iter().map(first).collect()
}

/// Uses of one folder by another that the table does not allow.
fn wrong(sources: &[(PathBuf, String)]) -> Vec<String> {
    let allowed: BTreeMap<&str, &[&str]> = ALLOWED.into_iter().collect();
    let mut wrong = Vec::new();
    for (path, text) in sources {
        let home = home(path);
        let Some(may) = allowed.get(home.as_str()) else {
            if !["lib", "main"].contains(&home.as_str()) {
                wrong.push(format!("src/{}: {home} is not in the table", path.display()));
            }
            continue;
        };
        for name in used(text) {
            if name != home && allowed.contains_key(name.as_str()) && !may.contains(&name.as_str()) {
                wrong.push(format!("src/{} uses {name}", path.display()));
            }
        }
    }
    wrong
}

#[test]
fn no_arrow_points_back() {
    let sources = sources();
    assert!(sources.len() > 100, "{} files: where is the code?", sources.len());
    let wrong = wrong(&sources);
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn the_table_has_no_circles_and_nothing_that_is_not_used() {
    for (i, (home, may)) in ALLOWED.iter().enumerate() {
        for other in *may {
            let place = ALLOWED.iter().position(|(name, _)| name == other);
            assert!(place.is_some_and(|place| place < i), "{home} may use {other}, which does not stand before it");
        }
    }
    let sources = sources();
    for (home_name, may) in ALLOWED {
        let of_home = || sources.iter().filter(|(path, _)| home(path) == home_name);
        for other in may {
            let is_used = of_home().any(|(_, text)| used(text).iter().any(|name| name == other));
            assert!(is_used, "{home_name} uses nothing of {other}: take it out of the table");
        }
    }
}

#[test]
fn planted_arrows_are_found() {
    let plant = |path: &str, text: &str| wrong(&[(path.into(), text.into())]);
    assert_eq!(plant("bake/mod.rs", "use crate::relight::Relighter;\n"), ["src/bake/mod.rs uses relight"]);
    assert_eq!(plant("gpu/frame.rs", "use crate::{error::Result, bake::{a, b}};"), ["src/gpu/frame.rs uses bake"]);
    assert_eq!(plant("scene/rig.rs", "let x = crate::trace::bvh::Bvh::build(s);"), ["src/scene/rig.rs uses trace"]);
    assert_eq!(plant("elsewhere/mod.rs", ""), ["src/elsewhere/mod.rs: elsewhere is not in the table"]);
    assert!(plant("bake/mod.rs", "// crate::relight\nuse crate::scene::Scene;\n").is_empty());
}

/// An address is the receipt for a declared access: only passes hand it out.
#[test]
fn addresses_come_from_passes_alone() {
    for (path, text) in sources() {
        let kinds = ["Read", "Write", "Exchange"];
        let makes = |kind| [format!("{kind}::from("), format!("{kind}::<")].iter().any(|made| text.contains(made));
        let makes = kinds.into_iter().any(makes);
        assert!(!makes || path == Path::new("gpu/frame.rs"), "src/{} makes an address", path.display());
    }
}

/// Threads of a workgroup read each other's results only through coherent addresses, after a barrier. No device here
/// shows when one of the two is missing.
#[test]
fn barriers_and_coherent_addresses_go_together() {
    let shared = std::fs::read_to_string("src/shared/mod.rs").unwrap();
    let mut with_both = 0;
    for file in std::fs::read_dir("glsl").unwrap().flatten().map(|file| file.path()).filter(|path| path.is_file()) {
        let kernel = file.file_stem().unwrap().to_string_lossy();
        let push = shared.split(&format!(" for {kernel}")).nth(1).and_then(|text| text.split("\n        }").next());
        let exchanges = push.is_some_and(|push| push.contains(": Exchange<"));
        let text = std::fs::read_to_string(&file).unwrap();
        let waits = text.contains("memoryBarrierBuffer();\n        barrier();");
        assert_eq!(exchanges, waits, "{kernel}: exchanges values ({exchanges}), waits for them ({waits})");
        with_both += usize::from(waits);
    }
    assert!(with_both > 0, "haar has both");
}

/// A module's path below `src`, without `mod`: `["relight", "frame"]`.
fn module(path: &Path) -> Vec<String> {
    let parts = path.with_extension("").iter().map(|part| part.to_string_lossy().into_owned()).collect::<Vec<_>>();
    parts.into_iter().filter(|part| part != "mod").collect()
}

/// All paths of a use tree: `a::{b, c::d}` is `a::b` and `a::c::d`. Text behind the tree is not looked at.
fn expand(prefix: &[String], text: &str, paths: &mut Vec<Vec<String>>) -> usize {
    let mut path = prefix.to_vec();
    let mut at = 0;
    loop {
        let rest = &text[at..];
        let end = rest.find(|c: char| !c.is_alphanumeric() && c != '_').unwrap_or(rest.len());
        if end > 0 {
            path.push(rest[..end].to_owned());
            at += end;
        } else if rest.starts_with('{') {
            at += 1;
            while at < text.len() && !text[at..].starts_with('}') {
                at += expand(&path, &text[at..], paths).max(1);
            }
            return at + 1;
        }
        match text[at..].strip_prefix("::") {
            Some(_) => at += 2,
            None => break,
        }
    }
    paths.push(path);
    at
}

/// Files that each of `sources` uses, parents and children left out: those belong together.
fn uses(sources: &[(PathBuf, String)]) -> BTreeMap<Vec<String>, BTreeSet<Vec<String>>> {
    let modules: BTreeSet<_> = sources.iter().map(|(path, _)| module(path)).collect();
    let used_by = |(path, text): &(PathBuf, String)| {
        let from = module(path);
        // Tests at the end of a file may look anywhere.
        let text = text.split("#[cfg(test)]\nmod tests").next().unwrap();
        let code: String = text.lines().map(|line| line.split("//").next().unwrap().to_owned() + "\n").collect();
        let mut paths = Vec::new();
        for (start, base) in
            [("crate::", vec![]), ("self::", from.clone()), ("super::", from[..from.len() - 1].to_vec())]
        {
            for (at, _) in code.match_indices(start) {
                expand(&base, &code[at + start.len()..], &mut paths);
            }
        }
        let file = |mut path: Vec<String>| {
            while !modules.contains(&path) {
                path.pop()?;
            }
            Some(path).filter(|path| !path.starts_with(&from) && !from.starts_with(path))
        };
        (from.clone(), paths.into_iter().filter_map(file).collect())
    };
    sources.iter().map(used_by).collect()
}

/// Files that need each other, and those between such circles.
fn circles(sources: &[(PathBuf, String)]) -> Vec<String> {
    let mut uses = uses(sources);
    loop {
        let used: BTreeSet<_> = uses.values().flatten().cloned().collect();
        let before = uses.len();
        // What uses nothing, or is used by nothing, is in no circle.
        uses.retain(|file, uses| !uses.is_empty() && used.contains(file));
        let left: BTreeSet<_> = uses.keys().cloned().collect();
        uses.values_mut().for_each(|uses| uses.retain(|file| left.contains(file)));
        if uses.len() == before {
            return uses.keys().map(|file| file.join("/")).collect();
        }
    }
}

#[test]
fn no_two_files_need_each_other() {
    let sources = sources();
    let arrows: usize = uses(&sources).values().map(BTreeSet::len).sum();
    println!("{} files, {arrows} uses of one by another", sources.len());
    assert!(arrows > 300, "{arrows} uses: where are the others?");
    assert_eq!(circles(&sources), [""; 0]);
}

#[test]
fn planted_circles_are_found() {
    let file = |path: &str, text: &str| (PathBuf::from(path), text.to_owned());
    let plant = |text: &str| {
        let b = file("relight/b.rs", "use crate::{error::Error, scene::{self, Rig}};\nuse super::c::{D, E};\n");
        circles(&[
            file("relight/a.rs", "use super::b::B;"),
            b,
            file("relight/c.rs", text),
            file("relight/mod.rs", "mod a;"),
        ])
    };
    assert_eq!(plant("use crate::scene::Rig; // super::a::A"), [""; 0]);
    assert_eq!(plant("use super::{a::A, Relighter};"), ["relight/a", "relight/b", "relight/c"]);
    assert_eq!(plant("fn f() { super::b::g() }"), ["relight/b", "relight/c"]);
}

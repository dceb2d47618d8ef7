//! Which folder of `src` may use which: data flows one way, and no arrow points back.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Each folder, and those that it may use. A folder stands below all that it uses, so that there are no circles.
const ALLOWED: [(&str, &[&str]); 15] = [
    ("error", &[]),
    ("shared", &[]),
    ("physics", &["shared"]),
    ("storage", &["error"]),
    ("image", &["error", "storage"]),
    ("scene", &["error", "shared", "storage"]),
    ("trace", &["scene", "shared"]),
    ("bake", &["error", "physics", "scene", "shared", "storage", "trace"]),
    ("gpu", &["error", "shared", "storage"]),
    ("relight", &["bake", "error", "gpu", "physics", "scene", "shared", "trace"]),
    ("session", &["bake", "error", "gpu", "relight", "scene", "shared", "storage", "trace"]),
    ("reference", &["bake", "image", "physics", "scene", "shared", "trace"]),
    ("report", &["error", "image", "storage"]),
    ("view", &["bake", "error", "gpu", "image", "relight", "scene", "session", "shared", "storage", "trace"]),
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
        let makes = ["Read::from(", "Write::from(", "Read::<", "Write::<"].iter().any(|made| text.contains(made));
        assert!(!makes || path == Path::new("gpu/frame.rs"), "src/{} makes an address", path.display());
    }
}

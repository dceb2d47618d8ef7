//! Makes the scenes that ship with relume: `cargo run --release --bin make_scenes -- [DIR [small|large|all]]`.
//!
//! The small ones go into DIR (`scenes`), the large ones into DIR/generated, which git ignores.

mod glb;
mod mesh;
mod noise;
mod room;
mod scenes;
mod skies;
mod statues;

use std::io;
use std::path::Path;

use relume::image::exr;

fn main() -> io::Result<()> {
    let mut arguments = std::env::args().skip(1);
    let dir = arguments.next().unwrap_or_else(|| "scenes".into());
    let which = arguments.next().unwrap_or_else(|| "all".into());
    if dir.starts_with('-') || !["small", "large", "all"].contains(&which.as_str()) {
        eprintln!("usage: make_scenes [DIR [small|large|all]]    (default: scenes all)");
        std::process::exit(2);
    }
    if which != "large" {
        write(&scenes::small(), Path::new(&dir))?;
    }
    if which != "small" {
        let dir = Path::new(&dir).join("generated");
        write(&scenes::large(), &dir)?;
        for (name, map) in skies::all() {
            let path = dir.join(format!("{name}.exr"));
            exr::write(&path, &map).map_err(io::Error::other)?;
            println!("{}: {}x{} texels", path.display(), map.width, map.height);
        }
    }
    Ok(())
}

fn write(scenes: &[glb::Scene], dir: &Path) -> io::Result<()> {
    std::fs::create_dir_all(dir)?;
    for scene in scenes {
        let path = dir.join(format!("{}.glb", scene.name));
        let bytes = scene.to_glb();
        // Renamed when whole: a broken run leaves no half scene behind.
        let partial = path.with_extension("glb.part");
        std::fs::write(&partial, &bytes)?;
        std::fs::rename(&partial, &path)?;
        println!("{}: {} triangles, {} bytes", path.display(), scene.triangle_count(), bytes.len());
    }
    Ok(())
}

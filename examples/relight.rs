//! A picture with all indirect light, and the same after a light has moved:
//! `cargo run --release --example relight -- SCENE OUT.png`
//!
//! The first run bakes and fills the cache; after that everything starts at once.

use std::path::PathBuf;

use relume::image::png;
use relume::relight::output::exposure;
use relume::relight::{Picture, RelightSettings, Request};
use relume::{Error, Result, Session, SessionSettings};

fn main() -> Result<()> {
    let mut arguments = std::env::args_os().skip(1).map(PathBuf::from);
    let (Some(scene), Some(out)) = (arguments.next(), arguments.next()) else {
        return Err(Error::invalid("arguments", "expected SCENE OUT.png"));
    };
    let mut settings = SessionSettings::default();
    settings.open.size = Some([192, 128]);
    let session = Session::open(&scene, None, &settings, &())?;
    let context = session.context(None)?;
    let mut relighter = session.relighter(&context, &session.rig, &RelightSettings::default())?;

    let mut rig = session.rig.clone();
    if let Some(light) = rig.lights.first_mut() {
        light.position.y += 0.1;
    }
    relighter.set_rig(&rig)?;
    let exposure = exposure::automatic(relighter.linear(Picture::Whole)?);
    let pixels = relighter.display(Request { exposure, ..Request::default() })?;
    let (width, height) = session.size();
    png::write(&out, width, height, pixels)
}

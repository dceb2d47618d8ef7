//! What the window shows, and what `relume render` makes of the same lights.

use std::path::{Path, PathBuf};

use super::Shot;

pub fn scene(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes").join(name)
}

/// A scene in a folder of its own, and with it what windows that save nowhere keep beside their scene.
pub fn scene_in(folder: &Path, name: &str) -> PathBuf {
    let copy = folder.join(name);
    std::fs::copy(scene(name), &copy).unwrap();
    copy
}

/// The picture where it is shown 1:1 and centred.
pub fn cut(shot: &Shot, [width, height]: [usize; 2]) -> Vec<[u8; 3]> {
    let (left, top) = ((shot.width - width) / 2, (shot.height - height) / 2);
    let row = |y: usize| &shot.rgb[(top + y) * shot.width + left..][..width];
    (0..height).flat_map(row).copied().collect()
}

/// Mean difference of two pictures in units of 1/255.
pub fn difference(a: &[[u8; 3]], b: &[[u8; 3]]) -> f64 {
    assert_eq!(a.len(), b.len());
    let all = a.iter().flatten().zip(b.iter().flatten());
    all.map(|(a, b)| f64::from(a.abs_diff(*b))).sum::<f64>() / (3 * a.len()) as f64
}

pub fn render(scene: &Path, rig: Option<&Path>, output: &Path) -> Vec<[u8; 3]> {
    let rig: Vec<_> = rig.iter().flat_map(|rig| ["--rig", rig.to_str().unwrap()]).collect();
    render_with(scene, &[&["--exposure", "0.5", "--size", "360x240"], &rig[..]].concat(), output)
}

/// What `relume render` makes of a scene and further arguments.
pub fn render_with(scene: &Path, arguments: &[&str], output: &Path) -> Vec<[u8; 3]> {
    let mut command = crate::command::relume();
    command.arg("render").arg(scene).arg("-o").arg(output).args(arguments);
    crate::command::Run::of(&mut command).silent();
    let mut reader =
        png::Decoder::new(std::io::BufReader::new(std::fs::File::open(output).unwrap())).read_info().unwrap();
    let mut bytes = vec![0; reader.output_buffer_size().unwrap()];
    let info = reader.next_frame(&mut bytes).unwrap();
    let channels = info.color_type.samples();
    bytes[..info.buffer_size()].chunks_exact(channels).map(|pixel| [pixel[0], pixel[1], pixel[2]]).collect()
}

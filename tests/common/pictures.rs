//! Pictures that tests compare.

use relume::image::compare::Pictures;
use relume::image::png;

use super::output_dir;

/// Writes got, want and their difference beside each other and tells where.
pub fn leave(pictures: &Pictures, name: &str) -> String {
    let mean = pictures.reference.iter().flatten().sum::<f32>() / (3 * pictures.reference.len()) as f32;
    let exposed = |pixels: &[[f32; 3]]| -> Vec<[u8; 3]> {
        pixels.iter().map(|p| p.map(|x| png::srgb8_from_linear(0.25 * x / mean))).collect()
    };
    let parts = [
        ("got", exposed(&pictures.image)),
        ("want", exposed(&pictures.reference)),
        ("difference", pictures.difference_map(1, 4.0 / mean)),
    ];
    let write = |(part, pixels): &(&str, Vec<[u8; 3]>)| {
        let path = output_dir().join(format!("{name}.{part}.png"));
        png::write(&path, pictures.width, pictures.height, pixels).expect("target/tmp is writable");
        path.display().to_string()
    };
    parts.iter().map(write).collect::<Vec<_>>().join("\n  ")
}

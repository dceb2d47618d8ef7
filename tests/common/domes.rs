//! Domes and their maps.

use std::path::Path;

use glam::{DVec3, Vec3};
use relume::image::{Image, exr};
use relume::scene::light_filter::Attached;
use relume::scene::{DomeMap, Light, LightKind, RigFiles, SkyMap};

use super::output_dir;

pub fn dome(map: Option<Attached<SkyMap>>) -> Light {
    Light { kind: LightKind::Dome, map: map.map(DomeMap::File), ..Light::point("sky", DVec3::ZERO) }
}

/// A map as a file, read again.
pub fn map(name: &str, [width, height]: [usize; 2], radiance: impl Fn(usize, usize) -> Vec3) -> Attached<SkyMap> {
    let pixels = (0..width * height).map(|i| radiance(i % width, i / width).to_array()).collect();
    let path = output_dir().join(format!("{name}.exr"));
    exr::write(&path, &Image::single(width, height, pixels)).unwrap();
    RigFiles::new(Path::new("")).sky_map(&path.to_string_lossy()).unwrap()
}

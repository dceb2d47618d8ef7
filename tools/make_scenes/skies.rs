//! Environment maps, equirectangular, in cd/m²: the middle is +z, the top +y.

use std::f64::consts::{PI, TAU};

use glam::{DVec3, dvec3};
use relume::image::Image;

const WIDTH: usize = 1024;
const HEIGHT: usize = WIDTH / 2;

/// Each with its name.
pub fn all() -> [(&'static str, Image); 3] {
    [("noon", map(noon)), ("dusk", map(dusk)), ("studio", map(studio))]
}

/// Means over four directions of each texel.
fn map(radiance: impl Fn(DVec3) -> DVec3) -> Image {
    let towards = |x: f64, y: f64| {
        let ((sin, cos), (sine, cosine)) = ((TAU * x / WIDTH as f64).sin_cos(), (PI * y / HEIGHT as f64).sin_cos());
        dvec3(sine * sin, cosine, -sine * cos)
    };
    let texel = |i: usize| {
        let (x, y) = ((i % WIDTH) as f64, (i / WIDTH) as f64);
        let corners = [(0.25, 0.25), (0.75, 0.25), (0.25, 0.75), (0.75, 0.75)];
        let sum: DVec3 = corners.iter().map(|(right, down)| radiance(towards(x + right, y + down))).sum();
        (0.25 * sum).as_vec3().to_array()
    };
    Image::single(WIDTH, HEIGHT, (0..WIDTH * HEIGHT).map(texel).collect())
}

/// 1 inside of a disc of this angular radius around `middle`, with an edge a fifth as wide; 0 outside.
fn disc(direction: DVec3, middle: DVec3, radius_deg: f64) -> f64 {
    let off = direction.angle_between(middle).to_degrees() / radius_deg;
    smooth(1.1, 0.9, off)
}

/// Rises from 0 at `from` to 1 at `to`.
fn smooth(from: f64, to: f64, x: f64) -> f64 {
    let t = ((x - from) / (to - from)).clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}

/// A clear sky over dry ground; a sun with five times its light.
fn noon(direction: DVec3) -> DVec3 {
    let sun = dvec3(0.55, 0.62, 0.56).normalize();
    let haze = (1.0 - direction.y.abs()).powi(4);
    let sky = dvec3(0.30, 0.55, 1.10).lerp(dvec3(1.0, 1.05, 1.1), haze);
    let ground = dvec3(0.22, 0.18, 0.13).lerp(dvec3(0.5, 0.48, 0.45), haze);
    let glow = 1.5 * disc(direction, sun, 14.0) * (1.0 - direction.angle_between(sun).to_degrees() / 15.4).max(0.0);
    let light = dvec3(1.0, 0.93, 0.82) * (glow + 6e4 * disc(direction, sun, 0.4));
    ground.lerp(sky, smooth(-0.01, 0.01, direction.y)) + light
}

/// After sunset: a band of fire in one direction, blue above, dark below.
fn dusk(direction: DVec3) -> DVec3 {
    let west = 0.5 + 0.5 * direction.with_y(0.0).normalize_or_zero().dot(dvec3(-0.8, 0.0, 0.6));
    let up = direction.y.max(0.0);
    let sky = dvec3(0.05, 0.09, 0.24).lerp(dvec3(0.16, 0.13, 0.22), (1.0 - up).powi(3));
    let fire = dvec3(6.0, 1.7, 0.35) * west.powi(4) * (-9.0 * up).exp();
    dvec3(0.02, 0.02, 0.025).lerp(sky + fire, smooth(-0.01, 0.01, direction.y))
}

/// A dark room with a warm key, a cool strip and a weak ceiling.
fn studio(direction: DVec3) -> DVec3 {
    let panel = |middle: DVec3, [width, height]: [f64; 2]| {
        let middle = middle.normalize();
        let right = DVec3::Y.cross(middle).normalize();
        let ahead = direction.dot(middle);
        let at = |axis: DVec3, half: f64| smooth(1.05, 0.95, (direction.dot(axis) / ahead).abs() / half);
        if ahead > 0.0 { at(right, width) * at(middle.cross(right), height) } else { 0.0 }
    };
    dvec3(0.02, 0.02, 0.022)
        + dvec3(14.0, 11.5, 9.0) * panel(dvec3(-0.8, 0.75, 0.75), [0.45, 0.35])
        + dvec3(4.0, 6.5, 10.0) * panel(dvec3(0.95, 0.35, -0.1), [0.10, 0.8])
        + dvec3(0.8, 0.8, 0.8) * panel(dvec3(0.05, 1.0, 0.0), [0.6, 0.6])
}

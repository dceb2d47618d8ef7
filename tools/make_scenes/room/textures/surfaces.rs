//! What repeats: planks, wood, plaster, cloth, tiles.

use std::f64::consts::TAU;

use glam::{DVec2, DVec3, dvec2, dvec3};

use super::{CLOTH_METRES, FLOOR_METRES, PLASTER_METRES, Paint, TILE_METRES, color, normals, roughness, smooth_step};
use crate::noise::{fractal, hashed, tiling};

pub fn all() -> Vec<Paint> {
    vec![
        || color("planks_color", 1024, plank_color),
        || normals("planks_normal", 1024, FLOOR_METRES, plank_height),
        || roughness("planks_roughness", 512, plank_roughness),
        || color("wood_color", 512, wood_color),
        || roughness("wood_roughness", 256, |uv| 0.42 + 0.1 * grain(uv, 0)),
        || color("plaster_color", 512, plaster_color),
        || normals("plaster_normal", 512, PLASTER_METRES, plaster_height),
        || color("cloth_color", 512, cloth_color),
        || normals("cloth_normal", 512, CLOTH_METRES, cloth_height),
        || color("tiles_color", 512, tile_color),
        || normals("tiles_normal", 512, TILE_METRES, tile_height),
        || roughness("tiles_roughness", 512, tile_roughness),
    ]
}

/// Boards along u, two to a row.
struct Plank {
    /// -1..1, its own.
    tone: f64,
    /// Of its grain.
    seed: u32,
    /// Metres from the nearest joint.
    edge: f64,
}

const PLANK_ROWS: f64 = 16.0;

fn plank(uv: DVec2) -> Plank {
    let row = (uv.y * PLANK_ROWS).floor();
    let row_index = row.rem_euclid(PLANK_ROWS) as u32;
    // Joints of neighbouring rows lie apart.
    let along = uv.x * 2.0 + hashed([row_index, 7, 0]);
    let board = along.floor().rem_euclid(2.0) as u32;
    let across = uv.y * PLANK_ROWS - row;
    let width = FLOOR_METRES / PLANK_ROWS;
    let end = (along - along.floor()).min(along.ceil() - along) * FLOOR_METRES / 2.0;
    Plank {
        tone: 2.0 * hashed([row_index, board, 3]) - 1.0,
        seed: 100 + 17 * (2 * row_index + board),
        edge: (across.min(1.0 - across) * width).min(end),
    }
}

/// Fibres and annual rings along u, about -1..1.
fn grain(uv: DVec2, seed: u32) -> f64 {
    let fibre = fractal(uv, [6, 150], 2, seed + 1);
    let bend = fractal(uv, [3, 9], 2, seed + 5);
    let rings = (TAU * (uv.y * 22.0 + 1.6 * bend)).sin();
    0.45 * fibre + 0.35 * rings * (0.6 + 0.4 * bend) + 0.3 * bend
}

fn plank_color(uv: DVec2) -> DVec3 {
    let Plank { tone, seed, edge } = plank(uv);
    let light = 0.5 + 0.17 * grain(uv, seed) + 0.20 * tone;
    let oak = dvec3(0.38, 0.25, 0.15).lerp(dvec3(0.70, 0.52, 0.35), light);
    let gap = smooth_step(0.0008, 0.0025, edge);
    oak * (0.35 + 0.65 * gap)
}

fn plank_height(uv: DVec2) -> f64 {
    let Plank { seed, edge, .. } = plank(uv);
    0.0009 * smooth_step(0.0, 0.004, edge) + 0.00008 * grain(uv, seed)
}

fn plank_roughness(uv: DVec2) -> f64 {
    let Plank { tone, seed, edge } = plank(uv);
    let varnish = 0.36 + 0.05 * grain(uv, seed) + 0.03 * tone + 0.07 * fractal(uv, [5, 5], 3, 40);
    varnish + 0.4 * (1.0 - smooth_step(0.0005, 0.003, edge))
}

/// Multiplied by the material's own colour, so nearly white where it is lightest.
fn wood_color(uv: DVec2) -> DVec3 {
    let light = (0.60 + 0.42 * grain(uv, 0)).clamp(0.0, 1.0);
    dvec3(0.50, 0.38, 0.29).lerp(dvec3(0.97, 0.95, 0.92), light)
}

fn plaster_color(uv: DVec2) -> DVec3 {
    dvec3(0.97, 0.965, 0.95) + 0.018 * fractal(uv, [4, 4], 4, 60) + 0.008 * fractal(uv, [90, 90], 1, 66)
}

fn plaster_height(uv: DVec2) -> f64 {
    0.0005 * fractal(uv, [14, 14], 3, 70) + 0.0012 * fractal(uv, [4, 4], 2, 80)
}

const THREADS: f64 = 40.0;

/// Warp over weft as on a chessboard: (height 0..1, which thread).
fn weave(uv: DVec2) -> (f64, u32) {
    let p = uv * THREADS;
    let cell = p.floor();
    let t = p - cell - 0.5;
    let over = (cell.x + cell.y).rem_euclid(2.0) < 1.0;
    let (across, along) = if over { (t.x, t.y) } else { (t.y, t.x) };
    let height = (1.0 - 3.2 * across * across).max(0.0) * (1.0 - 1.2 * along * along);
    let thread = if over { cell.x } else { cell.y + THREADS };
    (height, thread.rem_euclid(2.0 * THREADS) as u32)
}

fn cloth_color(uv: DVec2) -> DVec3 {
    let (height, thread) = weave(uv);
    let light = 0.80 + 0.10 * height + 0.12 * (hashed([thread, 11, 0]) - 0.5) + 0.05 * fractal(uv, [23, 23], 2, 90);
    let fluff = 0.05 * tiling(uv * 200.0, [200, 200], 95);
    DVec3::splat((light + fluff).clamp(0.0, 1.0))
}

fn cloth_height(uv: DVec2) -> f64 {
    0.0016 * weave(uv).0 + 0.0004 * tiling(uv * 160.0, [160, 160], 96)
}

/// Metres from the nearest joint of square tiles, and which tile.
fn tile(uv: DVec2) -> (f64, [u32; 2]) {
    const ACROSS: f64 = 4.0;
    let p = uv * ACROSS;
    let t = p - p.floor();
    let edge = t.min(1.0 - t).min_element() * TILE_METRES / ACROSS;
    (edge, [p.x.floor().rem_euclid(ACROSS) as u32, p.y.floor().rem_euclid(ACROSS) as u32])
}

/// 0 in the grout, 1 on the glaze.
fn glazed(uv: DVec2) -> f64 {
    smooth_step(0.0018, 0.0030, tile(uv).0)
}

fn tile_color(uv: DVec2) -> DVec3 {
    let (_, [x, y]) = tile(uv);
    let tone = hashed([x, y, 5]) - 0.5;
    let cloudy = 0.5 + 0.5 * fractal(uv, [14, 14], 3, 120) + 0.5 * tone;
    let glaze = dvec3(0.13, 0.27, 0.28).lerp(dvec3(0.24, 0.42, 0.41), cloudy.clamp(0.0, 1.0));
    let grout = dvec3(0.62, 0.60, 0.56) + 0.04 * fractal(uv, [80, 80], 2, 130);
    grout.lerp(glaze, glazed(uv))
}

fn tile_height(uv: DVec2) -> f64 {
    let (edge, [x, y]) = tile(uv);
    // No tile lies quite flat.
    let lean = dvec2(hashed([x, y, 21]), hashed([x, y, 22])) - 0.5;
    let wave = 0.0006 * fractal(uv, [10, 10], 2, 140);
    let flat = (uv * 4.0 - (uv * 4.0).floor() - 0.5).dot(lean) * 0.0016;
    (0.0016 + wave + flat) * smooth_step(0.0012, 0.0055, edge)
}

fn tile_roughness(uv: DVec2) -> f64 {
    let glaze = 0.12 + 0.06 * fractal(uv, [9, 9], 3, 150);
    0.85 + (glaze - 0.85) * glazed(uv)
}

//! What does not repeat: spines of books, pictures, the rug, a leaf, the garden outside.

use glam::{DVec2, DVec3, dvec2, dvec3};

use super::{Paint, color, cut_out, smooth_step};
use crate::noise::{fractal, hashed};

/// Cells of the texture "books": one spine each.
pub const BOOK_COLUMNS: u32 = 16;
pub const BOOK_ROWS: u32 = 2;

pub fn all() -> Vec<Paint> {
    vec![
        || color("books_color", 512, book),
        || color("pictures_color", 512, picture),
        || color("rug_color", 512, rug),
        || cut_out("leaf_color", 512, leaf),
        || color("garden_color", 256, garden),
    ]
}

const CLOTHS: [DVec3; 12] = [
    dvec3(0.42, 0.10, 0.09),
    dvec3(0.12, 0.18, 0.30),
    dvec3(0.16, 0.28, 0.19),
    dvec3(0.72, 0.66, 0.52),
    dvec3(0.20, 0.13, 0.10),
    dvec3(0.58, 0.36, 0.14),
    dvec3(0.80, 0.78, 0.74),
    dvec3(0.16, 0.16, 0.17),
    dvec3(0.30, 0.42, 0.50),
    dvec3(0.62, 0.20, 0.12),
    dvec3(0.40, 0.30, 0.42),
    dvec3(0.50, 0.50, 0.40),
];

/// A spine from top to bottom: bands, a title plate, a line or two of lettering.
fn book(uv: DVec2) -> DVec3 {
    let cells = dvec2(f64::from(BOOK_COLUMNS), f64::from(BOOK_ROWS));
    let cell = (uv * cells).floor();
    let t = uv * cells - cell;
    let id = [cell.x as u32, cell.y as u32];
    let chance = |n: u32| hashed([id[0], id[1], n]);
    let cloth = CLOTHS[((id[0] + 5 * id[1]) % 12) as usize] * (0.85 + 0.3 * chance(1));
    let gold = if chance(2) < 0.5 { dvec3(0.72, 0.56, 0.26) } else { dvec3(0.88, 0.86, 0.80) };
    let worn = 0.05 * fractal(uv, [64, 16], 3, 200);
    let plain = cloth + worn;
    // A margin without print, which the covers share.
    if t.x < 0.16 || t.x > 0.84 {
        return plain;
    }
    let band = [0.06, 0.12, 0.86].iter().any(|y| (t.y - y).abs() < 0.006) && chance(3) < 0.6;
    let plate = chance(4) < 0.35 && (0.18..0.34).contains(&t.y);
    let letters = |low: f64, high: f64, seed: u32| {
        let line = (t.x * 5.0).floor();
        (low..high).contains(&t.y)
            && (t.x * 5.0).fract() > 0.35
            && (1.0..4.0).contains(&line)
            && hashed([(t.y * 90.0) as u32, line as u32, seed + id[0]]) < 0.62
    };
    if band || letters(0.40, 0.72, 9) && chance(5) < 0.75 || letters(0.88, 0.95, 10) {
        gold
    } else if plate {
        if letters(0.2, 0.32, 11) { plain } else { gold * 0.6 + plain * 0.4 }
    } else {
        plain
    }
}

/// Four pictures, two by two: a sea, hills, a still life of discs, a faded print of bars.
fn picture(uv: DVec2) -> DVec3 {
    let quarter = (uv * 2.0).floor();
    let t = uv * 2.0 - quarter;
    let grain = 0.04 * fractal(uv, [60, 60], 3, 300);
    let paint = match (quarter.x as u32, quarter.y as u32) {
        (0, 0) => {
            let sky = dvec3(0.78, 0.72, 0.62).lerp(dvec3(0.46, 0.55, 0.62), 1.0 - t.y * 1.8);
            let waves = 0.10 * fractal(t, [4, 36], 3, 310);
            let sea = dvec3(0.22, 0.34, 0.38) + waves;
            let cloud = smooth_step(0.0, 0.5, fractal(t, [3, 6], 4, 320));
            if t.y < 0.56 { sky.lerp(dvec3(0.88, 0.85, 0.80), 0.6 * cloud) } else { sea }
        }
        (1, 0) => {
            let ridge = |base: f64, seed: u32| base + 0.10 * fractal(dvec2(t.x, 0.3), [3, 2], 4, seed);
            let layers = [
                (ridge(0.42, 330), dvec3(0.62, 0.66, 0.68)),
                (ridge(0.56, 340), dvec3(0.45, 0.52, 0.46)),
                (ridge(0.74, 350), dvec3(0.28, 0.34, 0.22)),
            ];
            let sky = dvec3(0.86, 0.82, 0.72);
            layers.iter().fold(sky, |below, &(y, color)| if t.y > y { color } else { below })
        }
        (0, 1) => {
            let discs = [(0.38, 0.55, 0.20, dvec3(0.70, 0.32, 0.16)), (0.62, 0.62, 0.15, dvec3(0.76, 0.62, 0.28))];
            let table = if t.y > 0.7 { dvec3(0.46, 0.38, 0.30) } else { dvec3(0.78, 0.74, 0.66) };
            discs.iter().fold(table, |below, &(x, y, radius, color)| {
                let from = (t - dvec2(x, y)).length() / radius;
                if from < 1.0 { color * (1.1 - 0.4 * from) } else { below }
            })
        }
        _ => {
            let bar = ((t.y * 7.0).floor() as u32, (t.x * 3.0 + hashed([(t.y * 7.0) as u32, 1, 4])).floor() as u32);
            CLOTHS[(bar.0 * 5 + bar.1 * 3) as usize % 12].lerp(dvec3(0.82, 0.78, 0.70), 0.45)
        }
    };
    paint + grain
}

/// A border of two stripes round a field of lozenges, woven.
fn rug(uv: DVec2) -> DVec3 {
    let edge = uv.min(1.0 - uv);
    // The rug is 2.3 m by 1.6 m.
    let inside = (edge.x * 2.3).min(edge.y * 1.6);
    let field = dvec3(0.50, 0.20, 0.17);
    let cream = dvec3(0.74, 0.67, 0.54);
    let navy = dvec3(0.16, 0.19, 0.28);
    let lozenge = ((uv.x * 14.0).rem_euclid(2.0) - 1.0).abs() + ((uv.y * 10.0).rem_euclid(2.0) - 1.0).abs();
    let dye = if inside < 0.04 || (0.20..0.23).contains(&inside) {
        navy
    } else if inside < 0.20 {
        let zigzag = ((uv.x * 46.0).rem_euclid(2.0) - 1.0).abs() + ((uv.y * 32.0).rem_euclid(2.0) - 1.0).abs();
        if zigzag < 0.9 { field } else { cream }
    } else if lozenge < 0.35 {
        cream
    } else if lozenge < 0.75 {
        navy
    } else {
        field
    };
    let worn = 0.10 * fractal(uv, [5, 4], 3, 400) + 0.09 * fractal(uv, [150, 150], 1, 410);
    dye * (1.0 + worn) + 0.03
}

/// Pointed at both ends, along v, with a pale rib; alpha cuts it out.
fn leaf(uv: DVec2) -> (DVec3, f64) {
    let across = (uv.x - 0.5).abs();
    let along = 1.0 - uv.y;
    // Widest below the middle, drawn out to a tip.
    let width = 0.48 * (along.powf(0.75) * std::f64::consts::PI).sin().max(0.0).powf(0.8) * (1.0 - 0.25 * along);
    let ragged = 0.012 * fractal(uv, [30, 30], 2, 500);
    let stalk = along < 0.08 && across < 0.015;
    let alpha = if stalk { 1.0 } else { 0.5 + (width + ragged - across) * 40.0 };
    let vein = ((along + across * 0.9) * 16.0).rem_euclid(1.0);
    let veins = 0.5 * (1.0 - smooth_step(0.02, 0.10, vein.min(1.0 - vein))) + (1.0 - smooth_step(0.006, 0.02, across));
    let green = dvec3(0.13, 0.28, 0.10) + 0.05 * fractal(uv, [8, 8], 3, 510);
    (green.lerp(dvec3(0.42, 0.54, 0.26), 0.6 * veins.min(1.0)), alpha.clamp(0.0, 1.0))
}

/// A pale sky over hedges, out of focus.
fn garden(uv: DVec2) -> DVec3 {
    let hedge = 0.60 + 0.09 * fractal(uv, [4, 3], 3, 600);
    let leaves = dvec3(0.34, 0.42, 0.28) + 0.12 * fractal(uv, [14, 14], 3, 610);
    let lawn = dvec3(0.44, 0.50, 0.32);
    let sky = dvec3(0.98, 0.99, 1.0).lerp(dvec3(0.90, 0.94, 1.0), 1.0 - uv.y);
    let below = leaves.lerp(lawn, smooth_step(0.78, 0.84, uv.y));
    sky.lerp(below, smooth_step(hedge - 0.05, hedge + 0.05, uv.y))
}

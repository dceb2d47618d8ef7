//! Small things with a shine, turned on the lathe; each stands on the origin.

use glam::{DVec3, dvec3};

use super::lathe::lathe;
use super::looks::{APPLE, BLUE_GLAZE, BRASS, CELADON, PEAR, PORCELAIN, STEEL, TERRACOTTA, WAX};
use super::shapes::tube;
use super::shelf::lying_books;
use super::{Piece, piece};
use crate::mesh::{Mesh, joined};

pub fn on_dining_table() -> Vec<Piece> {
    let places = [(0.02, 0.34, 25.0), (-0.22, -0.02, 140.0)];
    let white = places.into_iter().flat_map(|(x, z, yaw_deg)| {
        [plate().moved(dvec3(x, 0.0, z)), cup().turned(yaw_deg, dvec3(x + 0.17, 0.0, z - 0.20))]
    });
    vec![
        piece("porcelain", joined(white), PORCELAIN),
        piece("vase", vase().moved(dvec3(0.16, 0.0, -0.36)), BLUE_GLAZE),
        piece("jug", jug().turned(200.0, dvec3(-0.06, 0.0, -0.33)), CELADON),
    ]
}

pub fn on_coffee_table() -> Vec<Piece> {
    let bowl_at = dvec3(0.20, 0.0, 0.02);
    let fruit = |at: DVec3| fruit().moved(bowl_at + at);
    let mut pieces = vec![
        piece("bowl", bowl().moved(bowl_at), STEEL),
        piece("apples", joined([fruit(dvec3(0.045, 0.016, 0.02)), fruit(dvec3(-0.035, 0.016, 0.035))]), APPLE),
        piece("pear", pear().turned(40.0, bowl_at + dvec3(-0.005, 0.014, -0.048)), PEAR),
        piece("mug", cup().turned(-60.0, dvec3(-0.30, 0.0, -0.13)), TERRACOTTA),
    ];
    for mut book in lying_books() {
        book.mesh = book.mesh.moved(dvec3(-0.17, 0.0, 0.06));
        pieces.push(book);
    }
    pieces
}

pub fn on_mantel() -> Vec<Piece> {
    let sticks = [-0.60, -0.49].map(|x| candlestick().moved(dvec3(x, 0.0, 0.0)));
    let candles = [(-0.60, 0.14), (-0.49, 0.10)].map(|(x, height)| candle(height).moved(dvec3(x, 0.148, 0.0)));
    vec![
        piece("candlesticks", joined(sticks), BRASS),
        piece("candles", joined(candles), WAX),
        piece("vase", vase().moved(dvec3(0.58, 0.0, 0.0)), CELADON),
        piece("bowl", small_bowl().moved(dvec3(0.38, 0.0, 0.02)), PORCELAIN),
    ]
}

fn plate() -> Mesh {
    lathe(
        &[
            &[(0.0, 0.004), (0.066, 0.004)],
            &[(0.066, 0.0), (0.072, 0.0)],
            &[(0.072, 0.0), (0.090, 0.008), (0.128, 0.019)],
            &[(0.128, 0.019), (0.130, 0.021), (0.128, 0.0225)],
            &[(0.128, 0.0225), (0.092, 0.013), (0.078, 0.008), (0.0, 0.0075)],
        ],
        40,
        2,
    )
}

/// On its saucer, the handle towards +X.
fn cup() -> Mesh {
    let saucer = lathe(
        &[
            &[(0.0, 0.0), (0.040, 0.0)],
            &[(0.040, 0.0), (0.058, 0.007), (0.076, 0.014)],
            &[(0.076, 0.014), (0.074, 0.016), (0.055, 0.010), (0.036, 0.006), (0.0, 0.006)],
        ],
        32,
        2,
    );
    let body = lathe(
        &[
            &[(0.022, 0.006), (0.024, 0.010), (0.034, 0.024), (0.041, 0.050), (0.044, 0.074)],
            &[(0.044, 0.074), (0.0428, 0.0755), (0.0415, 0.074)],
            &[(0.0415, 0.074), (0.0385, 0.050), (0.031, 0.026), (0.018, 0.014), (0.0, 0.012)],
        ],
        32,
        3,
    );
    let handle = tube(20, 10, [0.0042; 2], |t| {
        let angle = std::f64::consts::PI * (t - 0.5) * 1.05;
        dvec3(0.037 + 0.026 * angle.cos(), 0.044 + 0.020 * angle.sin(), 0.0)
    });
    joined([saucer, body, handle])
}

fn vase() -> Mesh {
    lathe(
        &[
            &[(0.0, 0.0), (0.040, 0.0)],
            &[(0.040, 0.0), (0.056, 0.03), (0.074, 0.09), (0.062, 0.15), (0.032, 0.20), (0.026, 0.235), (0.036, 0.262)],
            &[(0.036, 0.262), (0.034, 0.264), (0.031, 0.262)],
            &[(0.031, 0.262), (0.021, 0.235), (0.027, 0.20), (0.040, 0.17)],
        ],
        36,
        3,
    )
}

pub fn small_vase() -> Mesh {
    lathe(
        &[
            &[(0.0, 0.0), (0.030, 0.0)],
            &[(0.030, 0.0), (0.052, 0.04), (0.060, 0.08), (0.040, 0.125), (0.018, 0.15), (0.022, 0.175)],
            &[(0.022, 0.175), (0.018, 0.175), (0.013, 0.15), (0.020, 0.13)],
        ],
        32,
        3,
    )
}

/// With a lid and a knob.
pub fn jar() -> Mesh {
    lathe(
        &[
            &[(0.0, 0.0), (0.052, 0.0)],
            &[(0.052, 0.0), (0.068, 0.03), (0.072, 0.08), (0.058, 0.125)],
            &[(0.058, 0.125), (0.064, 0.127), (0.064, 0.135)],
            &[
                (0.064, 0.135),
                (0.045, 0.148),
                (0.014, 0.155),
                (0.010, 0.163),
                (0.016, 0.174),
                (0.010, 0.184),
                (0.0, 0.186),
            ],
        ],
        32,
        3,
    )
}

/// With a handle, towards +X.
fn jug() -> Mesh {
    let body = lathe(
        &[
            &[(0.0, 0.0), (0.046, 0.0)],
            &[(0.046, 0.0), (0.062, 0.03), (0.066, 0.07), (0.050, 0.12), (0.040, 0.15), (0.046, 0.185)],
            &[(0.046, 0.185), (0.044, 0.187), (0.042, 0.185)],
            &[(0.042, 0.185), (0.036, 0.15), (0.045, 0.12), (0.060, 0.075), (0.045, 0.02), (0.0, 0.01)],
        ],
        36,
        3,
    );
    let handle = tube(24, 10, [0.0065, 0.0055], |t| {
        let angle = std::f64::consts::PI * (t - 0.5);
        dvec3(0.043 + 0.044 * angle.cos(), 0.112 + 0.056 * angle.sin(), 0.0)
    });
    joined([body, handle])
}

fn bowl() -> Mesh {
    lathe(
        &[
            &[(0.0, 0.0), (0.050, 0.0)],
            &[(0.050, 0.0), (0.056, 0.004), (0.090, 0.026), (0.126, 0.072)],
            &[(0.126, 0.072), (0.127, 0.0735), (0.1255, 0.074)],
            &[(0.1255, 0.074), (0.088, 0.029), (0.052, 0.008), (0.0, 0.005)],
        ],
        44,
        3,
    )
}

fn small_bowl() -> Mesh {
    lathe(
        &[
            &[(0.0, 0.0), (0.028, 0.0)],
            &[(0.028, 0.0), (0.032, 0.006), (0.056, 0.030), (0.062, 0.052)],
            &[(0.062, 0.052), (0.060, 0.054), (0.058, 0.052)],
            &[(0.058, 0.052), (0.051, 0.030), (0.026, 0.011), (0.0, 0.009)],
        ],
        36,
        3,
    )
}

fn fruit() -> Mesh {
    lathe(&[&[(0.0, 0.004), (0.018, 0.0), (0.038, 0.028), (0.030, 0.062), (0.012, 0.068), (0.0, 0.060)]], 22, 3)
}

fn pear() -> Mesh {
    lathe(
        &[&[(0.0, 0.002), (0.016, 0.0), (0.036, 0.030), (0.026, 0.066), (0.016, 0.092), (0.008, 0.102), (0.0, 0.102)]],
        22,
        3,
    )
}

fn candlestick() -> Mesh {
    lathe(
        &[
            &[(0.0, 0.0), (0.046, 0.0)],
            &[(0.046, 0.0), (0.045, 0.008), (0.020, 0.018), (0.009, 0.04), (0.013, 0.06), (0.008, 0.08), (0.008, 0.12)],
            &[(0.008, 0.12), (0.018, 0.135), (0.018, 0.150)],
            &[(0.018, 0.150), (0.0, 0.146)],
        ],
        22,
        2,
    )
}

fn candle(height: f64) -> Mesh {
    lathe(
        &[&[(0.011, 0.0), (0.0105, height)], &[(0.0105, height), (0.008, height - 0.002), (0.0, height - 0.001)]],
        16,
        2,
    )
}

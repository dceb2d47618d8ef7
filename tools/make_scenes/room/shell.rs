//! Walls, floor, ceiling, and what is fixed to them.

use glam::{DVec2, DVec3, dvec2, dvec3};

use super::lathe::lathe;
use super::looks::{BRASS, CARDBOARD, CEILING, Look, OAK, PICTURES, PLANKS, PLASTIC, WALL, WALNUT, WHITE_PAINT};
use super::shapes::{Rounding, board, moulding, rod, rounded_box};
use super::{Piece, piece};
use crate::mesh::{Mesh, joined, quad};

pub const LEFT: f64 = -2.6;
pub const RIGHT: f64 = 2.6;
pub const BACK: f64 = -2.4;
pub const FRONT: f64 = 2.8;
pub const HEIGHT: f64 = 2.6;
/// The chimney breast's front, and its sides.
pub const BREAST: f64 = -2.1;
const BREAST_SIDES: [f64; 2] = [-1.75, -0.25];
/// The mouth of the fireplace.
pub const MOUTH: [DVec2; 2] = [dvec2(-1.30, 0.03), dvec2(-0.70, 0.66)];

/// The hole in the left wall: z and y from, to.
pub const WINDOW: [DVec2; 2] = [dvec2(-1.35, 0.95), dvec2(0.15, 2.15)];
const REVEAL: f64 = 0.20;

/// A wall piece whose plaster goes on where the next piece's ends.
fn wall(corner: DVec3, u: DVec3, v: DVec3) -> Mesh {
    quad(corner, u, v).slid(dvec2(corner.dot(u.normalize()), -corner.dot(v.normalize()) - v.length()))
}

/// A wall from `corner` along `u` and `v`, metres, with a hole between two points in metres along them.
fn wall_with_hole(corner: DVec3, u: DVec3, v: DVec3, hole: [DVec2; 2]) -> Mesh {
    let (along, up) = (u.normalize(), v.normalize());
    let at = |p: DVec2| corner + along * p.x + up * p.y;
    let size = dvec2(u.length(), v.length());
    let part = |low: DVec2, high: DVec2| wall(at(low), along * (high.x - low.x), up * (high.y - low.y));
    let [low, high] = hole;
    let all_round = [
        part(DVec2::ZERO, dvec2(low.x, size.y)),
        part(dvec2(high.x, 0.0), size),
        part(dvec2(low.x, high.y), dvec2(high.x, size.y)),
    ];
    let below = (low.y > 0.0).then(|| part(dvec2(low.x, 0.0), dvec2(high.x, low.y)));
    joined(all_round.into_iter().chain(below))
}

pub fn room() -> Vec<Piece> {
    let (x, y, z) = ((RIGHT - LEFT) * DVec3::X, HEIGHT * DVec3::Y, (FRONT - BACK) * DVec3::Z);
    let [breast_left, breast_right] = BREAST_SIDES;
    let depth = (BREAST - BACK) * DVec3::Z;
    // The hole in metres from the front end of the left wall.
    let hole = [dvec2(FRONT - WINDOW[1].x, WINDOW[0].y), dvec2(FRONT - WINDOW[0].x, WINDOW[1].y)];
    let mouth = [dvec2(MOUTH[0].x - breast_left, 0.0), dvec2(MOUTH[1].x - breast_left, MOUTH[1].y)];
    let walls = joined([
        wall(dvec3(LEFT, 0.0, BACK), (breast_left - LEFT) * DVec3::X, y),
        wall(dvec3(breast_right, 0.0, BACK), (RIGHT - breast_right) * DVec3::X, y),
        wall(dvec3(breast_left, 0.0, BACK), depth, y),
        wall(dvec3(breast_right, 0.0, BREAST), -depth, y),
        wall_with_hole(dvec3(breast_left, 0.0, BREAST), (breast_right - breast_left) * DVec3::X, y, mouth),
        wall_with_hole(dvec3(LEFT, 0.0, FRONT), -z, y, hole),
        wall(dvec3(RIGHT, 0.0, BACK), z, y),
        wall(dvec3(RIGHT, 0.0, FRONT), -x, y),
    ]);
    vec![
        piece("floor", quad(dvec3(LEFT, 0.0, BACK), z, x), PLANKS),
        piece("ceiling", quad(dvec3(LEFT, HEIGHT, BACK), x, z), CEILING),
        piece("walls", walls, WALL),
        piece("skirting", joined([skirting(), cornice()]), WHITE_PAINT),
    ]
}

/// Along the walls, the room to the left, but for the door and the fireplace.
fn skirting() -> Mesh {
    const PROFILE: [(f64, f64); 5] = [(0.0, 0.120), (0.008, 0.118), (0.014, 0.105), (0.016, 0.09), (0.018, 0.0)];
    let floor = |x: f64, z: f64| dvec3(x, 0.0, z);
    let [breast_left, breast_right] = BREAST_SIDES;
    let round_the_room = [
        floor(breast_left + 0.08, BREAST),
        floor(breast_left, BREAST),
        floor(breast_left, BACK),
        floor(LEFT, BACK),
        floor(LEFT, FRONT),
        floor(RIGHT, FRONT),
        floor(RIGHT, BACK),
        floor(2.30, BACK),
    ];
    let to_the_door =
        [floor(1.30, BACK), floor(breast_right, BACK), floor(breast_right, BREAST), floor(breast_right - 0.08, BREAST)];
    joined([moulding(&round_the_room, false, DVec3::Y, &PROFILE), moulding(&to_the_door, false, DVec3::Y, &PROFILE)])
}

fn cornice() -> Mesh {
    const PROFILE: [(f64, f64); 6] =
        [(0.090, 0.0), (0.086, -0.016), (0.050, -0.034), (0.026, -0.060), (0.018, -0.090), (0.0, -0.094)];
    let [breast_left, breast_right] = BREAST_SIDES;
    let path = [
        (RIGHT, BACK),
        (breast_right, BACK),
        (breast_right, BREAST),
        (breast_left, BREAST),
        (breast_left, BACK),
        (LEFT, BACK),
        (LEFT, FRONT),
        (RIGHT, FRONT),
    ]
    .map(|(x, z)| dvec3(x, HEIGHT, z));
    moulding(&path, true, DVec3::Y, &PROFILE)
}

/// Reveal, frame, sill, and the garden outside.
pub fn window(outside_look: Look) -> Vec<Piece> {
    let [low, high] = WINDOW;
    let (y, z) = ((high.y - low.y) * DVec3::Y, (high.x - low.x) * DVec3::Z);
    let out = REVEAL * DVec3::X;
    let outside = LEFT - REVEAL;
    let reveal = joined([
        wall(dvec3(outside, low.y, low.x), out, y),
        wall(dvec3(LEFT, low.y, high.x), -out, y),
        wall(dvec3(outside, high.y, low.x), out, z),
        wall(dvec3(outside, low.y, low.x), z, out),
    ]);
    let bar = |from: DVec2, to: DVec2| board(dvec3(outside + 0.02, from.y, from.x), dvec3(outside + 0.07, to.y, to.x));
    let (middle, transom) = ((low.x + high.x) / 2.0, low.y + 0.78);
    let frame = joined([
        bar(low, dvec2(low.x + 0.06, high.y)),
        bar(dvec2(high.x - 0.06, low.y), high),
        bar(dvec2(low.x + 0.06, low.y), dvec2(high.x - 0.06, low.y + 0.06)),
        bar(dvec2(low.x + 0.06, high.y - 0.06), dvec2(high.x - 0.06, high.y)),
        bar(dvec2(middle - 0.03, low.y + 0.06), dvec2(middle + 0.03, high.y - 0.06)),
        bar(dvec2(low.x + 0.06, transom - 0.02), dvec2(middle - 0.03, transom + 0.02)),
        bar(dvec2(middle + 0.03, transom - 0.02), dvec2(high.x - 0.06, transom + 0.02)),
    ]);
    let sill = board(dvec3(outside + 0.07, low.y, low.x + 0.001), dvec3(LEFT + 0.06, low.y + 0.025, high.x - 0.001));
    let mut garden = quad(dvec3(-4.6, 0.0, 4.2), -8.0 * DVec3::Z, 3.6 * DVec3::Y);
    garden.uvs.iter_mut().for_each(|uv| *uv /= dvec2(8.0, 3.6));
    vec![
        piece("reveal", reveal, WALL),
        piece("frame", joined([frame, sill]), WHITE_PAINT),
        piece("garden", garden, outside_look),
    ]
}

/// Stands before the wall z = 0, round x = 0.
pub fn door() -> Vec<Piece> {
    const ARCHITRAVE: [(f64, f64); 5] = [(0.0, 0.0), (0.0, 0.020), (0.045, 0.024), (0.070, 0.014), (0.070, 0.0)];
    // A panel: a raised rim, a sunken field.
    const PANEL: [(f64, f64); 5] = [(-0.030, 0.001), (-0.018, 0.008), (0.0, 0.012), (0.008, 0.010), (0.012, 0.0)];
    let leaf = board(dvec3(-0.42, 0.006, 0.0), dvec3(0.42, 2.04, 0.012));
    let opening =
        [dvec3(-0.425, 0.0, 0.0), dvec3(-0.425, 2.045, 0.0), dvec3(0.425, 2.045, 0.0), dvec3(0.425, 0.0, 0.0)];
    let architrave = moulding(&opening, false, DVec3::Z, &ARCHITRAVE);
    let panel = |low: DVec2, high: DVec2| {
        let corners = [low, dvec2(low.x, high.y), high, dvec2(high.x, low.y)];
        moulding(&corners.map(|c| c.extend(0.012)), true, DVec3::Z, &PANEL)
    };
    let panels = [(-0.33, -0.06), (0.06, 0.33)].map(|(from, to)| {
        joined([panel(dvec2(from, 0.22), dvec2(to, 0.84)), panel(dvec2(from, 1.06), dvec2(to, 1.90))])
    });
    let plate = rounded_box(dvec3(0.034, 0.20, 0.006), Rounding::of(0.0025, 2)).moved(dvec3(-0.365, 1.0, 0.015));
    let handle = joined([
        rod(dvec3(-0.365, 1.03, 0.016), dvec3(-0.365, 1.03, 0.062), [0.009; 2], 16),
        rod(dvec3(-0.372, 1.03, 0.062), dvec3(-0.26, 1.03, 0.062), [0.009, 0.007], 16),
    ]);
    let switch = rounded_box(dvec3(0.08, 0.08, 0.01), Rounding::of(0.004, 2)).moved(dvec3(-0.60, 1.10, 0.005));
    let rocker = rounded_box(dvec3(0.045, 0.055, 0.008), Rounding::of(0.003, 2)).moved(dvec3(-0.60, 1.10, 0.011));
    vec![
        piece("leaf", joined([leaf, architrave].into_iter().chain(panels)), WHITE_PAINT),
        piece("handle", joined([plate, handle]), BRASS),
        piece("switch", joined([switch, rocker]), PLASTIC),
    ]
}

/// Framed, before the wall z = 0, round the origin. `which` of the four prints; width and height of the print.
pub fn picture(which: u32, [width, height]: [f64; 2]) -> Vec<Piece> {
    const PROFILE: [(f64, f64); 6] =
        [(-0.006, 0.010), (-0.004, 0.020), (0.006, 0.026), (0.018, 0.022), (0.022, 0.010), (0.022, 0.0)];
    let half = dvec2(width, height) / 2.0;
    let mount = half + 0.055;
    let corners = [-mount, dvec2(-mount.x, mount.y), mount, dvec2(mount.x, -mount.y)];
    let frame = moulding(&corners.map(|c| c.extend(0.0)), true, DVec3::Z, &PROFILE);
    let flat = |half: DVec2, z: f64| quad((-half).extend(z), 2.0 * half.x * DVec3::X, 2.0 * half.y * DVec3::Y);
    let mut print = flat(half, 0.0135);
    let quarter = dvec2(f64::from(which % 2), f64::from(which / 2)) / 2.0;
    print.uvs.iter_mut().for_each(|uv| *uv = quarter + (*uv / (2.0 * half) * 0.98 + 0.01) / 2.0);
    let wood = if which.is_multiple_of(2) { OAK } else { WALNUT };
    vec![
        piece("frame", frame, wood),
        piece("mount", flat(mount, 0.012), CARDBOARD),
        piece("print", print, PICTURES),
        piece(
            "nail",
            lathe(&[&[(0.0, 0.0), (0.004, 0.002), (0.0, 0.006)]], 8, 2).moved(dvec3(0.0, mount.y + 0.03, 0.0)),
            BRASS,
        ),
    ]
}

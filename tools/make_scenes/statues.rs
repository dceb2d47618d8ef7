//! Two sculptures of our own, for their folds, hollows and thin edges: a fluted knot and a hooded figure with a globe.
//!
//! Metres, standing on y = 0, facing +Z.

use std::f64::consts::{PI, TAU};

use glam::{DVec2, DVec3, dvec2, dvec3};

use crate::mesh::{Mesh, surface_nets, torus};
use crate::noise::noise;

/// A trefoil of fluted, twisted stone on a drum.
pub fn knot() -> Mesh {
    let mut mesh = torus(670, 48, knot_surface);
    mesh.append(surface_nets(drum, dvec3(-0.26, -0.01, -0.26), dvec3(0.26, 0.25, 0.26), 0.0068));
    mesh
}

/// A standing figure in a mantle.
pub fn figure() -> Mesh {
    surface_nets(figure_field, dvec3(-0.33, -0.01, -0.30), dvec3(0.33, 1.09, 0.34), 0.00555)
}

/// `u` runs along the knot, `v` round its section.
fn knot_surface(u: f64, v: f64) -> DVec3 {
    // A (2, 3) torus knot in the xy plane.
    const RING: f64 = 0.235;
    const COIL: f64 = 0.120;
    let centre = |u: f64| {
        let (around, coil) = (TAU * 2.0 * u, TAU * 3.0 * u);
        let distance = RING + COIL * coil.cos();
        dvec3(distance * around.sin(), distance * around.cos(), COIL * coil.sin())
    };
    let middle = centre(u);
    let ring_point = dvec3(middle.x, middle.y, 0.0).normalize() * RING;
    let tangent = (centre(u + 1e-4) - centre(u - 1e-4)).normalize();
    let outward = (middle - ring_point).reject_from_normalized(tangent).normalize();
    let side = outward.cross(tangent);

    // Six flutes with sharp arrises wind round the stone while it swells and thins.
    let turn = TAU * v;
    let flute = smooth_abs((3.0 * turn + TAU * 12.0 * u).sin(), 0.10);
    let swell = 1.0 + 0.14 * (TAU * 6.0 * u).cos();
    let radius = 0.074 * swell * (0.76 + 0.28 * flute);
    dvec3(0.0, 0.60, 0.0) + middle + radius * (outward * turn.cos() + side * turn.sin())
}

/// The drum under the knot: a fluted shaft between a base and a slab.
fn drum(p: DVec3) -> f64 {
    let angle = p.x.atan2(p.z);
    let distance = p.xz_length();
    let disc = |radius: f64, low: f64, high: f64, round: f64| {
        let d = dvec2(distance - radius + round, (p.y - (low + high) / 2.0).abs() - (high - low) / 2.0 + round);
        d.max(DVec2::ZERO).length() + d.max_element().min(0.0) - round
    };
    let flutes = 0.020 * smooth_abs((10.0 * angle).sin(), 0.15);
    let shaft = disc(0.195, 0.02, 0.21, 0.006) + flutes - 0.008;
    let base = disc(0.235, 0.0, 0.045, 0.014);
    let slab = disc(0.220, 0.185, 0.235, 0.012);
    smooth_min(smooth_min(base, slab, 0.004), shaft, 0.008)
}

/// Negative inside; near the surface about the distance in metres.
fn figure_field(p: DVec3) -> f64 {
    // The whole figure sways: weight on one leg.
    let sway = 0.030 * (PI * p.y / 0.62).sin() * smooth_step(0.0, 0.15, p.y);
    let p = dvec3(p.x - sway, p.y, p.z);
    let mirrored = dvec3(p.x.abs(), p.y, p.z);

    let mut stone = smooth_min(gown(p), arms(mirrored), 0.02);
    stone = smooth_min(stone, head(p), 0.015);
    stone = smooth_min(stone, mantle(p), 0.006);
    stone = smooth_min(stone, (p - GLOBE).length() - 0.072, 0.006);
    smooth_min(stone, base(p), 0.008)
}

const GLOBE: DVec3 = dvec3(0.0, 0.600, 0.170);

fn base(p: DVec3) -> f64 {
    let d = dvec2(p.xz_length() - 0.235, (p.y - 0.02).abs() - 0.02) + 0.012;
    d.max(DVec2::ZERO).length() + d.max_element().min(0.0) - 0.012
}

/// A robe whose folds deepen towards the hem.
fn gown(p: DVec3) -> f64 {
    let half_width = curve(
        p.y,
        &[(0.0, 0.190), (0.12, 0.172), (0.35, 0.132), (0.50, 0.118), (0.62, 0.100), (0.74, 0.095), (0.80, 0.03)],
    );
    let flat = 0.78;
    let angle = p.x.atan2(p.z / flat);
    let wander = 0.55 * noise(dvec3(p.x * 3.0, p.y * 2.2, p.z * 3.0)) + 0.2 * p.y;
    let broad = smooth_abs((4.5 * (angle + wander)).cos(), 0.10);
    let fine = smooth_abs((9.5 * (angle + 0.8 * wander) + 1.0).cos(), 0.12);
    let depth = curve(p.y, &[(0.0, 0.050), (0.25, 0.034), (0.5, 0.014), (0.62, 0.010), (0.8, 0.003)]);
    let fold = depth * (0.75 * broad + 0.25 * fine - 0.5);
    let trunk = (dvec2(p.x, p.z / flat).length() - half_width) * flat - fold;
    smooth_max(smooth_max(trunk, p.y - 0.80, 0.03), -p.y + 0.01, 0.01)
}

/// Sleeves and hands round the globe; `p.x` is mirrored.
fn arms(p: DVec3) -> f64 {
    let elbow = dvec3(0.150, 0.545, 0.045);
    let wrist = dvec3(0.085, 0.560, 0.135);
    let upper = cone_capsule(p, dvec3(0.115, 0.735, 0.0), elbow, 0.050, 0.048);
    let sleeve_folds = 0.006 * (p.dot(dvec3(60.0, -50.0, 90.0)) + 3.0 * noise(p * 14.0)).sin();
    let sleeve = cone_capsule(p, elbow, wrist, 0.046, 0.040) + sleeve_folds;
    let palm = ellipsoid(p - dvec3(0.064, 0.570, 0.180), dvec3(0.024, 0.040, 0.040));
    smooth_min(smooth_min(upper, sleeve, 0.04), palm, 0.012)
}

fn head(p: DVec3) -> f64 {
    // Bowed towards the globe.
    let tilted = turn_x(p - dvec3(0.0, 0.895, 0.030), 0.28);
    let mut face = ellipsoid(tilted, dvec3(0.056, 0.078, 0.064));
    let jaw = ellipsoid(tilted - dvec3(0.0, -0.038, 0.022), dvec3(0.034, 0.042, 0.036));
    face = smooth_min(face, jaw, 0.03);
    let mirrored = dvec3(tilted.x.abs(), tilted.y, tilted.z);
    let socket = ellipsoid(mirrored - dvec3(0.023, 0.006, 0.066), dvec3(0.016, 0.010, 0.014));
    face = smooth_max(face, -socket, 0.012);
    let lid = ellipsoid(mirrored - dvec3(0.023, 0.004, 0.051), dvec3(0.013, 0.009, 0.009));
    face = smooth_min(face, lid, 0.004);
    let nose = cone_capsule(tilted, dvec3(0.0, 0.016, 0.060), dvec3(0.0, -0.018, 0.070), 0.005, 0.009);
    face = smooth_min(face, nose, 0.010);
    let lips = ellipsoid(tilted - dvec3(0.0, -0.040, 0.058), dvec3(0.015, 0.006, 0.007));
    face = smooth_min(face, lips, 0.006);
    let neck = cone_capsule(p, dvec3(0.0, 0.76, -0.005), dvec3(0.0, 0.87, 0.015), 0.042, 0.036);
    smooth_min(face, neck, 0.02)
}

/// A hooded cloth about 15 mm thick, open in front, hanging in folds.
fn mantle(p: DVec3) -> f64 {
    let hood = ellipsoid(turn_x(p - dvec3(0.0, 0.905, 0.005), 0.22), dvec3(0.094, 0.118, 0.108));
    let shoulders = ellipsoid(p - dvec3(0.0, 0.735, -0.005), dvec3(0.172, 0.095, 0.112));
    let half_width =
        curve(p.y, &[(0.05, 0.232), (0.2, 0.222), (0.45, 0.205), (0.6, 0.196), (0.72, 0.150), (0.8, 0.10)]);
    let flat = 0.80;
    let fall = (dvec2(p.x, (p.z + 0.01) / flat).length() - half_width) * flat;
    let fall = smooth_max(fall, p.y - 0.76, 0.04);
    let body = smooth_min(smooth_min(hood, shoulders, 0.05), fall, 0.05);

    let angle = p.x.atan2(p.z / flat);
    let wander = 0.5 * noise(dvec3(p.x * 3.0 + 7.0, p.y * 2.0, p.z * 3.0));
    let broad = smooth_abs((5.5 * (angle + wander)).cos(), 0.12);
    let fine = smooth_abs((12.5 * (angle + wander)).cos(), 0.15);
    let depth = curve(p.y, &[(0.05, 0.046), (0.35, 0.038), (0.6, 0.024), (0.75, 0.011), (0.85, 0.005), (1.0, 0.002)]);
    let cloth = body - depth * (0.8 * broad + 0.2 * fine - 0.6);
    let shell = smooth_max(cloth, -(cloth + 0.019), 0.006);

    // The opening: a face-sized gap above, wider where the arms come through, then falling apart to the hem.
    let gap = curve(
        p.y,
        &[
            (0.05, 0.130),
            (0.35, 0.118),
            (0.55, 0.150),
            (0.66, 0.130),
            (0.76, 0.040),
            (0.80, 0.035),
            (0.87, 0.066),
            (0.93, 0.064),
            (0.975, 0.02),
            (1.0, -0.05),
        ],
    );
    let edge = 0.012 * (p.y * 24.0 + 2.0 * noise(p * 5.0)).sin() * smooth_step(0.75, 0.45, p.y);
    let opening = p.x.abs() - gap - edge * p.x.signum();
    let front = smooth_max(opening, -(p.z - 0.012), 0.02);
    let hem = 0.075 + 0.02 * (2.0 * angle).cos() + 0.012 * broad;
    // Stone is left standing behind: nobody sees there.
    let shell = smooth_min(shell, smooth_max(cloth + 0.004, p.z + 0.02, 0.006), 0.006);
    smooth_max(smooth_max(shell, -front, 0.010), hem - p.y, 0.010)
}

fn ellipsoid(p: DVec3, radii: DVec3) -> f64 {
    let k0 = (p / radii).length();
    let k1 = (p / (radii * radii)).length().max(1e-9);
    k0 * (k0 - 1.0) / k1
}

/// A capsule from `a` to `b` whose radius changes evenly.
fn cone_capsule(p: DVec3, a: DVec3, b: DVec3, radius_a: f64, radius_b: f64) -> f64 {
    let along = ((p - a).dot(b - a) / (b - a).length_squared()).clamp(0.0, 1.0);
    p.distance(a.lerp(b, along)) - (radius_a + (radius_b - radius_a) * along)
}

fn turn_x(p: DVec3, radians: f64) -> DVec3 {
    let (sin, cos) = radians.sin_cos();
    dvec3(p.x, cos * p.y + sin * p.z, cos * p.z - sin * p.y)
}

/// A minimum with a fillet about `width` wide.
fn smooth_min(a: f64, b: f64, width: f64) -> f64 {
    let h = (1.0 - (a - b).abs() / width).max(0.0);
    a.min(b) - h * h * width / 4.0
}

fn smooth_max(a: f64, b: f64, width: f64) -> f64 {
    -smooth_min(-a, -b, width)
}

/// |x| with a rounded valley.
fn smooth_abs(x: f64, round: f64) -> f64 {
    (x * x + round * round).sqrt()
}

fn smooth_step(from: f64, to: f64, x: f64) -> f64 {
    let t = ((x - from) / (to - from)).clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}

/// A smooth curve through the points (x, y): cubic Hermite, slopes from neighbours; level beyond the ends.
fn curve(x: f64, points: &[(f64, f64)]) -> f64 {
    let last = points.len() - 1;
    if x <= points[0].0 {
        return points[0].1;
    }
    let Some(i) = (0..last).find(|&i| x < points[i + 1].0) else { return points[last].1 };
    let slope = |i: usize| {
        let (a, b) = (points[i.saturating_sub(1)], points[(i + 1).min(last)]);
        if i == 0 || i == last { 0.0 } else { (b.1 - a.1) / (b.0 - a.0) }
    };
    let ((x0, y0), (x1, y1)) = (points[i], points[i + 1]);
    let (width, t) = (x1 - x0, (x - x0) / (x1 - x0));
    let (t2, t3) = (t * t, t * t * t);
    y0 * (2.0 * t3 - 3.0 * t2 + 1.0)
        + width * slope(i) * (t3 - 2.0 * t2 + t)
        + y1 * (3.0 * t2 - 2.0 * t3)
        + width * slope(i + 1) * (t3 - t2)
}

trait XzLength {
    fn xz_length(self) -> f64;
}

impl XzLength for DVec3 {
    /// Distance from the y axis.
    fn xz_length(self) -> f64 {
        dvec2(self.x, self.z).length()
    }
}

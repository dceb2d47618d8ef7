//! IES photometric files: the luminous intensity of a luminaire by direction.
//!
//! The format is that of [IES 2019]; the versions of 1986, 1991, 1995 and 2002 are read too.

use std::f64::consts::{FRAC_PI_2, PI, TAU};

/// Limit for a file; real ones have some 10 kB.
const MAX_BYTES: usize = 16 << 20;
/// Limit for an intensity. The brightest searchlights have 4e10 cd; sums and single precision stay finite.
const MAX_CANDELA: f64 = 1e15;
/// Negative intensities of up to this share of the peak are noise of the measurement and become zero.
const NOISE: f64 = 1e-3;
/// Tolerance in degrees for ranges of angles.
const ANGLE_TOLERANCE_DEG: f64 = 1e-3;

/// How a goniophotometer's angles map to directions. The polar axis is vertical in types A and C, horizontal in type B.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PhotometricType {
    /// Vehicle headlamps. Vertical angle: elevation above the plane x = 0, in [-90, 90] degrees. Horizontal angle: from
    /// +z around x, towards -y.
    A,
    /// Floodlights. Vertical angle: from +z around y, towards +x. Horizontal angle: elevation above the plane y = 0,
    /// towards -y, in [-90, 90] degrees.
    B,
    /// All others. Vertical angle: from +z, in [0, 180] degrees. Horizontal angle: from +x around z, towards +y.
    C,
}

/// The luminous intensity of a luminaire by direction, tabulated over two angles. Neither list of angles is empty.
///
/// The luminaire's frame has +z along its aim: nadir for type C, and both angles zero for types A and B, where +x is up
/// if the luminaire is aimed horizontally. The horizontal angles of type C count counterclockwise as seen from above,
/// those of types A and B clockwise [IES 2002, Section 3], so the frame is left-handed: y = cross(x, z).
#[derive(Clone, Debug, PartialEq)]
pub struct Photometry {
    pub photometric_type: PhotometricType,
    /// Radians, strictly ascending. A single angle stands for all: the intensity does not depend on it.
    pub vertical_angles: Vec<f64>,
    /// Radians, strictly ascending. A single angle stands for all. Type C: 90 or 180 degrees, mirrored at both ends, or
    /// 360 degrees. Types A and B: mirrored if the first angle is 0.
    pub horizontal_angles: Vec<f64>,
    /// Candela with all factors of the file; those of one horizontal angle follow each other. Finite, not negative and
    /// not all zero.
    pub candela: Vec<f64>,
}

/// Reads an IES file.
///
/// Tilt factors are skipped: they depend on how the lamp is mounted, not on direction.
///
/// # Errors
/// One sentence that says what is wrong with the file.
pub fn parse(bytes: &[u8]) -> Result<Photometry, String> {
    if bytes.len() > MAX_BYTES {
        return Err(format!("the file has {} bytes, more than {MAX_BYTES}", bytes.len()));
    }
    let text = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes);
    let mut lines = text.split(|b| matches!(b, b'\n' | b'\r')).map(<[u8]>::trim_ascii);
    let header = lines.clone().find(|line| !line.is_empty()).unwrap_or_default();
    let tilt = lines.find_map(tilt).ok_or("the file has no line that begins with TILT=")?;
    // Control bytes are blanks: some files end with that of DOS, 0x1a.
    let words = lines.flat_map(|line| line.split(|&b| b <= b' ' || b == b','));
    let mut words = words.filter(|word| !word.is_empty());

    if tilt.eq_ignore_ascii_case(b"INCLUDE") {
        number(&mut words, "the lamp geometry of TILT")?;
        let tilt_count = count(&mut words, "tilt angles")?;
        numbers(&mut words, tilt_count, "tilt angles")?;
        numbers(&mut words, tilt_count, "tilt factors")?;
    }
    number(&mut words, "the number of lamps")?;
    number(&mut words, "the lumens per lamp")?;
    let multiplier = number(&mut words, "the candela multiplier")?;
    let vertical_count = count(&mut words, "vertical angles")?;
    let horizontal_count = count(&mut words, "horizontal angles")?;
    let photometric_type = match number(&mut words, "the photometric type")? {
        1.0 => PhotometricType::C,
        2.0 => PhotometricType::B,
        3.0 => PhotometricType::A,
        other => return Err(format!("the photometric type is {other:?}, not 1, 2 or 3")),
    };
    for what in ["the unit", "the width", "the length", "the height"] {
        number(&mut words, what)?;
    }
    let ballast_factor = number(&mut words, "the ballast factor")?;
    let ballast_lamp_factor = number(&mut words, "the ballast-lamp photometric factor")?;
    number(&mut words, "the input watts")?;
    // Since 1995 the field is reserved; since 2019 it says how the file was made.
    let scale = multiplier * ballast_factor * if has_ballast_lamp_factor(header) { ballast_lamp_factor } else { 1.0 };
    if scale <= 0.0 {
        return Err(format!("the candela multiplier times the ballast factor is {scale:?}, not positive"));
    }

    let limits = match photometric_type {
        PhotometricType::A => [(-90.0, 90.0), (-180.0, 180.0)],
        PhotometricType::B => [(-180.0, 180.0), (-90.0, 90.0)],
        PhotometricType::C => [(0.0, 180.0), (-360.0, 360.0)],
    };
    let vertical_angles = angles(&mut words, vertical_count, "vertical angles", limits[0])?;
    let mut horizontal_angles = angles(&mut words, horizontal_count, "horizontal angles", limits[1])?;
    let expected = vertical_count.saturating_mul(horizontal_count);
    let what = format!("candela values ({vertical_count} vertical by {horizontal_count} horizontal angles)");
    let mut candela = numbers(&mut words, expected, &what)?;
    if words.next().is_some_and(|word| value(word).is_ok()) {
        return Err(format!("the file has more than {expected} {what}"));
    }
    scale_candela(&mut candela, scale)?;
    if photometric_type == PhotometricType::C {
        close_circle(&mut horizontal_angles, &mut candela, vertical_count)?;
    }
    Ok(Photometry { photometric_type, vertical_angles, horizontal_angles, candela })
}

/// The value of a TILT line.
fn tilt(line: &[u8]) -> Option<&[u8]> {
    let (keyword, value) = line.split_at_checked(4)?;
    let value = value.trim_ascii_start().strip_prefix(b"=")?;
    keyword.eq_ignore_ascii_case(b"TILT").then(|| value.trim_ascii_start())
}

/// Whether the intensities are to be multiplied by the ballast-lamp photometric factor: in versions before 1995. The
/// first of them has no header.
fn has_ballast_lamp_factor(header: &[u8]) -> bool {
    let is_named = |name: &[u8]| header.windows(name.len()).any(|part| part.eq_ignore_ascii_case(name));
    !is_named(b"LM-63-") || is_named(b"LM-63-1986") || is_named(b"LM-63-1991")
}

fn value(word: &[u8]) -> Result<f64, String> {
    let number = std::str::from_utf8(word).ok().and_then(|word| word.parse().ok()).filter(|x: &f64| x.is_finite());
    number.ok_or_else(|| {
        let shown = String::from_utf8_lossy(word).chars().take(20).collect::<String>();
        format!("{shown:?} is not a number")
    })
}

fn number<'a>(words: &mut impl Iterator<Item = &'a [u8]>, what: &str) -> Result<f64, String> {
    let word = words.next().ok_or_else(|| format!("the file ends before {what}"))?;
    value(word).map_err(|reason| format!("{reason}, but stands for {what}"))
}

fn count<'a>(words: &mut impl Iterator<Item = &'a [u8]>, what: &str) -> Result<usize, String> {
    let count = number(words, &format!("the number of {what}"))?;
    if count < 1.0 || count.fract() != 0.0 {
        return Err(format!("the number of {what} is {count:?}, not a positive integer"));
    }
    Ok(count as usize)
}

/// Allocates for the words found, whatever `count` is.
fn numbers<'a>(words: &mut impl Iterator<Item = &'a [u8]>, count: usize, what: &str) -> Result<Vec<f64>, String> {
    let numbers = words.take(count).map(value).collect::<Result<Vec<_>, _>>();
    let numbers = numbers.map_err(|reason| format!("{reason}, but stands among the {what}"))?;
    if numbers.len() < count {
        return Err(format!("the file has only {} of {count} {what}", numbers.len()));
    }
    Ok(numbers)
}

/// Reads degrees and returns radians.
fn angles<'a>(
    words: &mut impl Iterator<Item = &'a [u8]>,
    count: usize,
    what: &str,
    (least, greatest): (f64, f64),
) -> Result<Vec<f64>, String> {
    let mut angles = numbers(words, count, what)?;
    for angle in &mut angles {
        if *angle < least - ANGLE_TOLERANCE_DEG || *angle > greatest + ANGLE_TOLERANCE_DEG {
            return Err(format!("{angle:?} is outside of {least} to {greatest} degrees, but stands among the {what}"));
        }
        *angle = angle.clamp(least, greatest).to_radians();
    }
    if let Some(pair) = angles.windows(2).find(|pair| pair[0] >= pair[1]) {
        let [before, after] = [pair[0], pair[1]].map(f64::to_degrees);
        return Err(format!("the {what} do not ascend: {after:.6} degrees follow {before:.6}"));
    }
    Ok(angles)
}

/// Multiplies intensities by `scale` and checks their range.
fn scale_candela(candela: &mut [f64], scale: f64) -> Result<(), String> {
    let peak = scale * candela.iter().copied().fold(0.0, f64::max);
    if !(f64::MIN_POSITIVE..=MAX_CANDELA).contains(&peak) {
        return Err(format!("the largest intensity is {peak:?} cd, which no luminaire has"));
    }
    for candela in candela {
        *candela *= scale;
        if *candela < -NOISE * peak {
            return Err(format!("an intensity is negative: {candela:?} cd"));
        }
        *candela = candela.max(0.0);
    }
    Ok(())
}

/// Checks the range of type C's horizontal angles. Between 180 and 360 degrees the last angle of the circle is missing;
/// it repeats the first.
fn close_circle(angles: &mut Vec<f64>, candela: &mut Vec<f64>, vertical_count: usize) -> Result<(), String> {
    let [first, .., last] = angles[..] else { return Ok(()) };
    let span_deg = (last - first).to_degrees();
    let spans = |degrees: f64| (span_deg - degrees).abs() <= ANGLE_TOLERANCE_DEG;
    if spans(90.0) || spans(180.0) || spans(360.0) {
        return Ok(());
    }
    if !(180.0..360.0).contains(&span_deg) {
        return Err(format!("the horizontal angles span {span_deg:.6} degrees, not 0, 90, 180 or 360"));
    }
    angles.push(first + TAU);
    candela.extend_from_within(..vertical_count);
    Ok(())
}

impl Photometry {
    /// Candela in `direction` in the luminaire's frame, of any length: linear in both angles, zero outside of their
    /// ranges.
    pub fn candela(&self, [x, y, z]: [f64; 3]) -> f64 {
        let length = |a: f64, b: f64| (a * a + b * b).sqrt();
        let (vertical, horizontal) = match (self.photometric_type, self.horizontal_angles.len()) {
            (PhotometricType::A, _) => (atan2(x, length(y, z)), atan2(-y, z)),
            (PhotometricType::B, _) => (atan2(x, z), atan2(-y, length(x, z))),
            (PhotometricType::C, 1) => (atan2(length(x, y), z), 0.0),
            (PhotometricType::C, _) => (atan2(length(x, y), z), atan2(y, x)),
        };
        let Some((row, v)) = bracket(&self.vertical_angles, vertical) else { return 0.0 };
        let Some((column, h)) = bracket(&self.horizontal_angles, self.unfold(horizontal)) else { return 0.0 };
        // Exact where both ends are equal.
        let lerp = |a: f64, b: f64, t: f64| a + (b - a) * t;
        let row_count = self.vertical_angles.len();
        let next_row = usize::from(row_count > 1);
        let at = |column: usize| {
            let candela = &self.candela[column * row_count..][..row_count];
            lerp(candela[row], candela[row + next_row], v)
        };
        let next_column = usize::from(self.horizontal_angles.len() > 1);
        lerp(at(column), at(column + next_column), h)
    }

    /// Maps a horizontal angle to the tabulated range by the file's symmetry.
    fn unfold(&self, horizontal: f64) -> f64 {
        let [first, .., last] = self.horizontal_angles[..] else { return horizontal };
        match self.photometric_type {
            PhotometricType::A | PhotometricType::B if first == 0.0 => horizontal.abs(),
            PhotometricType::A | PhotometricType::B => horizontal,
            PhotometricType::C => {
                // A mirrored quadrant repeats each half turn.
                let (period, frequency) = if last - first < 0.75 * PI { (PI, 1.0 / PI) } else { (TAU, 1.0 / TAU) };
                let offset = horizontal - first;
                // Not `floor`, which is a function call on x86-64-v1; |offset| < 10 periods.
                let repetition = f64::from((offset * frequency + 10.0) as i32) - 10.0;
                let offset = offset - repetition * period;
                let folded = if is_mirrored(last - first) { offset.min(period - offset) } else { offset };
                (first + folded).max(first).min(last)
            }
        }
    }

    /// The largest intensity in candela.
    pub fn max(&self) -> f64 {
        self.candela.iter().copied().fold(0.0, f64::max)
    }

    /// Luminous flux in lumens: the exact integral of [`Self::candela`] over all directions.
    pub fn flux(&self) -> f64 {
        let (vertical, horizontal) = (&self.vertical_angles, &self.horizontal_angles);
        let (vertical_weights, horizontal_weights) = match self.photometric_type {
            PhotometricType::A => (polar_weights(vertical, FRAC_PI_2), azimuth_weights(horizontal)),
            PhotometricType::B => (azimuth_weights(vertical), polar_weights(horizontal, FRAC_PI_2)),
            PhotometricType::C => (polar_weights(vertical, 0.0), azimuth_weights(horizontal)),
        };
        let rows = self.candela.chunks_exact(vertical.len()).zip(horizontal_weights);
        let flux: f64 =
            rows.map(|(row, w)| w * row.iter().zip(&vertical_weights).map(|(c, w)| c * w).sum::<f64>()).sum();
        flux * match (self.photometric_type, &horizontal[..]) {
            (PhotometricType::C, [first, .., last]) if is_mirrored(last - first) => TAU / (last - first),
            (PhotometricType::A | PhotometricType::B, [first, _, ..]) if *first == 0.0 => 2.0,
            _ => 1.0,
        }
    }
}

/// Whether horizontal angles of type C that span `span` radians are mirrored: spans are 90, 180 or 360 degrees.
fn is_mirrored(span: f64) -> bool {
    span < 1.5 * PI
}

/// As [`f64::atan2`] to 1e-9 radians, exact along the axes, in a third of the time.
fn atan2(y: f64, x: f64) -> f64 {
    // Chebyshev series 2 sum (-1)^k (sqrt(2) - 1)^(2k + 1) / (2k + 1) T_(2k + 1) of the arctangent in [0, 1], 10 terms.
    const C: [f64; 10] = [
        0.9999999778952151,
        -0.3333316439068341,
        0.19996155515396455,
        -0.1424497268044423,
        0.10868261299157624,
        -0.08188949889203301,
        0.05464641848244583,
        -0.028141838627749872,
        0.009392884308299324,
        -0.001472577957008285,
    ];
    let (width, height) = (x.abs(), y.abs());
    let greater = width.max(height);
    let tan = if greater > 0.0 { width.min(height) / greater } else { 0.0 };
    let (x1, x2) = (tan * tan, tan.powi(4));
    let x4 = x2 * x2;
    // Estrin's scheme: shorter dependency chains than Horner's.
    let low = (C[0] + C[1] * x1) + (C[2] + C[3] * x1) * x2;
    let high = (C[4] + C[5] * x1) + (C[6] + C[7] * x1) * x2 + (C[8] + C[9] * x1) * x4;
    let octant = tan * (low + high * x4);
    let quadrant = if height > width { FRAC_PI_2 - octant } else { octant };
    (if x < 0.0 { PI - quadrant } else { quadrant }).copysign(y)
}

/// Index of the angle before `angle` and the position between it and the next in [0, 1], or `None` outside.
#[inline]
fn bracket(angles: &[f64], angle: f64) -> Option<(usize, f64)> {
    let [first, .., last] = *angles else { return Some((0, 0.0)) };
    if !(first..=last).contains(&angle) {
        return None;
    }
    // The steps of most files are equal.
    let step_count = angles.len() - 1;
    let mut before = ((angle - first) * (step_count as f64 / (last - first))) as i64 as usize;
    before = before.min(step_count - 1);
    if angle < angles[before] || angle > angles[before + 1] {
        before = angles.partition_point(|a| *a <= angle).clamp(1, step_count) - 1;
    }
    let (a, b) = (angles[before], angles[before + 1]);
    Some((before, (angle - a) / (b - a)))
}

/// Integrals over the azimuth of the functions that are 1 at one angle, 0 at the others and linear between.
fn azimuth_weights(angles: &[f64]) -> Vec<f64> {
    weights(angles, TAU, |a, b| [0.5 * (b - a); 2])
}

/// As [`azimuth_weights`], times the sine of the polar angle, which is `offset` larger than the tabulated angle.
fn polar_weights(angles: &[f64], offset: f64) -> Vec<f64> {
    weights(angles, 2.0, |a, b| {
        let ((sin_a, cos_a), (sin_b, cos_b)) = ((a + offset).sin_cos(), (b + offset).sin_cos());
        let after = (sin_b - sin_a) / (b - a) - cos_b;
        [cos_a - cos_b - after, after]
    })
}

/// Sums the weights of both ends of each interval; `whole` is the weight of a single angle.
fn weights(angles: &[f64], whole: f64, of_interval: impl Fn(f64, f64) -> [f64; 2]) -> Vec<f64> {
    if angles.len() == 1 {
        return vec![whole];
    }
    let mut weights = vec![0.0; angles.len()];
    for (i, pair) in angles.windows(2).enumerate() {
        let [before, after] = of_interval(pair[0], pair[1]);
        weights[i] += before;
        weights[i + 1] += after;
    }
    weights
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A file of version 2002 with the `fields` from the number of lamps to the input watts.
    fn file(fields: &str, vertical: &[f64], horizontal: &[f64], candela: &[f64]) -> String {
        let list = |x: &[f64]| x.iter().map(f64::to_string).collect::<Vec<_>>().join(" ");
        let [vertical, horizontal, candela] = [vertical, horizontal, candela].map(list);
        format!("IESNA:LM-63-2002\r\nTILT=NONE\r\n{fields}\r\n{vertical}\r\n{horizontal}\r\n{candela}\r\n")
    }

    /// A file of type 1 (C), 2 (B) or 3 (A) without factors.
    fn tabulate(kind: u32, vertical: &[f64], horizontal: &[f64], candela: impl Fn(f64, f64) -> f64) -> Photometry {
        let fields = format!("1 -1 1 {} {} {kind} 2 0 0 0 1 1 0", vertical.len(), horizontal.len());
        let values: Vec<f64> = horizontal.iter().flat_map(|h| vertical.iter().map(|v| candela(*v, *h))).collect();
        parse(file(&fields, vertical, horizontal, &values).as_bytes()).unwrap()
    }

    fn steps(first: f64, last: f64, count: u32) -> Vec<f64> {
        (0..=count).map(|i| first + (last - first) * f64::from(i) / f64::from(count)).collect()
    }

    /// Direction of type C's angles in degrees.
    fn direction(vertical: f64, horizontal: f64) -> [f64; 3] {
        let ((sin, cos), (y, x)) = (vertical.to_radians().sin_cos(), horizontal.to_radians().sin_cos());
        [sin * x, sin * y, cos]
    }

    /// Directions of the same solid angle: a spiral from pole to pole.
    fn sphere(count: u32) -> impl Iterator<Item = [f64; 3]> {
        (0..count).map(move |i| {
            let z = 1.0 - (2.0 * f64::from(i) + 1.0) / f64::from(count);
            let (y, x) = (f64::from(i) * 2.399963229728653).sin_cos();
            let r = (1.0 - z * z).sqrt();
            [r * x, r * y, z]
        })
    }

    fn assert_near(got: f64, want: f64, tolerance: f64) {
        assert!((got - want).abs() <= tolerance, "{got} is not {want} to {tolerance}");
    }

    fn error(source: &str) -> String {
        parse(source.as_bytes()).unwrap_err()
    }

    // Quadrant-symmetric, in the shape of a manufacturer's file: keywords with Latin-1, broken lines.
    const TROFFER: &[u8] = b"IESNA:LM-63-1995\r\n[TEST] 42\r\n[MANUFAC] B\xfcro & S\xf6hne\r\n[LUMCAT] 2x4-35\r\n\
        [OTHER] 15 degrees, [-1, 3]\r\nTILT=NONE\r\n2 1250 0.5\r\n 7 3 1 2 0.6 1.2 0\r\n0.9 1.0 62\r\n\
        0 15 30 45\r\n60 75 90\r\n0 45 90\r\n\
        1000 960 850 690 470 210 0\r\n1000 970 880 730 520\r\n250 0\r\n1000 980 910 780 570 300 0\r\n";

    #[test]
    fn a_constant_table_is_exactly_constant_and_has_4_pi_lumens() {
        let full = steps(0.0, 360.0, 7);
        for horizontal in [&[0.0][..], &[0.0, 90.0], &[0.0, 70.0, 180.0], &[90.0, 180.0, 270.0], &full, &full[..7]] {
            let constant = tabulate(1, &[0.0, 10.0, 71.3, 180.0], horizontal, |_, _| 0.1);
            assert!(sphere(3_000).all(|d| constant.candela(d) == 0.1));
            assert!(
                [[0., 0., 1.], [0., 0., -1.], [-1., -0., 0.], [0., -2., 0.]]
                    .iter()
                    .all(|d| constant.candela(*d) == 0.1)
            );
            assert_eq!(constant.max(), 0.1);
            assert_near(constant.flux(), 0.4 * PI, 1e-12);
        }
        assert!(
            sphere(3_000).all(|d| tabulate(2, &steps(-180.0, 180.0, 9), &[-90.0, 90.0], |_, _| 0.1).candela(d) == 0.1)
        );
        assert!(
            sphere(3_000).all(|d| tabulate(3, &[-90.0, 90.0], &steps(-180.0, 180.0, 9), |_, _| 0.1).candela(d) == 0.1)
        );
    }

    #[test]
    fn a_quadrant_is_mirrored_at_both_planes() {
        let troffer = parse(TROFFER).unwrap();
        assert_eq!(troffer.vertical_angles.len(), 7);
        assert_near(troffer.max(), 1_000.0 * 0.5 * 0.9, 1e-9);
        // Nodes and the middle between four of them.
        assert_near(troffer.candela(direction(60.0, 45.0)), 0.45 * 520.0, 1e-5);
        let middle = 0.45 * (850.0 + 690.0 + 880.0 + 730.0) / 4.0;
        for horizontal in [22.5, 157.5, 202.5, 337.5, -22.5] {
            assert_near(troffer.candela(direction(37.5, horizontal)), middle, 1e-5);
        }
        assert_near(troffer.candela(direction(30.0, 270.0)), 0.45 * 910.0, 1e-5);
        assert_eq!(troffer.candela(direction(90.1, 10.0)), 0.0);
    }

    #[test]
    fn half_and_full_circles() {
        let half = tabulate(1, &[0.0, 90.0], &[0.0, 90.0, 180.0], |_, h| 400.0 - h);
        let sideways = tabulate(1, &[0.0, 90.0], &[90.0, 180.0, 270.0], |_, h| h);
        // From 360 down to 0 at 270 degrees, then up again.
        let full = tabulate(1, &[0.0, 90.0], &steps(0.0, 360.0, 8), |_, h| (270.0 - h).abs());
        let open = tabulate(1, &[0.0, 90.0], &steps(0.0, 315.0, 7), |_, h| (270.0 - h).abs());
        for h in [5.0, 60.0, 95.0, 170.0] {
            let [x, y, z] = direction(50.0, h);
            assert_near(half.candela([x, y, z]), 400.0 - h, 1e-5);
            assert_near(half.candela([x, -y, z]), 400.0 - h, 1e-5);
            assert_near(sideways.candela([-y, x, z]), 90.0 + h, 1e-5);
            assert_near(sideways.candela([y, x, z]), 90.0 + h, 1e-5);
            assert_near(full.candela([x, y, z]), 270.0 - h, 1e-5);
            assert_near(open.candela([x, y, z]), 270.0 - h, 1e-5);
            assert_near(full.candela([-x, -y, z]), (90.0 - h).abs(), 1e-5);
        }
        // The angle missing in an open circle repeats the first.
        assert_near(full.candela(direction(50.0, 337.5)), 67.5, 1e-5);
        assert_near(open.candela(direction(50.0, 337.5)), (45.0 + 270.0) / 2.0, 1e-5);
    }

    #[test]
    fn light_upwards_only() {
        let uplight = tabulate(1, &[90.0, 120.0, 180.0], &[0.0], |v, _| v);
        assert_eq!(uplight.candela([0.6, 0.0, 0.8]), 0.0);
        assert_eq!(uplight.candela([0.6, 0.8, 0.0]), 90.0);
        assert_near(uplight.candela(direction(150.0, 77.0)), 150.0, 1e-6);
        assert_eq!(uplight.candela([0.0, 0.0, -1.0]), 180.0);
    }

    #[test]
    fn a_single_angle_stands_for_all() {
        for kind in [1, 2, 3] {
            let single = tabulate(kind, &[0.0], &[0.0], |_, _| 25.0);
            assert!(sphere(100).all(|d| single.candela(d) == 25.0));
            assert_near(single.flux(), 100.0 * PI, 1e-10);
        }
    }

    #[test]
    fn angles_of_types_a_and_b() {
        // Beam up and to the right as seen from the luminaire: +x and -y.
        let (up, right) = (20.0f64.to_radians(), 30.0f64.to_radians());
        let value = |v: f64, h: f64| 1_000.0 + 3.0 * v + h;
        let ten = steps(-90.0, 90.0, 18);
        let a = tabulate(3, &ten, &ten, value);
        assert_near(a.candela([0.0, 0.0, 1.0]), 1_000.0, 1e-5);
        assert_near(a.candela([up.sin(), -up.cos() * right.sin(), up.cos() * right.cos()]), 1_090.0, 1e-5);
        assert_eq!(a.candela([0.0, 0.1, -1.0]), 0.0);
        let b = tabulate(2, &ten, &ten, value);
        assert_near(b.candela([0.0, 0.0, 1.0]), 1_000.0, 1e-5);
        assert_near(b.candela([right.cos() * up.sin(), -right.sin(), right.cos() * up.cos()]), 1_090.0, 1e-5);
        assert_eq!(b.candela([0.1, 0.0, -1.0]), 0.0);
        for kind in [2, 3] {
            let mirrored = tabulate(kind, &ten, &ten[9..], value);
            let whole = tabulate(kind, &ten, &ten, |v, h| value(v, h.abs()));
            assert!(sphere(1_000).all(|d| (mirrored.candela(d) - whole.candela(d)).abs() < 1e-5));
            assert_near(mirrored.flux(), whole.flux(), 1e-9);
        }
    }

    #[test]
    fn the_flux_is_the_integral_over_the_sphere() {
        // A Lambertian luminaire of 1,000 cd; steps of 1 degree.
        let lambertian = tabulate(1, &steps(0.0, 90.0, 90), &[0.0], |v, _| 1_000.0 * v.to_radians().cos());
        assert_near(lambertian.flux(), 1_000.0 * PI, 0.1);
        let value = |v: f64, h: f64| 100.0 + v.abs() + (v * 0.05 + h * 0.03).sin() * 80.0;
        let (all, upper) = (steps(-90.0, 90.0, 9), [0.0, 20.0, 50.0, 90.0]);
        let circle = steps(-180.0, 180.0, 12);
        let profiles = [
            parse(TROFFER).unwrap(),
            tabulate(1, &[0.0, 3.0, 50.0, 180.0], &[0.0, 77.0, 180.0], value),
            tabulate(1, &[90.0, 99.0, 180.0], &circle, |v, h| value(v, h.abs())),
            tabulate(1, &steps(0.0, 90.0, 7), &steps(0.0, 350.0, 35), value),
            tabulate(2, &upper, &all, value),
            tabulate(2, &circle, &upper, value),
            tabulate(3, &all, &circle, value),
            tabulate(3, &upper, &upper, value),
        ];
        for profile in profiles {
            let count = 200_000;
            let sum: f64 = sphere(count).map(|d| profile.candela(d)).sum();
            assert_near(4.0 * PI * sum / f64::from(count) / profile.flux(), 1.0, 1e-3);
        }
    }

    #[test]
    fn any_spelling_reads_the_same() {
        let want = parse(TROFFER).unwrap();
        let text: String = TROFFER.iter().map(|b| char::from(*b)).collect();
        let (head, numbers) = text.split_once("NONE\r\n").unwrap();
        let words: Vec<&str> = numbers.split_ascii_whitespace().collect();
        let tilts = ["NONE", "none \r\n", "lamp.tlt", "INCLUDE\r\n1 3\r\n0, 90\r\n180 1.0 0.95\r\n0.9"];
        for (tilt, separator) in tilts.into_iter().zip(["\r\n", ",", " ,\t", "\r"]) {
            let text = format!("{head}{tilt}\r\n{}\r\n\x1a", words.join(separator));
            assert_eq!(parse(text.as_bytes()).as_ref(), Ok(&want), "{text}");
            assert_eq!(parse(text.replace("\r\n", "\n").as_bytes()).as_ref(), Ok(&want));
            assert_eq!(parse(text.replace('\n', "\r").as_bytes()).as_ref(), Ok(&want));
            assert_eq!(parse(format!("\u{feff}{text}").as_bytes()).as_ref(), Ok(&want));
        }
    }

    #[test]
    fn versions_differ_in_the_ballast_lamp_factor() {
        let text = file("1 1000 2 1 1 1 1 0 0 0 0.5 0.8 50", &[0.0], &[0.0], &[7.0]);
        for (header, want) in [
            ("", 5.6),
            ("Acme 1200\r\n", 5.6),
            ("IESNA91\r\n", 5.6),
            ("IESNA:LM-63-1986\r\n", 5.6),
            ("\r\nIESNA:LM-63-1991\r\n", 5.6),
            ("IESNA:LM-63-1995\r\n", 7.0),
            ("IESNA:LM-63-2002\r\n", 7.0),
            ("IES:LM-63-2019\r\n", 7.0),
        ] {
            let profile = parse(text.replace("IESNA:LM-63-2002\r\n", header).as_bytes()).unwrap();
            assert_near(profile.max(), want, 1e-12);
        }
    }

    #[test]
    fn errors_say_what_is_wrong() {
        let fields = "1 -1 1 3 1 1 2 0 0 0 1 1 0";
        let angles = |v: &[f64], h: &[f64]| {
            error(&file(&format!("1 -1 1 {} {} 1 2 0 0 0 1 1 0", v.len(), h.len()), v, h, &[1.0; 4]))
        };
        assert_eq!(error(""), "the file has no line that begins with TILT=");
        assert_eq!(error("TILT=NONE\n1 1000\n"), "the file ends before the candela multiplier");
        assert_eq!(error("TILT=INCLUDE\n1 3\n0 90 180\n1"), "the file has only 1 of 3 tilt factors");
        assert_eq!(
            error(&file(fields, &[0.0, 45.0, 90.0], &[0.0], &[5.0, 4.0])),
            "the file has only 2 of 3 candela values (3 vertical by 1 horizontal angles)"
        );
        assert_eq!(
            error(&file(fields, &[0.0, 45.0, 90.0], &[0.0], &[5.0; 4])),
            "the file has more than 3 candela values (3 vertical by 1 horizontal angles)"
        );
        assert_eq!(
            angles(&[0.0, 50.0, 45.0, 90.0], &[0.0]),
            "the vertical angles do not ascend: 45.000000 degrees follow 50.000000"
        );
        assert!(angles(&[0.0, 90.0], &[0.0, 0.0]).starts_with("the horizontal angles do not ascend"));
        assert!(angles(&[-90.0, 0.0, 45.0, 90.0], &[0.0]).starts_with("-90.0 is outside of 0 to 180 degrees"));
        assert_eq!(
            angles(&[0.0, 90.0], &[0.0, 60.0]),
            "the horizontal angles span 60.000000 degrees, not 0, 90, 180 or 360"
        );
        for (index, word, want) in [
            (2, "-1", "not positive"),
            (2, "1e300", "which no luminaire has"),
            (3, "2.5", "not a positive integer"),
            (3, "0", "not a positive integer"),
            (3, "1e18", "the file has only 7 of 1000000000000000000 vertical angles"),
            (4, "1e18", "horizontal angles"),
            (5, "4", "the photometric type is 4.0"),
            (10, "nan", "\"nan\" is not a number, but stands for the ballast factor"),
            (17, "-2", "an intensity is negative"),
            (18, "inf", "\"inf\" is not a number, but stands among the candela values"),
        ] {
            let text = file(fields, &[0.0, 45.0, 90.0], &[0.0], &[5.0, 4.0, 3.0]);
            let (head, numbers) = text.split_once("NONE\r\n").unwrap();
            let mut words: Vec<&str> = numbers.split_ascii_whitespace().collect();
            words[index] = word;
            let error = error(&format!("{head}NONE\n{}", words.join(" ")));
            assert!(error.contains(want), "{error}");
        }
        assert!(
            error(&file(fields, &[0.0, 45.0, 90.0], &[0.0], &[0.0; 3])).starts_with("the largest intensity is 0.0 cd")
        );
        assert!(parse(&vec![b' '; MAX_BYTES + 1]).is_err());
    }

    #[test]
    fn negative_noise_becomes_zero() {
        let noisy = tabulate(1, &[0.0, 90.0], &[0.0], |v, _| if v == 0.0 { 1_000.0 } else { -0.5 });
        assert_eq!(noisy.candela, [1_000.0, 0.0]);
    }

    #[test]
    fn mutants_are_read_or_refused() {
        let mut state = 1u64;
        let mut random = |below: usize| {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            ((state >> 33) as usize) % below
        };
        let (mut read, mut refused) = (0, 0);
        for _ in 0..1_000 {
            let mut text = TROFFER.to_vec();
            for _ in 0..=random(3) {
                let at = random(text.len());
                match random(8) {
                    0 => text.truncate(at.max(1)),
                    1..3 => text[at] ^= 1 << random(8),
                    3..5 => text.insert(at, b"0123456789-.,e \n"[random(16)]),
                    5 => text[at] = random(256) as u8,
                    _ => drop(text.remove(at)),
                }
                if text.is_empty() {
                    break;
                }
            }
            match parse(&text) {
                Ok(profile) => {
                    read += 1;
                    let (max, flux) = (profile.max(), profile.flux());
                    assert!(max > 0.0 && max <= MAX_CANDELA && (0.0..=4.1 * PI * max).contains(&flux));
                    assert!(sphere(50).all(|d| (0.0..=max).contains(&profile.candela(d))));
                    assert!((0.0..=max).contains(&profile.candela([0.0; 3])));
                }
                Err(reason) => {
                    refused += 1;
                    assert!(!reason.is_empty() && reason.len() < 200 && !reason.contains('\n'), "{reason}");
                }
            }
        }
        assert!(read > 100 && refused > 100, "{read} read, {refused} refused");
    }

    #[test]
    fn the_fast_arctangent() {
        for [x, y, z] in sphere(10_000) {
            assert_near(atan2(y, x), y.atan2(x), 2e-9);
            assert_near(atan2(z, 1e-8 * x), z.atan2(1e-8 * x), 2e-9);
        }
        assert_eq!(
            [atan2(0.0, 1.0), atan2(1.0, 0.0), atan2(0.0, -1.0), atan2(-1.0, 0.0)],
            [0.0, FRAC_PI_2, PI, -FRAC_PI_2]
        );
        assert_eq!(atan2(0.0, 0.0), 0.0);
    }
}

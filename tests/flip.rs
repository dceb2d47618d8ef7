//! FLIP against NVIDIA's own evaluator, against the paper's formulas where they are short, and in `compare`.

use relume::image::compare::{Pictures, Settings, flip_map};
use relume::image::png::srgb8_from_linear;

/// Edge filters leave 1e-8 of rounding where there is no edge; FLIP takes its root, and that as an exponent.
const ROUNDING: f64 = 1e-4;

fn mean(map: &[f32]) -> f64 {
    map.iter().map(|&error| f64::from(error)).sum::<f64>() / map.len() as f64
}

fn flat(color: [u8; 3]) -> Vec<[u8; 3]> {
    vec![color; 32 * 32]
}

fn assert_close(got: f64, want: f64, tolerance: f64, what: impl std::fmt::Debug) {
    assert!((got - want).abs() <= tolerance, "{what:?}: got {got}, want {want} within {tolerance}");
}

/// FLIP of two flat colours, which its filters leave alone [Andersson 2020, Sections 4.1.2 to 4.1.4].
fn of_flat_colors(reference: [u8; 3], test: [u8; 3]) -> f64 {
    let [p, q] = [reference, test].map(hunt_adjusted_lab);
    let hyab = |p: [f64; 3], q: [f64; 3]| (p[0] - q[0]).abs() + (p[1] - q[1]).hypot(p[2] - q[2]);
    let most = hyab(hunt_adjusted_lab([0, 255, 0]), hunt_adjusted_lab([0, 0, 255])).powf(0.7);
    let (difference, knee) = (hyab(p, q).powf(0.7), 0.4 * most);
    if difference < knee { 0.95 / knee * difference } else { 0.95 + (difference - knee) / (most - knee) * 0.05 }
}

fn hunt_adjusted_lab(color: [u8; 3]) -> [f64; 3] {
    let xyz = |rgb: [f64; 3]| {
        // sRGB's primaries and white [IEC 61966-2-1].
        let rows =
            [[0.4124564, 0.3575761, 0.1804375], [0.2126729, 0.7151522, 0.0721750], [0.0193339, 0.1191920, 0.9503041]];
        rows.map(|row: [f64; 3]| row.iter().zip(rgb).map(|(m, x)| m * x).sum::<f64>())
    };
    let linear = color.map(|value| {
        let value = f64::from(value) / 255.0;
        if value <= 0.04045 { value / 12.92 } else { ((value + 0.055) / 1.055).powf(2.4) }
    });
    let (color, white) = (xyz(linear), xyz([1.0; 3]));
    let [x, y, z]: [f64; 3] = std::array::from_fn(|c| {
        let t: f64 = color[c] / white[c];
        if t > (6.0f64 / 29.0).powi(3) { t.cbrt() } else { t / (3.0 * (6.0f64 / 29.0).powi(2)) + 4.0 / 29.0 }
    });
    let lightness = 116.0 * y - 16.0;
    [lightness, 0.01 * lightness * 500.0 * (x - y), 0.01 * lightness * 200.0 * (y - z)]
}

#[test]
fn equal_pictures_have_no_error() {
    let rings = rings(0, 0);
    assert!(flip_map(RINGS.0, &rings, &rings).iter().all(|&error| error == 0.0));
}

/// The errors of NVIDIA's flip-evaluator 1.7, and of the formulas.
#[test]
fn flat_colors() {
    let (black, white) = ([0; 3], [255; 3]);
    for (reference, test, published) in [
        (black, white, 0.967388),
        (white, black, 0.967388),
        ([0, 255, 0], [0, 0, 255], 1.0),
        ([255, 0, 0], [0, 255, 255], 0.979911),
        ([200, 30, 40], [180, 60, 20], 0.258101),
        ([128; 3], [130; 3], 0.048492),
        ([128; 3], [128; 3], 0.0),
    ] {
        let map = flip_map(32, &flat(reference), &flat(test));
        for &error in &map {
            assert_close(error.into(), published, ROUNDING, (reference, test));
        }
        assert_close(of_flat_colors(reference, test), published, ROUNDING, (reference, test, "by formula"));
    }
}

/// Width and height; more than two strips of those that FLIP is computed in.
const RINGS: (usize, usize) = (96, 300);

fn rings(shift: i32, tint: i32) -> Vec<[u8; 3]> {
    let pixel = |index: usize| {
        let (x, y) = ((index % RINGS.0) as i32, (index / RINGS.0) as i32);
        let ring = ((x + shift - 40).pow(2) + (y - 150).pow(2)) / 400 % 2 * 120;
        [(ring + x) as u8, (ring + y / 2 + tint) as u8, (x * y / 64) as u8]
    };
    (0..RINGS.0 * RINGS.1).map(pixel).collect()
}

/// Edges, points and contrast that the filters see, against the same evaluator.
#[test]
fn rings_that_moved() {
    let map = flip_map(RINGS.0, &rings(0, 0), &rings(2, 9));
    let points = [(40, 150, 0.190_394_2), (0, 0, 0.693_825_7), (95, 299, 0.241_080_4), (50, 128, 0.340_923_3)];
    assert_close(mean(&map), 0.397_219_2, ROUNDING, "mean");
    for (x, y, published) in points {
        assert_close(map[y * RINGS.0 + x].into(), published, ROUNDING, (x, y));
    }
}

#[test]
fn strips_are_the_whole() {
    let (reference, test) = (rings(0, 0), rings(2, 9));
    let picture =
        |pixels: &[[u8; 3]]| nv_flip::FlipImageRgb8::with_data(RINGS.0 as u32, RINGS.1 as u32, pixels.as_flattened());
    let whole = nv_flip::flip(picture(&reference), picture(&test), 67.0).to_vec();
    assert_eq!(flip_map(RINGS.0, &reference, &test), whole);
    let one_row = flip_map(RINGS.0, &reference[..RINGS.0], &test[..RINGS.0]);
    assert!(one_row.len() == RINGS.0 && one_row.iter().all(|error| (0.0..=1.0).contains(error)));
}

/// Flat pictures of one value each.
fn flat_pictures(image: f32, reference: f32, second: Option<f32>) -> Pictures {
    let pixels = |value| vec![[value; 3]; 40 * 30];
    Pictures {
        width: 40,
        height: 30,
        image: pixels(image),
        reference: pixels(reference),
        second: second.map(pixels),
        mask: None,
    }
}

/// The contract: 0.5 / mean(reference), ACES fit [Narkowicz 2015], sRGB.
fn displayed(value: f64, mean_reference: f64) -> [u8; 3] {
    let x = 0.5 / mean_reference * value;
    [srgb8_from_linear(((x * (2.51 * x + 0.03)) / (x * (2.43 * x + 0.59) + 0.14)) as f32); 3]
}

#[test]
fn pictures_are_exposed_by_the_mean_reference() {
    let figures = flat_pictures(0.3, 0.2, Some(0.4)).figures(Settings::default());
    assert_close(figures.flip_mean.unwrap(), 0.0, 0.0, "the image is the references' mean");
    let want = of_flat_colors(displayed(0.2, 0.3), displayed(0.4, 0.3));
    assert_close(figures.flip_floor.unwrap(), want, ROUNDING, "floor");

    let figures = flat_pictures(5e4, 2e4, None).figures(Settings::default());
    let want = of_flat_colors(displayed(2e4, 2e4), displayed(5e4, 2e4));
    assert_close(figures.flip_mean.unwrap(), want, ROUNDING, "mean");
    assert_eq!(figures.flip_floor, None);
    assert!(displayed(5e4, 2e4) < [255; 3], "the test sees nothing where all is white");

    for reference in [0.0, -1.0] {
        let dark = flat_pictures(1.0, reference, Some(reference)).figures(Settings::default());
        assert_eq!((dark.flip_mean, dark.flip_floor), (None, None), "mean reference {reference}");
    }
    let extreme = flat_pictures(f32::MAX, f32::MIN_POSITIVE, Some(f32::MAX)).figures(Settings::default());
    assert!(extreme.flip_mean.is_some_and(f64::is_finite) && extreme.flip_floor.is_some_and(f64::is_finite));
}

#[test]
fn what_the_mask_leaves_out_changes_nothing() {
    let mut pictures = flat_pictures(0.5, 0.5, None);
    let ramp = |index: usize| [0.1 + (index % 40) as f32 / 40.0; 3];
    pictures.reference = (0..40 * 30).map(ramp).collect();
    pictures.image = pictures.reference.iter().map(|pixel| pixel.map(|value| value * 1.1)).collect();
    pictures.mask = Some((0..40 * 30).map(|index| index % 40 < 20).collect());
    let clean = pictures.figures(Settings::default()).flip_mean.unwrap();
    assert!(clean > 0.0);
    for wrong in [0.0, 100.0, f32::NAN, f32::INFINITY] {
        let right_half = (0..40 * 30).filter(|index| index % 40 >= 20);
        right_half.for_each(|index| pictures.image[index] = [wrong; 3]);
        assert_eq!(pictures.figures(Settings::default()).flip_mean, Some(clean), "{wrong} beside the mask");
    }
    pictures.mask = None;
    let unmasked = pictures.figures(Settings::default());
    assert_eq!(unmasked.non_finite, 600);
    assert_close(unmasked.flip_mean.unwrap(), clean, 0.0, "non-finite pixels are left out like masked ones");
}

#[test]
fn blocks_are_what_flip_sees() {
    let mut pictures = flat_pictures(0.5, 0.5, None);
    let sign = |index: usize| if (index % 40 + index / 40).is_multiple_of(2) { 0.25 } else { -0.25 };
    pictures.image = (0..40 * 30).map(|index| [0.5 + sign(index); 3]).collect();
    let flip = |block: usize| pictures.figures(Settings { block, trim: 0.0 }).flip_mean.unwrap();
    assert!(flip(1) > 0.01);
    assert_eq!(flip(2), 0.0);
}

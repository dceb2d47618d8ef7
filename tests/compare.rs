//! Error figures against closed forms.

use std::path::{Path, PathBuf};

use relume::image::compare::{Figures, Pictures, Settings};
use relume::image::{Image, exr, png};

/// Differences of f64 sums over some thousand pixels of f32 input; the tests' numbers are exact in f32.
const ROUNDING: f64 = 1e-12;

fn pictures(width: usize, height: usize, pixel: impl Fn(usize) -> ([f32; 3], [f32; 3])) -> Pictures {
    let (image, reference) = (0..width * height).map(pixel).unzip();
    Pictures { width, height, image, reference, second: None, mask: None }
}

fn with_block(block: usize) -> Settings {
    Settings { block, ..Settings::default() }
}

fn with_trim(trim: f64) -> Settings {
    Settings { trim, ..Settings::default() }
}

fn assert_close(got: Option<f64>, want: f64, tolerance: f64) {
    let got = got.expect("a figure");
    assert!((got - want).abs() <= tolerance, "got {got}, want {want} within {tolerance}");
}

/// Uniform in [-1, 1) and repeatable: splitmix64.
fn noise(seed: u64) -> impl FnMut() -> f32 {
    let mut state = seed;
    move || {
        state = state.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut bits = (state ^ (state >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        bits = (bits ^ (bits >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((bits ^ (bits >> 31)) >> 40) as f32 / (1 << 23) as f32 - 1.0
    }
}

#[test]
fn constant_offset() {
    let figures = pictures(7, 5, |_| ([2.5; 3], [2.0; 3])).figures(Settings::default());
    assert_close(figures.rel_rmse, 0.25, ROUNDING);
    assert_close(figures.rmse, 0.5, ROUNDING);
    assert_close(figures.bias, 0.25, ROUNDING);
    assert_close(figures.rel_mse, 0.25 / (4.0 + 0.01 * 4.0), ROUNDING);
    assert_close(figures.max_abs, 0.5, ROUNDING);
    assert_close(figures.trimmed, 0.25, ROUNDING);
    assert_eq!((figures.width, figures.height, figures.non_finite, figures.noise_free), (7, 5, 0, false));
}

#[test]
fn channels_count_alike() {
    let figures = pictures(1, 1, |_| ([1.0, 2.0, 5.0], [1.0, 2.0, 2.0])).figures(Settings::default());
    assert_close(figures.rel_rmse, 1.0, ROUNDING); // |(0, 0, 3)| / |(1, 2, 2)|
    assert_close(figures.bias, 0.6, ROUNDING); // 3 / 5
    let small = 0.01 * (5.0f64 / 3.0).powi(2);
    assert_close(figures.rel_mse, 9.0 / (4.0 + small) / 3.0, ROUNDING);
    assert_close(figures.max_abs, 3.0, ROUNDING);
}

#[test]
fn a_picture_equals_itself() {
    let figures = pictures(4, 4, |i| ([i as f32; 3], [i as f32; 3])).figures(with_trim(0.1));
    for figure in [figures.rel_rmse, figures.rmse, figures.rel_mse, figures.bias, figures.trimmed, figures.max_abs] {
        assert_eq!(figure, Some(0.0));
    }
}

#[test]
fn zero_reference_gives_null() {
    let figures = pictures(3, 3, |_| ([1.0; 3], [0.0; 3])).figures(Settings::default());
    let relative = [figures.rel_rmse, figures.rel_mse, figures.bias, figures.trimmed];
    assert_eq!(relative, [None; 4]);
    assert_close(figures.rmse, 1.0, ROUNDING);
    let json = serde_json::to_value(&figures).unwrap();
    assert!(json["rel_rmse"].is_null() && json["flip_mean"].is_null() && json["flip_floor"].is_null());
}

#[test]
fn two_references_free_the_error_of_their_noise() {
    let (width, height) = (256, 256);
    let (mut noise_a, mut noise_b) = (noise(1), noise(2));
    let mut reference = || [2.0 + noise_a(), 2.0 + noise_a(), 2.0 + noise_a()];
    let mut second = || [2.0 + noise_b(), 2.0 + noise_b(), 2.0 + noise_b()];
    let mut both = pictures(width, height, |_| ([2.25; 3], [0.0; 3]));
    both.reference = (0..width * height).map(|_| reference()).collect();
    both.second = Some((0..width * height).map(|_| second()).collect());
    let one = Pictures { second: None, ..both.clone() }.figures(Settings::default());
    let both = both.figures(Settings::default());

    // Noise uniform in [-1, 1): variance 1/3. One reference: sqrt((0.25² + 1/3) / (2² + 1/3)).
    assert_close(one.rel_rmse, ((0.0625f64 + 1.0 / 3.0) / (4.0 + 1.0 / 3.0)).sqrt(), 2e-3);
    assert!(!one.noise_free && both.noise_free);
    // Standard error of mean((x - a)(x - b)) over 196608 values: its square's deviation
    // sqrt(2 * 0.0625/3 + 1/9) = 0.39 / sqrt(196608) = 9e-4; on the root 9e-4 / (2 * 0.25) / 2 = 9e-4; four of them.
    assert_close(both.rel_rmse, 0.125, 3.6e-3);
    assert_close(both.rmse, 0.25, 7.2e-3);
    assert_close(both.bias, 0.125, 2e-3);
}

#[test]
fn negative_squared_error_becomes_zero() {
    // x lies between a and b everywhere.
    let mut between = pictures(2, 2, |_| ([2.0; 3], [1.0; 3]));
    between.second = Some(vec![[3.0; 3]; 4]);
    let figures = between.figures(Settings::default());
    assert_eq!((figures.rel_rmse, figures.rmse, figures.rel_mse), (Some(0.0), Some(0.0), Some(0.0)));
    assert_eq!((figures.bias, figures.max_abs), (Some(0.0), Some(0.0)));
}

#[test]
fn trimming_takes_the_worst_pixels_out_of_both_sums() {
    // Of 100 pixels one is off by 10 in one channel, one by 4 in each, the rest by 1 in each; references differ.
    let pixels = pictures(10, 10, |i| match i {
        37 => ([11.0, 1.0, 1.0], [1.0; 3]),
        62 => ([7.0; 3], [3.0; 3]),
        _ => ([3.0; 3], [2.0; 3]),
    });
    let rest: f64 = 3.0 * 98.0;
    let squares = 4.0 * rest;
    let full = ((rest + 100.0 + 48.0) / (squares + 3.0 + 27.0)).sqrt();
    assert_close(pixels.figures(with_trim(0.0)).trimmed, full, ROUNDING);
    assert_close(pixels.figures(with_trim(0.01)).trimmed, ((rest + 48.0) / (squares + 27.0)).sqrt(), ROUNDING);
    let both_gone = pixels.figures(with_trim(0.02));
    assert_close(both_gone.trimmed, 0.5, ROUNDING);
    assert_close(both_gone.rel_rmse, full, ROUNDING);
    // 0.4 % of 100 pixels rounds to none, 0.5 % to one.
    assert_close(pixels.figures(with_trim(0.004)).trimmed, full, ROUNDING);
    assert_close(pixels.figures(with_trim(0.005)).trimmed, ((rest + 48.0) / (squares + 27.0)).sqrt(), ROUNDING);
}

#[test]
fn blocks_average_before_they_compare() {
    // A checkerboard of +1 and -1 vanishes in 2x2 means.
    let sign = |i: usize| if (i % 6 + i / 6).is_multiple_of(2) { 1.0 } else { -1.0 };
    let checkers = pictures(6, 4, |i| ([2.0 + sign(i); 3], [2.0; 3]));
    assert_close(checkers.figures(with_block(1)).rel_rmse, 0.5, ROUNDING);
    assert_close(checkers.figures(with_block(2)).rel_rmse, 0.0, ROUNDING);
    assert_eq!(checkers.figures(with_block(2)).width, 6);
}

#[test]
fn ragged_blocks_are_means_of_what_they_hold() {
    // 3x1 in blocks of 2: means (1 + 3) / 2 and 5 against 1 and 1.
    let ragged = pictures(3, 1, |i| ([[1.0; 3], [3.0; 3], [5.0; 3]][i], [1.0; 3]));
    let figures = ragged.figures(with_block(2));
    assert_close(figures.rmse, ((1.0f64 + 16.0) / 2.0).sqrt(), ROUNDING);
    assert_close(figures.bias, 2.5, ROUNDING);
    assert_close(ragged.figures(with_block(100)).rmse, 2.0, ROUNDING);
    assert_close(ragged.figures(with_block(usize::MAX)).rmse, 2.0, ROUNDING);
}

#[test]
fn mask_counts_only_white() {
    let mut masked = pictures(4, 1, |i| ([if i < 2 { 3.0 } else { f32::NAN }; 3], [2.0; 3]));
    masked.mask = Some(vec![true, true, false, false]);
    let figures = masked.figures(Settings::default());
    assert_close(figures.rel_rmse, 0.5, ROUNDING);
    assert_eq!(figures.non_finite, 0);
    assert_eq!(masked.difference_map(1, 1.0)[2..], [[0; 3]; 2]);

    masked.mask = Some(vec![false; 4]);
    let nothing = masked.figures(with_trim(0.5));
    assert_eq!((nothing.rel_rmse, nothing.rmse, nothing.trimmed, nothing.max_abs), (None, None, None, None));
}

#[test]
fn non_finite_pixels_are_counted_and_left_out() {
    let mut broken = pictures(4, 2, |_| ([3.0; 3], [2.0; 3]));
    broken.image[1] = [f32::NAN, 3.0, 3.0];
    broken.image[5] = [f32::INFINITY, f32::NEG_INFINITY, f32::NAN];
    broken.reference[7] = [f32::NAN; 3];
    for block in [1, 2, 3] {
        let figures = broken.figures(with_block(block));
        assert_eq!((figures.non_finite, figures.reference_non_finite), (2, 1));
        assert_close(figures.rel_rmse, 0.5, ROUNDING);
        assert_close(figures.max_abs, 1.0, ROUNDING);
    }
    assert_eq!(broken.difference_map(1, 1.0)[1], [255, 0, 255]);
}

#[test]
fn sums_are_double() {
    // A million such values pass the 24 bits of f32 after the first.
    let figures = pictures(1000, 1000, |_| ([16_777_216.0; 3], [16_777_215.0; 3])).figures(Settings::default());
    assert_close(figures.rmse, 1.0, 1e-9);
    assert_close(figures.bias, 1.0 / 16_777_215.0, 1e-15);
}

#[test]
fn difference_map_is_linear_difference_times_scale_as_srgb() {
    let mut map = pictures(1, 1, |_| ([0.25, 1.0, 0.0], [0.5, 1.0, 9.0]));
    assert_eq!(map.difference_map(1, 2.0), [[png::srgb8_from_linear(0.5), 0, 255]]);
    assert_eq!(png::srgb8_from_linear(0.5), 188); // 1.055 * 0.5^(1/2.4) - 0.055 = 0.7354
    map.second = Some(vec![[0.0, 1.0, -9.0]]);
    assert_eq!(map.difference_map(1, 2.0), [[0, 0, 0]]);
}

#[test]
fn maps_show_block_means() {
    // A checkerboard of +1 and -1 vanishes in 2x2 means; what is not finite is left out of its block and shown itself.
    let sign = |i: usize| if (i % 6 + i / 6).is_multiple_of(2) { 1.0 } else { -1.0 };
    let mut checkers = pictures(6, 4, |i| ([2.0 + sign(i); 3], [2.0; 3]));
    assert_eq!(checkers.difference_map(1, 0.5), vec![[188; 3]; 24]);
    assert_eq!(checkers.difference_map(2, 0.5), vec![[0; 3]; 24]);
    checkers.image[0] = [f32::NAN; 3];
    let map = checkers.difference_map(2, 0.5);
    let third = png::srgb8_from_linear(0.5 / 3.0); // |(-1 - 1 + 1) / 3| * 0.5
    assert_eq!((map[0], map[1], map[6], map[7]), ([255, 0, 255], [third; 3], [third; 3], [third; 3]));
    assert_eq!(map[2], [0; 3]);
}

/// First, middle and last colour of matplotlib's table.
const MAGMA: [[u8; 4]; 3] = [[0, 0, 4, 255], [183, 55, 121, 255], [252, 253, 191, 255]];

#[test]
fn false_colors_span_three_decades() {
    // Mean differences of 0, 5e-4, 5e-4 * 10^1.5 (by channel 0, 1 and 2 times that), 0.5 and 7; then the mask, a NaN.
    let middle = 5e-4 * 31.622_776;
    let differences = [[0.0; 3], [-5e-4; 3], [0.0, middle, 2.0 * middle], [0.5; 3], [-7.0; 3], [9.0; 3], [f32::NAN; 3]];
    let mut pictures = pictures(400, 3, |i| (differences[i % 7].map(|d| 1.0 + d), [1.0; 3]));
    pictures.mask = Some((0..1200).map(|i| i % 7 != 5).collect());
    let map = pictures.false_color(1, 2.0);
    assert!(map.width == 400 && map.height > 3 + 40);
    let [darkest, between, brightest] = MAGMA;
    assert_eq!(map.rgba[..2], [darkest; 2]);
    let off = map.rgba[2].iter().zip(between).map(|(&got, want)| got.abs_diff(want)).max();
    assert!(off <= Some(2), "{:?}, not the middle {between:?}", map.rgba[2]);
    assert_eq!(map.rgba[3..7], [brightest, brightest, [56, 56, 56, 255], [0, 255, 255, 255]]);

    // The legend: a bar from the darkest to the brightest, and white writing under it.
    let legend = &map.rgba[3 * 400..];
    let bar = legend.chunks(400).find(|row| row.contains(&brightest)).expect("a bar");
    let colors: Vec<_> = bar.iter().filter(|&&color| color != [56, 56, 56, 255]).collect();
    assert_eq!((colors[0], colors[colors.len() - 1]), (&darkest, &brightest));
    assert!(legend.iter().filter(|&&color| color == [255; 4]).count() > 500, "no writing");
}

#[test]
fn false_colors_of_any_size_and_reference() {
    let rows = |map: &png::Pixels, height: usize| map.height - height;
    let narrow = pictures(5, 4, |_| ([1.0; 3], [0.5; 3])).false_color(1, 2.0);
    assert_eq!(narrow.rgba.len(), narrow.width * narrow.height);
    assert!(narrow.width > 300 && narrow.rgba[5] == [56, 56, 56, 255], "a narrow picture is widened");
    let wide = pictures(1999, 4, |_| ([1.0; 3], [0.5; 3])).false_color(1, 2.0);
    assert_eq!((wide.width, rows(&wide, 4)), (1999, 3 * rows(&narrow, 4)));
    // Without a mean there is no line of percentages.
    let black = pictures(5, 4, |_| ([1.0; 3], [0.0; 3])).false_color(1, 2.0);
    assert!(rows(&black, 4) < rows(&narrow, 4));
    for scale in [1e-30, 1e30] {
        let extreme = pictures(5, 4, |_| ([f32::MAX; 3], [f32::MIN_POSITIVE; 3])).false_color(3, scale);
        assert_eq!(extreme.height, narrow.height);
    }
    let nothing = pictures(5, 4, |_| ([f32::NAN; 3], [f32::INFINITY; 3]));
    let map = nothing.false_color(2, 1.0);
    assert_eq!(
        (map.rgba[0], rows(&map, 4)),
        ([0, 255, 255, 255], rows(&narrow, 4)),
        "cyan is told, percentages are not"
    );
    let figures = nothing.figures(with_block(2));
    assert_eq!((figures.non_finite, figures.rel_rmse, figures.flip_mean, figures.bias), (20, None, None, None));
}

struct Files(tempfile::TempDir);

impl Files {
    fn new() -> Self {
        Self(tempfile::tempdir().unwrap())
    }

    fn exr(&self, name: &str, image: &Image) -> PathBuf {
        let path = self.0.path().join(name);
        exr::write(&path, image).unwrap();
        path
    }
}

fn flat(width: usize, height: usize, value: f32) -> Image {
    Image::single(width, height, vec![[value; 3]; width * height])
}

fn read(image: &Path, reference: &Path, layer: &str) -> relume::Result<Figures> {
    Ok(Pictures::read(image, reference, None, layer, None)?.figures(Settings::default()))
}

#[test]
fn layers_and_masks_are_read_from_files() {
    let files = Files::new();
    let x = files.exr("x.exr", &flat(3, 2, 4.0).with_layer("direct", vec![[3.0; 3]; 6]));
    let r = files.exr("r.exr", &flat(3, 2, 2.0));
    let named = files.exr("named.exr", &flat(3, 2, 2.0).with_layer("direct", vec![[6.0; 3]; 6]));
    assert_close(read(&x, &r, "").unwrap().rel_rmse, 1.0, ROUNDING);
    assert_close(read(&x, &r, "beauty").unwrap().rel_rmse, 1.0, ROUNDING);
    assert_close(read(&x, &r, "direct").unwrap().rel_rmse, 0.5, ROUNDING);
    assert_close(read(&x, &named, "direct").unwrap().rel_rmse, 0.5, ROUNDING);

    let mask = files.0.path().join("mask.png");
    let white_left = [[255; 3], [0; 3], [0; 3]].repeat(2);
    png::write(&mask, 3, 2, &white_left).unwrap();
    let pictures = Pictures::read(&x, &r, Some(&r), "", Some(&mask)).unwrap();
    assert_eq!(pictures.mask, Some([true, false, false].repeat(2)));
    assert!(pictures.figures(Settings::default()).noise_free);
}

#[test]
fn what_does_not_fit_is_an_error_that_names_the_files() {
    let files = Files::new();
    let x = files.exr("x.exr", &flat(3, 2, 1.0));
    let wide = files.exr("wide.exr", &flat(4, 2, 1.0));
    let named =
        files.exr("named.exr", &Image { width: 3, height: 2, ..Image::default() }.with_layer("a", vec![[1.0; 3]; 6]));
    let assert_says = |outcome: relume::Result<Pictures>, words: &[&str]| {
        let error = outcome.unwrap_err().to_string();
        assert!(words.iter().all(|word| error.contains(word)), "{error} lacks one of {words:?}");
    };
    assert_says(Pictures::read(&x, &wide, None, "", None), &["x.exr", "wide.exr", "3x2", "4x2"]);
    assert_says(Pictures::read(&x, &x, Some(&wide), "", None), &["x.exr", "wide.exr"]);
    assert_says(Pictures::read(&x, &x, None, "direct", None), &["x.exr", "`direct`", "(unnamed)"]);
    assert_says(Pictures::read(&named, &named, None, "", None), &["named.exr", "(unnamed)", "`a`"]);
    assert_says(Pictures::read(&x, &named, None, "", None), &["named.exr", "(unnamed)"]);
    let mask = files.0.path().join("mask.png");
    png::write(&mask, 1, 1, &[[255; 3]]).unwrap();
    assert_says(Pictures::read(&x, &x, None, "", Some(&mask)), &["mask.png", "x.exr", "1x1"]);
    assert_says(Pictures::read(&x, &files.0.path().join("none.exr"), None, "", None), &["none.exr"]);
}

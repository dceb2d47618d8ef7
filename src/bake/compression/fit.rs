//! One supercluster: from the sparse rows of its pixels to V, B and U.

use std::ops::Range;

use faer::{Mat, MatRef};
use half::f16;

use super::bounces::Thinned;
use super::data::MULTIPLE;
use super::haar::Haar;
use super::linear::{self, Lu};
use super::panels::{self, Panels, WIDTH};
use crate::bake::transfer::rows::Rows;

/// What all superclusters are made of.
pub struct Inputs {
    pub bounces: Thinned,
    pub haar: Haar,
    /// What Φ multiplies: random combinations of the lights to learn from.
    pub combinations: Panels,
    /// What Φ multiplies: the lights to check with.
    pub checked: Panels,
    /// Haar terms of the lights to learn from, the mean square of whose images is 1.
    pub learned: Panels,
    /// Sum of the squares of each term over the lights to learn from, by channel.
    pub power: [Vec<f32>; 3],
    /// Haar terms of the lights to check with.
    pub checks: Panels,
    /// Those of the lights to check with that decide how many directions are kept.
    pub deciding: Range<usize>,
}

/// Squared errors that the three steps may make, in shares of the whole image's square.
#[derive(Clone, Copy, Debug)]
pub struct Budget {
    /// For directions of the supercluster left out, noise included.
    pub rank: f64,
    /// For terms of light left out.
    pub terms: f64,
    /// For directions of tiles left out.
    pub tiles: f64,
}

/// A supercluster before it is fitted.
pub struct Projected<'a> {
    inputs: &'a Inputs,
    /// Orthonormal, pixels x directions.
    basis: Mat<f32>,
    /// Haar terms x directions, by channel: the basis' transpose times T.
    pub terms: Panels,
    /// Squared error beyond noise that the supercluster may have.
    pub allowed: f64,
    /// Images of the lights to check with: pixels x lights.
    pub checks: Panels,
    /// How much each of the deciding lights counts: less where its image is noisier than most.
    pub weights: Vec<f64>,
    /// Square of the noise of these images, by these weights.
    pub noise: f64,
    /// The same, mean over the deciding lights.
    pub plain_noise: f64,
}

/// Some of the rows, gathered with other random numbers: they tell how noisy all are.
pub struct Anew<'a> {
    pub rows: &'a Rows,
    /// Which pixels of the supercluster they are.
    pub pixels: &'a [usize],
}

/// Factors of one supercluster; V as it is multiplied with terms, B after V, U after B.
pub struct Factors {
    pub list: Vec<u32>,
    pub rank: usize,
    /// By channel, rank x list.
    pub v: [Vec<f16>; 3],
    pub tiles: Vec<TileFactors>,
}

pub struct TileFactors {
    pub rank: usize,
    /// rank x the supercluster's rank.
    pub b: Vec<f16>,
    /// Pixels x rank; not rounded yet, since its scale is that of the whole image.
    pub u: Vec<f32>,
}

impl<'a> Projected<'a> {
    /// From the rows of Φ of the supercluster's pixels. `allowed` gives the squared error beyond noise that they may have,
    /// from the squares of their images and of their noise.
    pub fn new(inputs: &'a Inputs, rows: &Rows, anew: &Anew, allowed: impl Fn(f64, f64) -> f64) -> Self {
        let products = panels::multiply(rows, &inputs.combinations);
        let checks = panels::multiply(rows, &inputs.checked);
        let noise = &noise(anew, &checks, &inputs.checked)[inputs.deciding.clone()];
        let plain_noise = noise.iter().sum::<f64>() / noise.len() as f64;
        let (weights, noise) = weights(noise);
        let (all, energy) = range(&products, rows.len());
        let allowed = allowed(energy, noise);
        let images = checks.channels.each_ref().map(|panels| &panels[0]);
        let basis = needed(&all, &images, &inputs.deciding, &weights, noise + 0.1 * allowed);
        let directions = Panels::from_fn(rows.len(), basis.ncols(), |_, i, j| basis[(i, j)]);
        let columns = inputs.combinations.rows();
        let terms = inputs.bounces.terms(&inputs.haar, panels::multiply_transposed(rows, columns, &directions));
        Self { inputs, basis, terms, allowed, checks, weights, noise, plain_noise }
    }

    pub fn fit(&self, tiles: &[Range<usize>], budget: &Budget) -> Factors {
        let Directions { turn, sizes, deciding } = self.directions(budget.rank);
        let rank = turn.ncols();
        let turned = self.turned(&turn);
        let mut list = self.choose(&turned, budget.terms);
        let width = multiple(list.len());
        let v = [0, 1, 2].map(|c| {
            let fitted = self.fit_terms(c, &turned[c], &list);
            let entry = |r: usize, i: usize| if i < list.len() { fitted[(i, r)] / sizes[r] } else { 0.0 };
            (0..rank).flat_map(|r| (0..width).map(move |i| (r, i))).map(|(r, i)| entry(r, i)).collect::<Vec<f32>>()
        });
        // What pads the list is multiplied by zero.
        list.resize(width, list.last().copied().unwrap_or(0));
        let largest = v.iter().flatten().fold(0.0f32, |max, x| max.max(x.abs()));
        let scale = if largest > 0.0 { (f32::log2(V_LARGEST / largest)).floor().exp2() } else { 1.0 };
        let v = v.map(|v| v.iter().map(|x| f16::from_f32(x * scale)).collect());
        let share = |rows: &Range<usize>| budget.tiles * rows.len() as f64 / self.basis.nrows() as f64;
        let weighted = Mat::from_fn(turn.nrows(), rank, |i, r| turn[(i, r)] * sizes[r]);
        let pixels = linear::product(self.basis.as_ref(), weighted.as_ref());
        let tiles = tiles.iter().map(|rows| tile(&pixels, rows, &deciding, share(rows), scale)).collect();
        Factors { list, rank, v, tiles }
    }

    /// Squared errors and squares of the images of the lights to check with: for each tile, each light.
    pub fn check(&self, factors: &Factors, tiles: &[Range<usize>]) -> Vec<Vec<[f64; 2]>> {
        let mut found = vec![vec![[0.0; 2]; self.checks.count]; tiles.len()];
        for (c, (terms, images)) in self.inputs.checks.channels.iter().zip(&self.checks.channels).enumerate() {
            let v = single(&factors.v[c], factors.rank, factors.list.len());
            for (part, (terms, images)) in terms.iter().zip(images).enumerate() {
                let listed: panels::Panel = factors.list.iter().map(|&j| terms[j as usize]).collect();
                let y = linear::product(v.as_ref(), panels::matrix(&listed));
                for ((rows, tile), found) in tiles.iter().zip(&factors.tiles).zip(&mut found) {
                    let coefficients = linear::product(single(&tile.b, tile.rank, factors.rank).as_ref(), y.as_ref());
                    let u = MatRef::from_row_major_slice(&tile.u, rows.len(), tile.rank);
                    let got = linear::product(u, coefficients.as_ref());
                    let lights = part * WIDTH..self.checks.count.min((part + 1) * WIDTH);
                    for (light, sums) in found[lights].iter_mut().enumerate() {
                        for (i, row) in rows.clone().enumerate() {
                            let want = images[row][light];
                            sums[0] += f64::from(got[(i, light)] - want).powi(2);
                            sums[1] += f64::from(want).powi(2);
                        }
                    }
                }
            }
        }
        found
    }

    /// The directions of the basis that matter, those first that the lights to learn from fill most: as many as leave at
    /// most `budget` of the deciding lights' images.
    fn directions(&self, budget: f64) -> Directions {
        let count = self.basis.ncols();
        let mut gram = Mat::<f64>::zeros(count, count);
        for (terms, learned) in self.terms.channels.iter().zip(&self.inputs.learned.channels) {
            for learned in learned {
                let seen = seen(terms, learned, count);
                gram += linear::product(seen.as_ref(), seen.transpose());
            }
        }
        let (values, vectors) = linear::eigen(&gram);
        let decide = self.inputs.deciding.clone();
        let mut filled = vec![0.0; count];
        let mut columns = Vec::new();
        let mut left = 0.0;
        for (checks, images) in self.inputs.checks.channels.iter().zip(&self.checks.channels) {
            let turned = linear::product(
                vectors.transpose(),
                seen(&self.terms.channels[columns.len()], &checks[0], count).as_ref(),
            );
            let weighted = || decide.clone().zip(&self.weights);
            (0..count)
                .for_each(|i| filled[i] += weighted().map(|(l, weight)| turned[(i, l)].powi(2) * weight).sum::<f64>());
            left += weighted_squares(&images[0], &decide, &self.weights);
            columns.push(turned);
        }
        let rank = multiple(enough(&filled, left, budget));
        // Padded with directions that are zero.
        let turn = Mat::from_fn(count, rank, |i, j| if j < count { vectors[(i, j)] as f32 } else { 0.0 });
        let size = |r: usize| values.get(r).map_or(0.0, |v| v.sqrt() as f32).max(f32::MIN_POSITIVE);
        let sizes: Vec<f32> = (0..rank).map(size).collect();
        let lights = decide.len();
        let deciding = Mat::from_fn(rank, 3 * lights, |i, l| {
            let weight = self.weights[l % lights].sqrt();
            let size = |i: usize| weight / f64::from(sizes[i]);
            if i < count { columns[l / lights][(i, decide.start + l % lights)] * size(i) } else { 0.0 }
        });
        Directions { turn, sizes, deciding }
    }

    /// Terms x directions.
    fn turned(&self, turn: &Mat<f32>) -> Vec<Mat<f32>> {
        let turned = |panels: &Vec<panels::Panel>| {
            let mut all = Mat::<f32>::zeros(self.inputs.learned.rows(), turn.ncols());
            for (i, panel) in panels.iter().enumerate() {
                let part = turn.subrows(i * WIDTH, WIDTH.min(turn.nrows() - i * WIDTH));
                linear::add_product(all.as_mut(), panels::matrix(panel).subcols(0, part.nrows()), part);
            }
            all
        };
        self.terms.channels.iter().map(turned).collect()
    }

    /// What the terms of `list` are multiplied by, terms x directions: their own factors and, by ridge regression over the
    /// lights to learn from, what they tell of the terms left out.
    fn fit_terms(&self, channel: usize, factors: &Mat<f32>, list: &[u32]) -> Mat<f32> {
        let learned = &self.inputs.learned.channels[channel];
        let listed =
            Mat::from_fn(list.len(), learned.len() * WIDTH, |i, l| learned[l / WIDTH][list[i] as usize][l % WIDTH]);
        let mut kept = Mat::from_fn(list.len(), factors.ncols(), |i, r| factors[(list[i] as usize, r)]);
        let mut missing = linear::product(listed.transpose(), kept.as_ref()) * faer::Scale(-1.0);
        for (part, learned) in learned.iter().enumerate() {
            linear::add_product(
                missing.subrows_mut(part * WIDTH, WIDTH),
                panels::matrix(learned).transpose(),
                factors.as_ref(),
            );
        }
        let mut gram = Mat::from_fn(listed.ncols(), listed.ncols(), |_, _| 0.0f32);
        linear::add_product(gram.as_mut(), listed.transpose(), listed.as_ref());
        let mut gram = Mat::from_fn(gram.nrows(), gram.nrows(), |i, j| f64::from(gram[(i, j)]));
        let all: f64 = (0..gram.nrows()).map(|l| gram[(l, l)]).sum();
        if all > 0.0 {
            (0..gram.nrows()).for_each(|l| gram[(l, l)] += RIDGE * all);
            let shares = Lu::new(gram).solve(missing.as_ref(), false);
            let shares = Mat::from_fn(shares.nrows(), shares.ncols(), |l, r| shares[(l, r)] as f32);
            linear::add_product(kept.as_mut(), listed.as_ref(), shares.as_ref());
        }
        kept
    }

    /// The terms that matter most, without which at most `tail` of all squares is lost.
    fn choose(&self, turned: &[Mat<f32>], tail: f64) -> Vec<u32> {
        let count = self.inputs.learned.rows();
        let mut lost = vec![0.0f64; count];
        for (turned, power) in turned.iter().zip(&self.inputs.power) {
            let mut squares = vec![0.0f64; count];
            for column in turned.col_iter() {
                squares.iter_mut().zip(column.iter()).for_each(|(sum, x)| *sum += f64::from(x * x));
            }
            lost.iter_mut().zip(squares).zip(power).for_each(|((lost, s), power)| *lost += s * f64::from(*power));
        }
        let mut order: Vec<u32> = (0..count as u32).collect();
        order.sort_unstable_by(|&a, &b| lost[b as usize].total_cmp(&lost[a as usize]).then(a.cmp(&b)));
        let sorted: Vec<f64> = order.iter().map(|&j| lost[j as usize]).collect();
        order.truncate(multiple(cut(&sorted, tail)));
        order.sort_unstable();
        order
    }
}

/// What keeps the regression from believing few lights too much, as a share of all their squares.
const RIDGE: f64 = 1e-3;

/// What is kept of a basis.
struct Directions {
    /// Directions as combinations of the basis.
    turn: Mat<f32>,
    /// Root mean square that light has along each.
    sizes: Vec<f32>,
    /// The deciding lights in these units, by their weights: directions x lights, channel after channel.
    deciding: Mat<f64>,
}

/// What a panel of lights makes of the first `count` directions, from the terms of both.
fn seen(terms: &[panels::Panel], lights: &panels::Panel, count: usize) -> Mat<f64> {
    let product = |panel: &panels::Panel| linear::product(panels::matrix(panel).transpose(), panels::matrix(lights));
    let parts: Vec<Mat<f32>> = terms.iter().map(product).collect();
    Mat::from_fn(count, WIDTH, |i, l| f64::from(parts[i / WIDTH][(i % WIDTH, l)]))
}

/// A row-major block in single precision.
fn single(block: &[f16], rows: usize, columns: usize) -> Mat<f32> {
    Mat::from_fn(rows, columns, |i, j| block[i * columns + j].to_f32())
}

/// Largest factor of V: far from the largest of half precision, 65,504, and far above the smallest normal one, 6e-5.
const V_LARGEST: f32 = 1024.0;

/// An orthonormal basis of what the images span, the fullest directions first; and the square of all images.
fn range(images: &Panels, rows: usize) -> (Mat<f32>, f64) {
    let all: Vec<&panels::Panel> = images.channels.iter().flatten().collect();
    let count = all.len() * WIDTH;
    let all = Mat::from_fn(rows, count, |i, j| f64::from(all[j / WIDTH][i][j % WIDTH]));
    linear::orthonormal(&all)
}

/// The first directions of a basis, whole panels of them, that leave at most `budget` of the lights' images.
fn needed(
    basis: &Mat<f32>,
    images: &[&panels::Panel; 3],
    lights: &Range<usize>,
    weights: &[f64],
    budget: f64,
) -> Mat<f32> {
    let mut filled = vec![0.0; basis.ncols()];
    let mut left = 0.0;
    for image in images {
        let seen = linear::product(basis.transpose(), panels::matrix(image));
        let square = |i: usize| {
            lights.clone().zip(weights).map(|(l, weight)| f64::from(seen[(i, l)]).powi(2) * weight).sum::<f64>()
        };
        filled.iter_mut().enumerate().for_each(|(i, filled)| *filled += square(i));
        left += weighted_squares(image, lights, weights);
    }
    let count = enough(&filled, left, budget).next_multiple_of(WIDTH).min(MOST_DIRECTIONS);
    let count = count.min(basis.ncols());
    basis.subcols(0, count).to_owned()
}

fn weighted_squares(image: &panels::Panel, lights: &Range<usize>, weights: &[f64]) -> f64 {
    let of_row = |row: &[f32; WIDTH]| -> f64 {
        row[lights.clone()].iter().zip(weights).map(|(x, weight)| f64::from(x * x) * weight).sum()
    };
    image.iter().map(of_row).sum()
}

/// Weights of lights from the squares of their noise, which add up to 1: lights with more noise than half of them count for
/// less, so that few noisy ones don't hide what the others show. Comes with the noise of all by these weights.
fn weights(noise: &[f64]) -> (Vec<f64>, f64) {
    let mut sorted = noise.to_vec();
    sorted.sort_unstable_by(f64::total_cmp);
    let median = sorted[sorted.len() / 2];
    let weight = |noise: &f64| if *noise > median { median / noise } else { 1.0 };
    let all: f64 = noise.iter().map(weight).sum();
    let weights: Vec<f64> = noise.iter().map(|noise| weight(noise) / all).collect();
    let weighted = noise.iter().zip(&weights).map(|(noise, weight)| noise * weight).sum();
    (weights, weighted)
}

/// Directions of a supercluster at most: where so many are not enough, what is left is hardly more than noise.
const MOST_DIRECTIONS: usize = 3 * WIDTH;

/// How many parts of `all` must be taken away until at most `budget` is left.
fn enough(parts: &[f64], mut all: f64, budget: f64) -> usize {
    let taken = parts.iter().take_while(|part| {
        let needed = all > budget;
        all -= **part;
        needed
    });
    taken.count()
}

/// Square of the noise of each of the images `checks` of `lights`.
fn noise(anew: &Anew, checks: &Panels, lights: &Panels) -> Vec<f64> {
    let mut again = panels::multiply(anew.rows, lights);
    for (again, checks) in again.channels.iter_mut().zip(&checks.channels) {
        for (again, checks) in again.iter_mut().zip(checks) {
            for (again, &pixel) in again.iter_mut().zip(anew.pixels) {
                again.iter_mut().zip(&checks[pixel]).for_each(|(again, once)| *again -= once);
            }
        }
    }
    // Both have the same noise.
    let share = anew.pixels.len() as f64 / checks.rows() as f64;
    again.squares().iter().map(|square| 0.5 * square / share).collect()
}

/// Factors of a tile from its pixels' rows: what they make of the directions, each in units of its root mean square.
/// `scale` is what V was multiplied by.
fn tile(pixels: &Mat<f32>, rows: &Range<usize>, deciding: &Mat<f64>, budget: f64, scale: f32) -> TileFactors {
    let rank = pixels.ncols();
    let all = Mat::from_fn(rows.len(), rank, |i, j| f64::from(pixels[(rows.start + i, j)]));
    let (values, vectors) = linear::eigen(&linear::product(all.transpose(), all.as_ref()));
    // What each direction holds of the deciding lights' images.
    let turned = linear::product(vectors.transpose(), deciding.as_ref());
    let square = |r: usize| turned.row(r).iter().map(|x| x * x).sum::<f64>() * values[r];
    let kept = multiple(cut(&(0..rank).map(square).collect::<Vec<_>>(), budget));
    let vectors = vectors.subcols(0, kept);
    let b = (0..kept).flat_map(|r| (0..rank).map(move |j| f16::from_f64(vectors[(j, r)]))).collect();
    let u = linear::product(all.as_ref(), vectors);
    let u = (0..rows.len()).flat_map(|i| (0..kept).map(move |r| (i, r))).map(|(i, r)| u[(i, r)] as f32 / scale);
    TileFactors { rank: kept, b, u: u.collect() }
}

/// How many of the values, largest first, to keep so that the others add up to at most `tail`.
fn cut(values: &[f64], tail: f64) -> usize {
    let mut sum = 0.0;
    let dropped = values.iter().rev().take_while(|value| {
        sum += **value;
        sum <= tail
    });
    values.len() - dropped.count()
}

fn multiple(count: usize) -> usize {
    count.next_multiple_of(MULTIPLE)
}

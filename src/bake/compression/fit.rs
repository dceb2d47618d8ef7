//! One supercluster: from the sparse rows of its pixels to V, B and U.

use std::ops::Range;

use faer::{Mat, MatRef};
use glam::{DVec3, Vec3};
use half::f16;
use serde::{Deserialize, Serialize};

use super::bounces::Thinned;
use super::haar::Haar;
use super::linear::{self, Lu};
use super::noise_estimate::NoiseEstimate;
use super::terms::{self, Chosen, cut, multiple};
use super::vector_batch::{self, Compact, Panel, Transposed, TransposedPart, VectorBatch, WIDTH};
use super::{Found, OUTSIDE};
use crate::bake::csr_matrix::CsrMatrix;
use crate::physics::sequence::Points;

/// What all superclusters are made of.
pub struct Inputs {
    pub bounces: Thinned,
    /// See [`crate::bake::transport::LightTransport::residual`].
    pub residual: Option<f64>,
    pub haar: Haar,
    /// What Φ multiplies: random combinations of the lights to learn from.
    pub combinations: VectorBatch,
    /// What Φ multiplies: the lights to check with.
    pub checked: VectorBatch,
    /// Haar terms of the lights to learn from, the mean square of whose images is 1.
    pub learned: Compact,
    /// Sum of the squares of each term over the lights to learn from, by channel.
    pub power: [Vec<f32>; 3],
    /// Haar terms of the lights to check with.
    pub checks: VectorBatch,
    /// Those of the lights to check with that decide how many directions are kept.
    pub deciding: Range<usize>,
}

/// Squared errors that the three steps may make, in shares of the whole image's square.
#[derive(Clone, Copy, Debug)]
pub struct Budget {
    /// For directions of the supercluster left out.
    pub rank: f64,
    /// For terms of light left out.
    pub terms: f64,
    /// For directions of tiles left out.
    pub tiles: f64,
}

/// A supercluster before it is fitted.
pub struct Projected<'a> {
    inputs: &'a Inputs,
    /// An orthonormal basis of what is kept, those directions first that the lights to learn from fill most: pixels x directions.
    directions: Mat<f64>,
    /// Squares of all lights along each.
    squares: Vec<f64>,
    /// Haar terms that matter, ascending.
    list: Vec<u32>,
    /// Their power, by channel.
    power: [Vec<f32>; 3],
    /// What T's transpose makes of another basis, by channel: terms that matter x vectors.
    terms: VectorBatch,
    /// The directions as combinations of those vectors.
    vectors: Mat<f64>,
    /// What those vectors hold of the lights to learn from: vectors x lights, by channel.
    learned: [Mat<f32>; 3],
    /// What the directions hold of the deciding lights.
    decided: Mat<f64>,
    /// Squared error beyond noise that the supercluster may have.
    pub allowed: f64,
    /// What no fit can mend: square of the light that the basis lacks.
    pub outside: f64,
    /// Images of the lights to check with: pixels x lights.
    pub checks: VectorBatch,
    pub estimate: NoiseEstimate,
    /// What the basis holds of the deciding lights' images.
    held: Mat<f64>,
}

/// Rows of Φ and what they make of lights.
pub struct RowProducts {
    rows: Transposed,
    /// Images of random combinations of the lights to learn from, and of the lights to check with.
    combinations: VectorBatch,
    checks: VectorBatch,
}

impl RowProducts {
    /// Of no rows yet.
    pub fn new(inputs: &Inputs) -> Self {
        Self {
            rows: Transposed { columns: inputs.combinations.rows(), parts: Vec::new() },
            combinations: VectorBatch::zeros(0, inputs.combinations.count),
            checks: VectorBatch::zeros(0, inputs.checked.count),
        }
    }

    /// Adds pixels.
    pub fn push(&mut self, inputs: &Inputs, rows: &CsrMatrix) {
        self.rows.parts.push(TransposedPart::new(rows, self.combinations.rows(), self.rows.columns));
        self.combinations.append(vector_batch::multiply(rows, &inputs.combinations));
        self.checks.append(vector_batch::multiply(rows, &inputs.checked));
    }
}

/// Some of the rows, gathered with other random numbers.
pub struct Resampled<'a> {
    pub rows: &'a CsrMatrix,
    /// Which pixels of the supercluster they are.
    pub pixels: &'a [usize],
}

/// Factors of one supercluster; V as it is multiplied with terms, B after V, U after B.
#[derive(Default, Serialize, Deserialize)]
pub struct Factors {
    pub list: Vec<u32>,
    /// How many of the list, the first ones, have factors for each channel.
    pub own: usize,
    /// One for each of the list, 1 for these.
    pub tints: Vec<Vec3>,
    pub rank: usize,
    /// The blocks of red, green and blue in turn, rank x own terms; then that of all three, rank x others.
    pub v: Vec<f16>,
    pub tiles: Vec<TileFactors>,
}

impl Factors {
    /// V of a channel, tints included: rank x list.
    fn v(&self, channel: usize) -> Mat<f32> {
        let (own, tinted) = (self.own, self.list.len() - self.own);
        let [of_own, of_tinted] = [channel, 3].map(|block| &self.v[block * self.rank * own..]);
        Mat::from_fn(self.rank, self.list.len(), |r, i| match i.checked_sub(own) {
            None => of_own[r * own + i].to_f32(),
            Some(i) => of_tinted[r * tinted + i].to_f32() * self.tints[own + i][channel],
        })
    }
}

#[derive(Serialize, Deserialize)]
pub struct TileFactors {
    pub rank: usize,
    /// rank x the supercluster's rank.
    pub b: Vec<f16>,
    /// Pixels x rank; not rounded yet: packing does.
    pub u: Vec<f32>,
}

impl<'a> Projected<'a> {
    /// From what the supercluster's pixels see. `allowed` gives the squared error beyond noise that they may have, from the squares
    /// of their images and of their noise.
    pub fn new(
        inputs: &'a Inputs,
        seen: RowProducts,
        resampled: &Resampled,
        allowed: impl Fn(f64, f64) -> f64,
    ) -> Self {
        let RowProducts { rows, combinations, checks } = seen;
        let again = vector_batch::multiply(resampled.rows, &inputs.checked);
        let estimate = NoiseEstimate::new(resampled.pixels, &checks, &again, &inputs.deciding);
        let (all, energy) = range(&combinations);
        let allowed = allowed(energy, estimate.weighted_noise);
        let held = linear::product(all.transpose(), estimate.images.as_ref());
        let count = estimate.needed(all.as_ref(), held.as_ref(), OUTSIDE * allowed);
        let count = count.next_multiple_of(WIDTH).min(all.ncols());
        let held = linear::product(all.subcols(0, count), held.subrows(0, count));
        let outside = estimate.outside(&held);
        let basis = all.subcols(0, count);
        let (list, terms) = seen_terms(inputs, &rows, basis, SLIGHT * allowed);
        let power = inputs.power.each_ref().map(|power| list.iter().map(|&term| power[term as usize]).collect());
        let learned = [0, 1, 2].map(|c| {
            let lit = |list: &[u32]| inputs.learned.gathered(c, list.iter().map(|&term| term as usize));
            hold(&terms.channels[c], &list, inputs.learned.width, lit, count)
        });
        let decided = [0, 1, 2].map(|c| {
            let deciding = &inputs.checks.channels[c][..1];
            let lit = |list: &[u32]| vector_batch::gathered(deciding, list.iter().map(|&term| term as usize));
            hold(&terms.channels[c], &list, WIDTH, lit, count)
        });
        let decided = estimate.deciding(count, |c, direction, light| decided[c][(direction, light)].into());
        let mut gram = Mat::<f64>::zeros(count, count);
        for learned in &learned {
            let learned = Mat::from_fn(count, learned.ncols(), |i, l| f64::from(learned[(i, l)]));
            gram += linear::product(learned.as_ref(), learned.transpose());
        }
        let (squares, vectors) = linear::eigen(&gram);
        let decided = linear::product(vectors.transpose(), decided.as_ref());
        let directions = linear::product(basis, vectors.as_ref());
        Self {
            inputs,
            directions,
            squares,
            list,
            power,
            terms,
            vectors,
            learned,
            decided,
            allowed,
            outside,
            checks,
            estimate,
            held,
        }
    }

    /// Factors of the supercluster and its `tiles`, ranges of its pixels.
    pub fn fit(&self, tiles: &[Range<usize>], budget: &Budget) -> Factors {
        let Directions { turn, sizes, deciding } = self.directions(budget.rank);
        let rank = turn.ncols();
        let turned = self.turned(&turn);
        let chosen = terms::choose(&turned, &self.power, budget.terms);
        if chosen.own.is_empty() && chosen.tinted.is_empty() {
            // Nothing would fill the directions.
            let none = |_| TileFactors { rank: 0, b: Vec::new(), u: Vec::new() };
            return Factors { tiles: tiles.iter().map(none).collect(), ..Default::default() };
        }
        let (list, tints, v) = self.fit_v(&turn, turned, &chosen, &sizes);
        let largest = v.iter().fold(0.0f32, |max, x| max.max(x.abs()));
        let scale = if largest > 0.0 { (f32::log2(V_LARGEST / largest)).floor().exp2() } else { 1.0 };
        let v = v.iter().map(|x| f16::from_f32(x * scale)).collect();
        let share = |rows: &Range<usize>| budget.tiles * rows.len() as f64 / self.directions.nrows() as f64;
        let pixel = |i: usize, r: usize| if sizes[r] > 0.0 { self.directions[(i, r)] as f32 * sizes[r] } else { 0.0 };
        let pixels = Mat::from_fn(self.directions.nrows(), rank, pixel);
        let tiles = tiles.iter().map(|rows| tile(&pixels, rows, &deciding, share(rows), scale)).collect();
        Factors { list, own: multiple(chosen.own.len()), tints, rank, v, tiles }
    }

    /// Squared errors against the rows and squares of the images of the lights to check with: for each tile, each light.
    /// Comes with the squares of the light that the factors lose of what the basis holds, and of the noise left out.
    pub fn check(&self, factors: &Factors, tiles: &[Range<usize>]) -> (Found, (f64, f64)) {
        let mut found = vec![vec![[0.0; 2]; self.checks.count]; tiles.len()];
        let mut seen = [0; 3].map(|_| Mat::zeros(self.checks.rows(), WIDTH));
        for (c, (terms, images)) in self.inputs.checks.channels.iter().zip(&self.checks.channels).enumerate() {
            let v = factors.v(c);
            for (part, (terms, images)) in terms.iter().zip(images).enumerate() {
                let listed: Panel = factors.list.iter().map(|&j| terms[j as usize]).collect();
                let y = linear::product(v.as_ref(), vector_batch::matrix(&listed));
                for ((rows, tile), found) in tiles.iter().zip(&factors.tiles).zip(&mut found) {
                    let coefficients = linear::product(single(&tile.b, tile.rank, factors.rank).as_ref(), y.as_ref());
                    let u = MatRef::from_row_major_slice(&tile.u, rows.len(), tile.rank);
                    let got = linear::product(u, coefficients.as_ref());
                    let lights = part * WIDTH..self.checks.count.min((part + 1) * WIDTH);
                    for (light, sums) in found[lights].iter_mut().enumerate() {
                        if part == 0 {
                            rows.clone().enumerate().for_each(|(i, row)| seen[c][(row, light)] = got[(i, light)]);
                        }
                        for (i, row) in rows.clone().enumerate() {
                            let want = images[row][light];
                            sums[0] += f64::from(got[(i, light)] - want).powi(2);
                            sums[1] += f64::from(want).powi(2);
                        }
                    }
                }
            }
        }
        let seen = self.estimate.deciding(self.checks.rows(), |c, pixel, light| seen[c][(pixel, light)].into());
        (found, self.estimate.lost(&self.held, &seen))
    }

    /// The first directions: as many as leave at most `budget` of what all hold of the deciding lights.
    fn directions(&self, budget: f64) -> Directions {
        let certain = self.squares.iter().take_while(|v| **v > linear::CERTAIN * self.squares[0]).count();
        let rank = multiple(self.estimate.needed(self.directions.as_ref(), self.decided.as_ref(), budget).min(certain));
        // Padded with directions that are zero.
        let filled = certain.min(rank);
        let turn =
            Mat::from_fn(self.vectors.nrows(), rank, |i, j| if j < filled { self.vectors[(i, j)] as f32 } else { 0.0 });
        let mut sizes: Vec<f32> = self.squares[..filled].iter().map(|v| v.sqrt() as f32).collect();
        sizes.resize(rank, 0.0);
        let entry =
            |i: usize, light: usize| if i < filled { self.decided[(i, light)] / f64::from(sizes[i]) } else { 0.0 };
        let deciding = Mat::from_fn(rank, self.decided.ncols(), entry);
        Directions { turn, sizes, deciding }
    }

    /// Terms that matter x directions.
    fn turned(&self, turn: &Mat<f32>) -> [Mat<f32>; 3] {
        let turned = |panels: &Vec<Panel>| {
            let mut all = Mat::<f32>::zeros(self.list.len(), turn.ncols());
            for first in (0..self.list.len()).step_by(TERMS) {
                let rows = first..self.list.len().min(first + TERMS);
                let terms = vector_batch::gathered(panels, rows.clone());
                let terms = MatRef::from_row_major_slice(&terms, rows.len(), panels.len() * WIDTH);
                let all = all.subrows_mut(first, rows.len());
                linear::add_product(all, terms.subcols(0, turn.nrows()), turn.as_ref());
            }
            all
        };
        self.terms.channels.each_ref().map(turned)
    }

    /// List and tints of chosen terms, and V before it is rounded, in units of the directions' `sizes`.
    fn fit_v(
        &self,
        turn: &Mat<f32>,
        turned: [Mat<f32>; 3],
        chosen: &Chosen,
        sizes: &[f32],
    ) -> (Vec<u32>, Vec<Vec3>, Vec<f32>) {
        let Chosen { own, tinted } = chosen;
        let all = [&own[..], tinted].concat();
        let [red, green, blue] = turned;
        let fitted = [(0, red), (1, green), (2, blue)].map(|(c, turned)| self.fit_terms(c, turn, turned, &all));
        // What pads lists is multiplied by zero.
        let mut list = Vec::new();
        for terms in [own, tinted] {
            list.extend(terms.iter().map(|&i| self.list[i as usize]));
            list.resize(multiple(list.len()), list.last().copied().unwrap_or(0));
        }
        let of_own = list.len() - multiple(tinted.len());
        let mut tints = vec![Vec3::ONE; list.len()];
        let blend = |((i, &term), tint): ((usize, &u32), &mut Vec3)| {
            let columns = fitted.each_ref().map(|f| f.row(own.len() + i).iter().copied().collect::<Vec<f32>>());
            let power = self.power.each_ref().map(|power| power[term as usize].into());
            let (blend, of_blend) = terms::tinted(columns.each_ref().map(|c| &c[..]), DVec3::from_array(power));
            *tint = of_blend;
            blend
        };
        let blends: Vec<Vec<f32>> = tinted.iter().enumerate().zip(&mut tints[of_own..]).map(blend).collect();
        let mut v = Vec::with_capacity(sizes.len() * (2 * of_own + list.len()));
        let in_units = |x: f32, r: usize| if sizes[r] > 0.0 { x / sizes[r] } else { 0.0 };
        for (fitted, r) in fitted.iter().flat_map(|f| (0..sizes.len()).map(move |r| (f, r))) {
            v.extend((0..of_own).map(|i| if i < own.len() { in_units(fitted[(i, r)], r) } else { 0.0 }));
        }
        for r in 0..sizes.len() {
            v.extend((0..list.len() - of_own).map(|i| blends.get(i).map_or(0.0, |blend| in_units(blend[r], r))));
        }
        (list, tints, v)
    }

    /// What some terms are multiplied by, terms x directions: their own factors and, by ridge regression over the lights to learn
    /// from, what they tell of the terms left out.
    fn fit_terms(&self, channel: usize, turn: &Mat<f32>, factors: Mat<f32>, some: &[u32]) -> Mat<f32> {
        let learned = &self.inputs.learned;
        let listed = learned.gathered(channel, some.iter().map(|&i| self.list[i as usize] as usize));
        let listed = MatRef::from_row_major_slice(&listed, some.len(), learned.width);
        let mut kept = Mat::from_fn(some.len(), factors.ncols(), |i, r| factors[(some[i] as usize, r)]);
        drop(factors);
        let mut missing = linear::product(listed.transpose(), kept.as_ref()) * faer::Scale(-1.0);
        linear::add_product(missing.as_mut(), self.learned[channel].transpose(), turn.as_ref());
        let mut gram = Mat::from_fn(listed.ncols(), listed.ncols(), |_, _| 0.0f32);
        linear::add_product(gram.as_mut(), listed.transpose(), listed);
        let mut gram = Mat::from_fn(gram.nrows(), gram.nrows(), |i, j| f64::from(gram[(i, j)]));
        let all: f64 = (0..gram.nrows()).map(|l| gram[(l, l)]).sum();
        if all > 0.0 {
            (0..gram.nrows()).for_each(|l| gram[(l, l)] += RIDGE * all);
            let shares = Lu::new(gram).solve(missing.as_ref(), false);
            let shares = Mat::from_fn(shares.nrows(), shares.ncols(), |l, r| shares[(l, r)] as f32);
            linear::add_product(kept.as_mut(), listed, shares.as_ref());
        }
        kept
    }
}

/// Share of the allowed error that terms may add up to which are not looked at.
const SLIGHT: f64 = 0.01;
/// Terms that are multiplied at once, with what they make of all vectors and lights: these stay in a cache.
const TERMS: usize = 512;
/// What keeps the regression from believing few lights too much, as a share of all their squares.
const RIDGE: f64 = 1e-3;

/// What is kept of a basis.
struct Directions {
    /// Directions as combinations of the basis.
    turn: Mat<f32>,
    /// Root mean square that light has along each; 0 of padding.
    sizes: Vec<f32>,
    /// The deciding lights in these units, by their weights: directions x lights, channel after channel.
    deciding: Mat<f64>,
}

/// Haar terms that matter, and what they make of the vectors of `basis`. The others add up to squares of about `slight`.
fn seen_terms(inputs: &Inputs, rows: &Transposed, basis: MatRef<f64>, slight: f64) -> (Vec<u32>, VectorBatch) {
    let terms = |vectors: MatRef<f64>| {
        let vectors = VectorBatch::from_fn(vectors.nrows(), vectors.ncols(), |_, i, j| vectors[(i, j)] as f32);
        inputs.bounces.terms(&inputs.haar, rows.multiply(&vectors))
    };
    // Of sums with random signs the mean square is the sum of squares.
    let points = Points::new(0, 0);
    let sign = |vector: usize, sum: usize| if points.at(vector as u32, sum as u32)[0] < 0.5 { 1.0 } else { -1.0 };
    let signs = Mat::from_fn(basis.ncols(), WIDTH, sign);
    let sums = terms(linear::product(basis, signs.as_ref()).as_ref());
    let mut squares = vec![0.0f64; sums.rows()];
    for (channel, power) in inputs.power.iter().enumerate() {
        let of_channel = sums.row_squares(channel).into_iter().zip(power);
        squares.iter_mut().zip(of_channel).for_each(|(all, (x, power))| *all += f64::from(x * power) / WIDTH as f64);
    }
    let mut list: Vec<u32> = (0..squares.len() as u32).collect();
    let square = |j: &u32| squares[*j as usize];
    list.sort_unstable_by(|a, b| square(b).total_cmp(&square(a)).then(a.cmp(b)));
    list.truncate(cut(list.iter().map(square), slight));
    list.sort_unstable();

    let mut found = VectorBatch { count: basis.ncols(), ..Default::default() };
    for first in (0..basis.ncols()).step_by(WIDTH) {
        let some = terms(basis.subcols(first, WIDTH.min(basis.ncols() - first)));
        for (found, some) in found.channels.iter_mut().zip(&some.channels) {
            found.push(list.iter().map(|&j| some[0][j as usize]).collect());
        }
    }
    (list, found)
}

/// What `count` vectors hold of lights, from the terms of both, of which `lit` gives those of `lights` lights: vectors x lights.
fn hold(terms: &[Panel], list: &[u32], lights: usize, lit: impl Fn(&[u32]) -> Vec<f32>, count: usize) -> Mat<f32> {
    let mut all = Mat::zeros(count, lights);
    for (number, list) in list.chunks(TERMS).enumerate() {
        let some = vector_batch::gathered(terms, number * TERMS..number * TERMS + list.len());
        let some = MatRef::from_row_major_slice(&some, list.len(), terms.len() * WIDTH);
        let lit = lit(list);
        let lit = MatRef::from_row_major_slice(&lit, list.len(), lights);
        linear::add_product(all.as_mut(), some.subcols(0, count).transpose(), lit);
    }
    all
}

/// A row-major block in single precision.
fn single(block: &[f16], rows: usize, columns: usize) -> Mat<f32> {
    Mat::from_fn(rows, columns, |i, j| block[i * columns + j].to_f32())
}

/// Largest factor of V: far from the largest of half precision, 65,504, and far above the smallest normal one, 6e-5.
const V_LARGEST: f32 = 1024.0;

/// An orthonormal basis of what the images span, the fullest directions first; and the square of all images.
fn range(images: &VectorBatch) -> (Mat<f64>, f64) {
    let all: Vec<&Panel> = images.channels.iter().flatten().collect();
    let all = Mat::from_fn(images.rows(), all.len() * WIDTH, |i, j| f64::from(all[j / WIDTH][i][j % WIDTH]));
    linear::orthonormal(&all)
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
    let kept = multiple(cut((0..rank).map(square), budget));
    let vectors = vectors.subcols(0, kept);
    let b = (0..kept).flat_map(|r| (0..rank).map(move |j| f16::from_f64(vectors[(j, r)]))).collect();
    let u = linear::product(all.as_ref(), vectors);
    let u = (0..rows.len()).flat_map(|i| (0..kept).map(move |r| (i, r))).map(|(i, r)| u[(i, r)] as f32 / scale);
    TileFactors { rank: kept, b, u: u.collect() }
}

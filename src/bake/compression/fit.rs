//! The fit of one supercluster: from the sparse rows of its pixels to V, B and U.

use std::ops::Range;

use faer::{Mat, MatRef};
use glam::{DVec3, Vec3};
use half::f16;
use serde::{Deserialize, Serialize};

use super::adjoint::Adjoint;
use super::inputs::Inputs;
use super::noise_estimate::NoiseEstimate;
use super::terms::{self, Chosen, cut, multiple};
use super::transposed::{Rounded, Transposed, TransposedPart};
use super::vector_batch::{self, Panel, VectorBatch, WIDTH};
use super::{OUT_OF_BASIS_SHARE, ValidationSums};
use crate::bake::csr_matrix::CsrMatrix;
use crate::bake::linear::{self, Lu};

/// Squared errors allowed for the three steps, as shares of the whole image's square.
#[derive(Clone, Copy, Debug)]
pub struct Budget {
    /// Omitted directions of the supercluster.
    pub rank: f64,
    /// Omitted terms of light.
    pub terms: f64,
    /// Omitted directions of tiles.
    pub tiles: f64,
}

/// A supercluster projected onto a basis, before it is fitted.
pub struct Projected<'a> {
    inputs: &'a Inputs,
    /// An orthonormal basis of the retained space, ordered by decreasing energy of the training lights: pixels x
    /// directions.
    directions: Mat<f64>,
    /// Energy of all training lights along each direction.
    squares: Vec<f64>,
    /// Significant Haar terms, ascending.
    list: Vec<u32>,
    /// Their power, by channel.
    power: [Vec<f32>; 3],
    /// Products of Tᵀ with the vectors of another basis, by channel: significant terms x vectors.
    terms: VectorBatch,
    /// The directions as combinations of those vectors.
    vectors: Mat<f64>,
    /// Coefficients of the training lights in those vectors: vectors x lights, by channel.
    training: [Mat<f32>; 3],
    /// Coefficients of the deciding lights along the directions.
    decided: Mat<f64>,
    /// Allowed squared error beyond noise.
    pub allowed: f64,
    /// Squared light outside the basis, which no fit can recover.
    pub outside: f64,
    /// Images of the validation lights: pixels x lights.
    pub validation_images: VectorBatch,
    pub estimate: NoiseEstimate,
    /// Projections of the deciding lights' images onto the basis.
    projections: Mat<f64>,
}

/// Rows of Φ and their products with lights.
pub struct RowProducts {
    rows: Transposed<Rounded>,
    /// Images of random combinations of the training lights, and of the validation lights.
    combinations: VectorBatch,
    validation_images: VectorBatch,
}

impl RowProducts {
    /// Contains no rows.
    pub fn new(inputs: &Inputs) -> Self {
        Self {
            rows: Transposed { columns: inputs.combinations.rows(), parts: Vec::new() },
            combinations: VectorBatch::zeros(0, inputs.combinations.count),
            validation_images: VectorBatch::zeros(0, inputs.validation_operands.count),
        }
    }

    /// Appends pixels.
    pub fn push(&mut self, inputs: &Inputs, rows: &CsrMatrix) {
        self.rows.parts.push(TransposedPart::new(rows, self.combinations.rows(), self.rows.columns));
        self.combinations.append(vector_batch::multiply(rows, &inputs.combinations));
        self.validation_images.append(vector_batch::multiply(rows, &inputs.validation_operands));
    }
}

/// Some of the rows, gathered with other random numbers.
pub struct Resampled<'a> {
    pub rows: &'a CsrMatrix,
    /// Their indices among the pixels of the supercluster.
    pub pixels: &'a [usize],
}

/// Factors of one supercluster: V multiplies the terms, B the result of V, U the result of B.
#[derive(Default, Serialize, Deserialize)]
pub struct Factors {
    pub list: Vec<u32>,
    /// Number of terms, the first of the list, that have separate factors for each channel.
    pub per_channel_count: usize,
    /// One for each entry of the list; 1 for the first `per_channel_count`.
    pub tints: Vec<Vec3>,
    pub rank: usize,
    /// Blocks of red, green and blue, rank x `per_channel_count` each; then the block shared by all channels, rank x
    /// tinted terms.
    pub v: Vec<f16>,
    pub tiles: Vec<TileFactors>,
}

impl Factors {
    /// Bytes of all factors in float16, without padding.
    pub fn packed_bytes(&self) -> u64 {
        let of_tiles: usize = self.tiles.iter().map(|tile| tile.b.len() + tile.u.len()).sum();
        (size_of::<f16>() * (self.v.len() + of_tiles)) as u64
    }

    /// V of one channel, tints included: rank x list.
    fn v(&self, channel: usize) -> Mat<f32> {
        let (count, tinted) = (self.per_channel_count, self.list.len() - self.per_channel_count);
        let [per_channel, of_tinted] = [channel, 3].map(|block| &self.v[block * self.rank * count..]);
        Mat::from_fn(self.rank, self.list.len(), |r, i| match i.checked_sub(count) {
            None => per_channel[r * count + i].to_f32(),
            Some(i) => of_tinted[r * tinted + i].to_f32() * self.tints[count + i][channel],
        })
    }
}

/// Factors of one tile.
#[derive(Serialize, Deserialize)]
pub struct TileFactors {
    pub rank: usize,
    /// rank x the supercluster's rank.
    pub b: Vec<f16>,
    /// Pixels x rank; not rounded before packing.
    pub u: Vec<f32>,
}

impl<'a> Projected<'a> {
    /// From the products of the supercluster's rows. `allowed` computes the allowed squared error beyond noise from the
    /// squares of the images and of their noise.
    pub fn new(
        inputs: &'a Inputs,
        seen: RowProducts,
        resampled: &Resampled,
        allowed: impl Fn(f64, f64) -> f64,
    ) -> Self {
        let RowProducts { rows, combinations, validation_images } = seen;
        let again = vector_batch::multiply(resampled.rows, &inputs.validation_operands);
        let estimate = NoiseEstimate::new(resampled.pixels, &validation_images, &again, &inputs.deciding);
        let (all, energy) = range(&combinations);
        let allowed = allowed(energy, estimate.weighted_noise);
        let projections = linear::product(all.transpose(), estimate.images.as_ref());
        let count = estimate.needed(all.as_ref(), projections.as_ref(), OUT_OF_BASIS_SHARE * allowed);
        let count = count.next_multiple_of(WIDTH).min(all.ncols());
        let projections = linear::product(all.subcols(0, count), projections.subrows(0, count));
        let outside = estimate.outside(&projections);
        let basis = all.subcols(0, count);
        let (list, terms) = Adjoint { inputs, rows: &rows }.terms(basis, NEGLIGIBLE_SHARE * allowed);
        let power = inputs.power.each_ref().map(|power| list.iter().map(|&term| power[term as usize]).collect());
        let training = [0, 1, 2].map(|c| {
            let lights = inputs.training_terms.width;
            let lit = |list: &[u32]| inputs.training_terms.gathered(c, list.iter().map(|&term| term as usize), lights);
            project_lights(&terms.channels[c], &list, lights, lit, count)
        });
        let decided = [0, 1, 2].map(|c| {
            let deciding = &inputs.validation_terms.channels[c][..1];
            let lit = |list: &[u32]| vector_batch::gathered(deciding, list.iter().map(|&term| term as usize));
            project_lights(&terms.channels[c], &list, WIDTH, lit, count)
        });
        let decided = estimate.deciding(count, |c, direction, light| decided[c][(direction, light)].into());
        let mut gram = Mat::<f64>::zeros(count, count);
        for training in &training {
            let training = Mat::from_fn(count, training.ncols(), |i, l| f64::from(training[(i, l)]));
            gram += linear::product(training.as_ref(), training.transpose());
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
            training,
            decided,
            allowed,
            outside,
            validation_images,
            estimate,
            projections,
        }
    }

    /// Factors of the supercluster and its `tiles`, ranges of its pixels.
    pub fn fit(&self, tiles: &[Range<usize>], budget: &Budget) -> Factors {
        let Directions { turn, sizes, deciding } = self.directions(budget.rank);
        let rank = turn.ncols();
        let turned = self.turned(&turn);
        let chosen = terms::choose(&turned, &self.power, budget.terms);
        if chosen.per_channel.is_empty() && chosen.tinted.is_empty() {
            // Without terms all directions are zero.
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
        Factors { list, per_channel_count: multiple(chosen.per_channel.len()), tints, rank, v, tiles }
    }

    /// Compares the images of the validation lights with those of the rows: squared error and square for each tile and
    /// light. Also returns the squared light that the factors lose of the projected images, and the squared noise that
    /// they discard.
    pub fn check(&self, factors: &Factors, tiles: &[Range<usize>]) -> (ValidationSums, (f64, f64)) {
        let mut sums = vec![vec![[0.0; 2]; self.validation_images.count]; tiles.len()];
        let mut seen = [0; 3].map(|_| Mat::zeros(self.validation_images.rows(), WIDTH));
        for (c, (terms, images)) in
            self.inputs.validation_terms.channels.iter().zip(&self.validation_images.channels).enumerate()
        {
            let v = factors.v(c);
            for (part, (terms, images)) in terms.iter().zip(images).enumerate() {
                let listed: Panel = factors.list.iter().map(|&j| terms[j as usize]).collect();
                let y = linear::product(v.as_ref(), vector_batch::matrix(&listed));
                for ((rows, tile), sums) in tiles.iter().zip(&factors.tiles).zip(&mut sums) {
                    let coefficients = linear::product(single(&tile.b, tile.rank, factors.rank).as_ref(), y.as_ref());
                    let u = MatRef::from_row_major_slice(&tile.u, rows.len(), tile.rank);
                    let got = linear::product(u, coefficients.as_ref());
                    let lights = part * WIDTH..self.validation_images.count.min((part + 1) * WIDTH);
                    for (light, [error, square]) in sums[lights].iter_mut().enumerate() {
                        if part == 0 {
                            rows.clone().enumerate().for_each(|(i, row)| seen[c][(row, light)] = got[(i, light)]);
                        }
                        for (i, row) in rows.clone().enumerate() {
                            let want = images[row][light];
                            *error += f64::from(got[(i, light)] - want).powi(2);
                            *square += f64::from(want).powi(2);
                        }
                    }
                }
            }
        }
        let seen =
            self.estimate.deciding(self.validation_images.rows(), |c, pixel, light| seen[c][(pixel, light)].into());
        (sums, self.estimate.lost(&self.projections, &seen))
    }

    /// The smallest number of leading directions such that the remaining ones contain at most `budget` of the deciding
    /// lights.
    fn directions(&self, budget: f64) -> Directions {
        let certain = self.squares.iter().take_while(|v| **v > linear::CERTAIN * self.squares[0]).count();
        let rank = multiple(self.estimate.needed(self.directions.as_ref(), self.decided.as_ref(), budget).min(certain));
        // Padded with zero directions.
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

    /// Products with the directions, by channel: significant terms x directions.
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

    /// List and tints of the chosen terms, and V before rounding, in units of the directions' `sizes`.
    fn fit_v(
        &self,
        turn: &Mat<f32>,
        turned: [Mat<f32>; 3],
        chosen: &Chosen,
        sizes: &[f32],
    ) -> (Vec<u32>, Vec<Vec3>, Vec<f32>) {
        let Chosen { per_channel, tinted } = chosen;
        let all = [&per_channel[..], tinted].concat();
        let [red, green, blue] = turned;
        let fitted = [(0, red), (1, green), (2, blue)].map(|(c, turned)| self.fit_terms(c, turn, turned, &all));
        // Padding entries of the lists have zero factors.
        let mut list = Vec::new();
        for terms in [per_channel, tinted] {
            list.extend(terms.iter().map(|&i| self.list[i as usize]));
            list.resize(multiple(list.len()), list.last().copied().unwrap_or(0));
        }
        let per_channel_count = list.len() - multiple(tinted.len());
        let mut tints = vec![Vec3::ONE; list.len()];
        let shared = |((i, &term), tint): ((usize, &u32), &mut Vec3)| {
            let columns = fitted.each_ref().map(|f| f.row(per_channel.len() + i).iter().copied().collect::<Vec<f32>>());
            let power = self.power.each_ref().map(|power| power[term as usize].into());
            let (shared, its_tint) = terms::tinted(columns.each_ref().map(|c| &c[..]), DVec3::from_array(power));
            *tint = its_tint;
            shared
        };
        let shared_columns: Vec<Vec<f32>> =
            tinted.iter().enumerate().zip(&mut tints[per_channel_count..]).map(shared).collect();
        let mut v = Vec::with_capacity(sizes.len() * (2 * per_channel_count + list.len()));
        let in_units = |x: f32, r: usize| if sizes[r] > 0.0 { x / sizes[r] } else { 0.0 };
        for (fitted, r) in fitted.iter().flat_map(|f| (0..sizes.len()).map(move |r| (f, r))) {
            v.extend(
                (0..per_channel_count).map(|i| if i < per_channel.len() { in_units(fitted[(i, r)], r) } else { 0.0 }),
            );
        }
        for r in 0..sizes.len() {
            v.extend(
                (0..list.len() - per_channel_count)
                    .map(|i| shared_columns.get(i).map_or(0.0, |shared| in_units(shared[r], r))),
            );
        }
        (list, tints, v)
    }

    /// Factors of the terms `some`: terms x directions. They are the terms' own factors plus, by ridge regression over
    /// the training lights, a prediction of the omitted terms.
    fn fit_terms(&self, channel: usize, turn: &Mat<f32>, factors: Mat<f32>, some: &[u32]) -> Mat<f32> {
        let terms = some.iter().map(|&i| self.list[i as usize] as usize);
        let lights = self.inputs.training_terms.width.min(RIDGE_LIGHTS);
        let listed = self.inputs.training_terms.gathered(channel, terms, lights);
        let listed = MatRef::from_row_major_slice(&listed, some.len(), lights);
        let mut kept = Mat::from_fn(some.len(), factors.ncols(), |i, r| factors[(some[i] as usize, r)]);
        drop(factors);
        let mut missing = linear::product(listed.transpose(), kept.as_ref()) * faer::Scale(-1.0);
        linear::add_product(missing.as_mut(), self.training[channel].subcols(0, lights).transpose(), turn.as_ref());
        let mut gram = Mat::from_fn(listed.ncols(), listed.ncols(), |_, _| 0.0f32);
        linear::add_product(gram.as_mut(), listed.transpose(), listed);
        let mut gram = Mat::from_fn(gram.nrows(), gram.nrows(), |i, j| f64::from(gram[(i, j)]));
        let all: f64 = (0..gram.nrows()).map(|l| gram[(l, l)]).sum();
        if all > 0.0 {
            (0..gram.nrows()).for_each(|l| gram[(l, l)] += RIDGE * all);
            let shares = Lu::new(gram).solve(missing.as_ref());
            let shares = Mat::from_fn(shares.nrows(), shares.ncols(), |l, r| shares[(l, r)] as f32);
            linear::add_product(kept.as_mut(), listed, shares.as_ref());
        }
        kept
    }
}

/// Terms that sum to less than this share of the allowed error are ignored.
const NEGLIGIBLE_SHARE: f64 = 0.01;
/// Block size of the terms in products, so that intermediate results stay in a cache.
const TERMS: usize = 512;
/// Training lights that predict omitted terms, the first of all.
pub const RIDGE_LIGHTS: usize = 128;
/// Ridge regularization against overfitting to few lights, as a share of the sum of their squares. Ten times as much
/// loses light (docs/accuracy.md, "Training lights").
const RIDGE: f64 = 1e-4;

/// The retained part of a basis.
struct Directions {
    /// Directions as combinations of the basis vectors.
    turn: Mat<f32>,
    /// Root mean square of light along each direction; 0 for padding.
    sizes: Vec<f32>,
    /// The deciding lights in these units, times the roots of their weights: directions x lights, channel by channel.
    deciding: Mat<f64>,
}

/// Coefficients of lights in `count` vectors, from the Haar terms of both: vectors x lights. `lit` returns the terms of
/// the `lights` lights.
fn project_lights(
    terms: &[Panel],
    list: &[u32],
    lights: usize,
    lit: impl Fn(&[u32]) -> Vec<f32>,
    count: usize,
) -> Mat<f32> {
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

/// Largest factor of V: far below the maximum of half precision, 65,504, and far above its smallest normal number,
/// 6e-5.
const V_LARGEST: f32 = 1024.0;

/// An orthonormal basis of the span of the images, ordered by decreasing energy; and the sum of all squares.
fn range(images: &VectorBatch) -> (Mat<f64>, f64) {
    let all: Vec<&Panel> = images.channels.iter().flatten().collect();
    let all = Mat::from_fn(images.rows(), all.len() * WIDTH, |i, j| f64::from(all[j / WIDTH][i][j % WIDTH]));
    linear::orthonormal(&all)
}

/// Factors of a tile from the rows of its pixels, whose columns are the directions in units of their root mean square.
/// `scale` is the factor that V was multiplied by.
fn tile(pixels: &Mat<f32>, rows: &Range<usize>, deciding: &Mat<f64>, budget: f64, scale: f32) -> TileFactors {
    let rank = pixels.ncols();
    let all = Mat::from_fn(rows.len(), rank, |i, j| f64::from(pixels[(rows.start + i, j)]));
    let (values, vectors) = linear::eigen(&linear::product(all.transpose(), all.as_ref()));
    // Squared coefficients of the deciding lights along each direction.
    let turned = linear::product(vectors.transpose(), deciding.as_ref());
    let square = |r: usize| turned.row(r).iter().map(|x| x * x).sum::<f64>() * values[r];
    let kept = multiple(cut((0..rank).map(square), budget));
    let vectors = vectors.subcols(0, kept);
    let b = (0..kept).flat_map(|r| (0..rank).map(move |j| f16::from_f64(vectors[(j, r)]))).collect();
    let u = linear::product(all.as_ref(), vectors);
    let u = (0..rows.len()).flat_map(|i| (0..kept).map(move |r| (i, r))).map(|(i, r)| u[(i, r)] as f32 / scale);
    TileFactors { rank: kept, b, u: u.collect() }
}

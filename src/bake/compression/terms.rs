//! Selects the terms of light that a supercluster uses, and their tints.
//!
//! The contributions of one term to the directions of a supercluster, in R, G and B, are three vectors, the columns of
//! V. They are nearly multiples of one vector, v t with a tint t (docs/method.md, "Tints"). So a term is stored either
//! as one column and a tint, for a third of the bytes, or as three columns.

use crate::shared::PANEL_COLUMNS;
use faer::Mat;
use glam::{DMat3, DVec3, Vec3};

/// Ranks and list lengths are multiples of this: 16 bytes of factors.
pub const MULTIPLE: usize = PANEL_COLUMNS as usize;

/// The terms that a supercluster uses, ascending.
#[derive(Debug, PartialEq)]
pub struct Chosen {
    /// With one column per channel.
    pub per_channel: Vec<u32>,
    /// With one column and a tint.
    pub tinted: Vec<u32>,
}

/// The cheapest choice that loses at most about `tail` of the sum of squares. `turned` has terms x directions for each
/// channel; squares are weighted by the terms' power in that channel. Either list is extended to a multiple of
/// [`MULTIPLE`] while there are terms.
pub fn choose(turned: &[Mat<f32>; 3], power: &[Vec<f32>; 3], tail: f64) -> Chosen {
    let products = products(turned);
    // Gain of one column and a tint, and of two more columns.
    let mut steps: Vec<Step> = Vec::new();
    for (term, products) in products.iter().enumerate() {
        let power = DVec3::from_array(power.each_ref().map(|p| p[term].into()));
        let all = power.dot(DVec3::from_array([0, 1, 2].map(|c| products.col(c)[c])));
        if all > 0.0 {
            let tinted = power.dot(SharedColumn::new(products, power).tint.powf(2.0)).min(all);
            let term = term as u32;
            steps.push(Step { term, per_channel: false, gain: tinted, gain_per_column: tinted });
            steps.push(Step { term, per_channel: true, gain: all - tinted, gain_per_column: (all - tinted) / 2.0 });
        }
    }
    steps.sort_unstable_by(|a, b| {
        b.gain_per_column.total_cmp(&a.gain_per_column).then((a.per_channel, a.term).cmp(&(b.per_channel, b.term)))
    });
    let kept = cut(steps.iter().map(|step| step.gain), tail);
    let list = |steps: &[Step], left: &dyn Fn(&Step) -> bool| {
        let count = steps[..kept].iter().filter(|step| left(step)).count();
        let mut terms: Vec<u32> = steps.iter().filter(|step| left(step)).map(|step| step.term).collect();
        terms.truncate(multiple(count));
        terms.sort_unstable();
        terms
    };
    let per_channel = list(&steps, &|step| step.per_channel);
    let tinted = list(&steps, &|step| !step.per_channel && per_channel.binary_search(&step.term).is_err());
    Chosen { per_channel, tinted }
}

/// One storage option: a gain at a cost in bytes.
struct Step {
    term: u32,
    /// From one column and a tint to three columns; otherwise from nothing to one column and a tint.
    per_channel: bool,
    gain: f64,
    /// Gain per column.
    gain_per_column: f64,
}

/// For each term the inner products of its channels' columns.
fn products(turned: &[Mat<f32>; 3]) -> Vec<DMat3> {
    let mut all = vec![DMat3::ZERO; turned[0].nrows()];
    for (a, b) in [(0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)] {
        let mut sums = vec![0.0f64; all.len()];
        for (x, y) in turned[a].col_iter().zip(turned[b].col_iter()) {
            sums.iter_mut().zip(x.iter().zip(y.iter())).for_each(|(sum, (x, y))| *sum += f64::from(x * y));
        }
        for (all, sum) in all.iter_mut().zip(sums) {
            all.col_mut(a)[b] = sum;
            all.col_mut(b)[a] = sum;
        }
    }
    all
}

/// One unit vector that replaces three vectors.
struct SharedColumn {
    /// Its coefficients as a combination of the three vectors.
    shares: DVec3,
    /// Its inner products with the three vectors, each of which is replaced by the vector times its entry.
    tint: DVec3,
}

impl SharedColumn {
    /// The direction with the smallest residual, weighted by channel `power`; from the inner products of the three
    /// vectors.
    fn new(products: &DMat3, power: DVec3) -> Self {
        let root = DMat3::from_diagonal(power.map(f64::sqrt));
        // The largest eigenvector: the dominant column of a high power of the matrix.
        let mut many = root * *products * root;
        for _ in 0..5 {
            let largest = many.to_cols_array().into_iter().fold(0.0f64, |m, x| m.max(x.abs()));
            if largest == 0.0 {
                break;
            }
            many *= 1.0 / largest;
            many *= many;
        }
        let columns = [many.x_axis, many.y_axis, many.z_axis];
        let largest = columns.into_iter().max_by(|a, b| a.length_squared().total_cmp(&b.length_squared()));
        let shares = root * largest.expect("there are three");
        let length = shares.dot(*products * shares).max(0.0).sqrt();
        let shares = if length > 0.0 { shares / length } else { DVec3::ZERO };
        Self { shares, tint: *products * shares }
    }
}

/// One column and a tint that approximate three columns, weighted by channel `power`.
pub fn tinted(columns: [&[f32]; 3], power: DVec3) -> (Vec<f32>, Vec3) {
    let product = |a: usize, b: usize| columns[a].iter().zip(columns[b]).map(|(x, y)| f64::from(x * y)).sum::<f64>();
    let products = DMat3::from_cols_array_2d(&[0, 1, 2].map(|a| [0, 1, 2].map(|b| product(a, b))));
    let SharedColumn { shares, tint } = SharedColumn::new(&products, power);
    let largest = tint.abs().max_element();
    if largest == 0.0 {
        return (vec![0.0; columns[0].len()], Vec3::ONE);
    }
    let shares = shares * largest;
    let entry = |i: usize| shares.dot(DVec3::from_array(columns.map(|column| column[i].into()))) as f32;
    ((0..columns[0].len()).map(entry).collect(), (tint / largest).as_vec3())
}

/// Number of leading values, in order of priority, such that the others sum to at most `tail`.
pub fn cut(values: impl DoubleEndedIterator<Item = f64> + ExactSizeIterator, tail: f64) -> usize {
    let (count, mut sum) = (values.len(), 0.0);
    let dropped = values.rev().take_while(|value| {
        sum += *value;
        sum <= tail
    });
    count - dropped.count()
}

/// `count`, rounded up to a multiple of [`MULTIPLE`].
pub fn multiple(count: usize) -> usize {
    count.next_multiple_of(MULTIPLE)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::physics::sequence::Points;

    const TERMS: usize = 192;
    const DIRECTIONS: usize = 24;

    /// Columns of terms, each a tenth smaller than the one before and with its own colour; in every third term the
    /// channels differ.
    fn turned(count: usize) -> [Mat<f32>; 3] {
        let points = Points::new(3, 0);
        let random = |i: usize, j: usize| points.at(i as u32, j as u32)[0] as f32 - 0.5;
        let tint = |term: usize, channel: usize| [1.0, 0.5 + 0.1 * (term % 5) as f32, 0.2][(channel + term) % 3];
        [0, 1, 2].map(|channel| {
            Mat::from_fn(count, DIRECTIONS, |term, r| {
                let own = if term % 3 == 0 { random(term, 1000 + 100 * channel + r) } else { 0.0 };
                0.9f32.powi(term as i32) * (tint(term, channel) * random(term, r) + own)
            })
        })
    }

    fn column(turned: &Mat<f32>, term: usize) -> Vec<f32> {
        turned.row(term).iter().copied().collect()
    }

    /// Total squared error of a choice. A term contributes all of its square, its residual after tinting, or nothing.
    fn lost(turned: &[Mat<f32>; 3], power: &[Vec<f32>; 3], chosen: &Chosen) -> f64 {
        let of_term = |term: usize| {
            let columns = turned.each_ref().map(|turned| column(turned, term));
            let power = power.each_ref().map(|p| f64::from(p[term]));
            let (shared, tint) = match term as u32 {
                term if chosen.per_channel.contains(&term) => return 0.0,
                term if chosen.tinted.contains(&term) => {
                    tinted(columns.each_ref().map(|c| &c[..]), DVec3::from_array(power))
                }
                _ => (vec![0.0; DIRECTIONS], Vec3::ONE),
            };
            let off = |c: usize, r: usize| f64::from(columns[c][r] - shared[r] * tint[c]).powi(2);
            (0..3).map(|c| power[c] * (0..DIRECTIONS).map(|r| off(c, r)).sum::<f64>()).sum()
        };
        (0..turned[0].nrows()).map(of_term).sum()
    }

    #[test]
    fn a_choice_loses_what_it_may_for_the_fewest_columns() {
        let turned = turned(TERMS);
        let power = [1.0, 4.0, 0.25].map(|power| vec![power; TERMS]);
        let all = lost(&turned, &power, &Chosen { per_channel: vec![], tinted: vec![] });
        for tail in [1e-2, 1e-4, 1e-8].map(|share| share * all) {
            let chosen = choose(&turned, &power, tail);
            let found = lost(&turned, &power, &chosen);
            assert!(found <= tail, "{found} of {tail}");
            assert!(chosen.per_channel.iter().all(|term| !chosen.tinted.contains(term)));
            // With terms of only one type, no fewer suffice.
            let fewest = |per_channel: bool| {
                let chosen = |count: u32| {
                    let some: Vec<u32> = (0..count).collect();
                    if per_channel {
                        Chosen { per_channel: some, tinted: vec![] }
                    } else {
                        Chosen { per_channel: vec![], tinted: some }
                    }
                };
                (0..=TERMS as u32).find(|&count| lost(&turned, &power, &chosen(count)) <= tail)
            };
            let cost = 3 * chosen.per_channel.len() + chosen.tinted.len();
            assert!(cost < 3 * multiple(fewest(true).unwrap() as usize), "{chosen:?}");
            assert!(fewest(false).is_none(), "tints alone would do");
        }
        // A grey operator needs no separate columns per channel.
        let grey = turned[0].clone();
        let chosen = choose(&[grey.clone(), grey.clone(), grey], &power, 1e-6 * all);
        assert!(chosen.per_channel.is_empty() && !chosen.tinted.is_empty(), "{chosen:?}");
        let black = [0; 3].map(|_| Mat::zeros(TERMS, DIRECTIONS));
        assert_eq!(choose(&black, &power, 0.0), Chosen { per_channel: vec![], tinted: vec![] });
    }

    /// Compares with the best of many other columns. Channels without power follow in proportion to their own scale.
    #[test]
    fn no_other_shared_column_is_closer() {
        let columns = [0, 1, 2].map(|c| column(&turned(1)[c], 0));
        let columns = columns.each_ref().map(|c| &c[..]);
        let points = Points::new(7, 0);
        for power in [DVec3::ONE, DVec3::new(1.0, 0.0, 0.0), DVec3::new(1e-6, 1.0, 3.0), DVec3::ZERO] {
            let (shared, tint) = tinted(columns, power);
            let off = |shared: &[f32], tint: DVec3| {
                let off = |c: usize, r: usize| (f64::from(columns[c][r]) - f64::from(shared[r]) * tint[c]).powi(2);
                (0..3).map(|c| power[c] * (0..DIRECTIONS).map(|r| off(c, r)).sum::<f64>()).sum::<f64>()
            };
            let best = off(&shared, tint.as_dvec3());
            for i in 0..1000 {
                let shares = [0, 1, 2].map(|c| points.at(i, c)[0] - 0.5);
                let other: Vec<f32> =
                    (0..DIRECTIONS).map(|r| (0..3).map(|c| shares[c] as f32 * columns[c][r]).sum()).collect();
                let square: f64 = other.iter().map(|x| f64::from(x * x)).sum();
                let dot = |c: usize| other.iter().zip(columns[c]).map(|(x, y)| f64::from(x * y)).sum::<f64>() / square;
                let found = off(&other, DVec3::from_array([0, 1, 2].map(dot)));
                assert!(best <= found * (1.0 + 1e-5), "{power}: {best} against {found}");
            }
        }
        let (shared, _) = tinted([columns[0], columns[0], columns[0]], DVec3::X);
        assert!(shared.iter().zip(columns[0]).all(|(x, y)| (x - y).abs() <= 1e-6));
    }
}

//! The Haar transform of λ0 on the device or on the host, pruned to the terms that some product reads.
//!
//! On the device, first each thread sums the coefficients of a subtree whose terms are not needed. Then each workgroup
//! computes the rotations of one subtree of gather samples. Finally, one workgroup computes the rotations above all
//! subtrees. On the host, tasks take the place of threads and workgroups.

use std::sync::Arc;

use glam::{Vec3, Vec4};
use rayon::prelude::*;

use crate::bake::compression::haar::{Haar, Pruned};
use crate::error::Result;
use crate::gpu::{Buffer, Context, Frame, HostPass};
use crate::relight::Site;
use crate::relight::visibility::interleaved::{KernelVariants, LightVectors};
use crate::shared::{GROUP_SIZE, HaarPush, HaarSumsPush, LightsConstants, Rotation};
use crate::trace::point_tree::middle;

/// The transform where products are computed.
pub enum HaarTransform {
    Device(Box<DeviceTransform>),
    Host(HostTransform),
}

/// Buffers and kernels of the transform.
pub struct DeviceTransform {
    places: Buffer<u32>,
    first_place: Buffer<u32>,
    sums: KernelVariants<HaarSumsPush>,
    rotations: Buffer<Rotation>,
    launches: Vec<Launch>,
    rotate: KernelVariants<HaarPush>,
}

/// Sums and rotations of the transform.
pub struct HostTransform {
    places: Vec<u32>,
    first_place: Vec<u32>,
    order: Order,
}

/// Subtrees that one dispatch transforms.
struct Launch {
    /// `height_count` + 1 entries per subtree; see [`HaarPush::ranges`].
    ranges: Buffer<u32>,
    subtree_count: u32,
    height_count: u32,
}

/// Maximum samples per subtree: the samples and their rotations fit into a core's cache.
const SUBTREE: usize = 256;
/// Sums that one task on the host computes, a few microseconds of work.
const SUMS_A_TASK: usize = 1024;

impl HaarTransform {
    /// Transforms coefficients to the terms that are `needed`. Sample i has coefficients `first[i]..first[i + 1]`.
    pub fn new(context: &Arc<Context>, site: Site, first: &[u32], needed: &[bool]) -> Result<Self> {
        let Pruned { places, first_place, haar } = Haar::new(first).pruned(needed);
        let host = HostTransform { places, first_place, order: Order::new(&haar, first) };
        Ok(match site {
            Site::Device => Self::Device(Box::new(DeviceTransform::new(context, &host)?)),
            Site::Host => Self::Host(host),
        })
    }

    /// Maximum number of passes on the device.
    pub fn pass_count(&self) -> usize {
        match self {
            Self::Device(transform) => 1 + transform.launches.len(),
            Self::Host(_) => 0,
        }
    }

    /// Transforms the first elements of `vector` in place, for `light_count` lights. Terms that are not needed are left
    /// undefined.
    pub fn run(&self, frame: &mut Frame, vector: &Buffer<Vec4>, light_count: usize) -> Result<()> {
        match self {
            Self::Device(transform) => transform.run(frame, vector, light_count),
            Self::Host(transform) => {
                let run = |pass: &HostPass| transform.run(&LightVectors::new(pass, vector, light_count));
                frame.host_pass("Haar transform", run)?;
            }
        }
        Ok(())
    }
}

impl HostTransform {
    fn run(&self, vectors: &LightVectors) {
        let add = |places: &[u32]| {
            for light in 0..vectors.lights {
                let sum: Vec3 = places.iter().map(|&place| vectors.get(place as usize, light)).sum();
                vectors.set(places[0] as usize, light, sum / (places.len() as f32).sqrt());
            }
        };
        let sums = self.first_place.par_windows(2).with_min_len(SUMS_A_TASK);
        sums.for_each(|range| add(&self.places[range[0] as usize..range[1] as usize]));
        let rotate = |rotation: &Rotation| {
            let [sum, term] = [rotation.sum, rotation.term].map(|place| place as usize);
            for light in 0..vectors.lights {
                let [left, right] = [sum, term].map(|place| vectors.get(place, light));
                vectors.set(sum, light, rotation.cosine * left + rotation.sine * right);
                vectors.set(term, light, rotation.sine * left - rotation.cosine * right);
            }
        };
        for launch in &self.order.launches {
            launch.par_iter().for_each(|heights| {
                let [first, end] = [heights[0], heights[heights.len() - 1]].map(|place| place as usize);
                self.order.rotations[first..end].iter().for_each(rotate);
            });
        }
    }
}

impl DeviceTransform {
    fn new(context: &Arc<Context>, HostTransform { places, first_place, order }: &HostTransform) -> Result<Self> {
        let launch = |ranges: &Vec<Vec<u32>>| -> Result<Launch> {
            Ok(Launch {
                ranges: Buffer::from_slice(context, "transfer (Haar ranges)", &ranges.concat())?,
                subtree_count: ranges.len() as u32,
                height_count: ranges.first().map_or(0, |r| r.len() as u32 - 1),
            })
        };
        Ok(Self {
            places: Buffer::from_slice(context, "transfer (Haar sums)", places)?,
            first_place: Buffer::from_slice(context, "transfer (Haar sums' places)", first_place)?,
            sums: KernelVariants::new(context, |lights| LightsConstants { lights })?,
            rotations: Buffer::from_slice(context, "transfer (Haar rotations)", &order.rotations)?,
            launches: order.launches.iter().map(launch).collect::<Result<_>>()?,
            rotate: KernelVariants::new(context, |lights| LightsConstants { lights })?,
        })
    }

    fn run(&self, frame: &mut Frame, vector: &Buffer<Vec4>, light_count: usize) {
        if !self.places.is_empty() {
            let mut pass = frame.pass("Haar transform");
            let push = HaarSumsPush {
                places: pass.read(&self.places),
                first_place: pass.read(&self.first_place),
                vector: pass.write(vector),
                sum_count: self.first_place.len() as u32 - 1,
                unused: 0,
            };
            pass.dispatch(self.sums.get(light_count), &push, push.sum_count);
        }
        for launch in &self.launches {
            let mut pass = frame.pass("Haar transform");
            let push = HaarPush {
                rotations: pass.read(&self.rotations),
                ranges: pass.read(&launch.ranges),
                vector: pass.exchange(vector),
                subtree_count: launch.subtree_count,
                height_count: launch.height_count,
            };
            pass.dispatch(self.rotate.get(light_count), &push, launch.subtree_count * GROUP_SIZE);
        }
    }
}

/// Rotations in order of execution.
struct Order {
    rotations: Vec<Rotation>,
    /// `[launch][subtree]`: start of the rotations of each height, then the end of the last ones.
    launches: Vec<Vec<Vec<u32>>>,
}

impl Order {
    /// Sample i has coefficients `first[i]..first[i + 1]`.
    fn new(haar: &Haar, first: &[u32]) -> Self {
        let samples = first.len().saturating_sub(1);
        let mut ends = Vec::new();
        subtrees(0, samples, &mut ends);
        let subtree_of = |place: u32| {
            let sample = first.partition_point(|&f| f <= place) - 1;
            ends.partition_point(|&end| end <= sample)
        };
        // Rotations above all subtrees come last, as one more subtree.
        let top = ends.len();
        let mut keyed: Vec<(usize, usize, Rotation)> = Vec::new();
        for (height, range) in haar.heights.windows(2).enumerate() {
            for rotation in &haar.rotations[range[0]..range[1]] {
                let [sum, term] = [rotation.sum, rotation.term].map(subtree_of);
                keyed.push((if sum == term { sum } else { top }, height, *rotation));
            }
        }
        keyed.sort_by_key(|(subtree, height, _)| (*subtree, *height));
        let heights = |subtrees: std::ops::Range<usize>| {
            let of_these: Vec<usize> =
                keyed.iter().filter(|(s, ..)| subtrees.contains(s)).map(|(_, height, _)| *height).collect();
            let (lowest, highest) = (of_these.iter().min(), of_these.iter().max());
            let heights = lowest.zip(highest).map_or(0..0, |(lowest, highest)| *lowest..highest + 1);
            let begin =
                |subtree: usize, height: usize| keyed.partition_point(|(s, h, _)| (*s, *h) < (subtree, height)) as u32;
            let ranges = |subtree: usize| (heights.start..=heights.end).map(|h| begin(subtree, h)).collect();
            if heights.is_empty() { Vec::new() } else { subtrees.map(ranges).collect::<Vec<Vec<u32>>>() }
        };
        let launches = [heights(0..top), heights(top..top + 1)].into_iter().filter(|l| !l.is_empty()).collect();
        Self { launches, rotations: keyed.into_iter().map(|(_, _, rotation)| rotation).collect() }
    }
}

/// Appends the end of each maximal subtree of at most [`SUBTREE`] samples to `ends`.
fn subtrees(first: usize, end: usize, ends: &mut Vec<usize>) {
    if end - first <= SUBTREE {
        ends.push(end);
        return;
    }
    let middle = middle(first, end);
    subtrees(first, middle, ends);
    subtrees(middle, end, ends);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gpu::SharedFloat;

    /// Executing the rotations of each subtree by height gives the transform, whatever the order of subtrees.
    #[test]
    fn subtrees_and_what_is_above_them_are_the_whole_transform() {
        for samples in [0, 1, 2, 255, 256, 257, 1000, 5003] {
            let mut first = vec![0];
            (0..samples).for_each(|i| first.push(first[i] + [1, 4, 1, 9, 16, 0][i % 5]));
            let length = first[samples] as usize;
            let whole = Haar::new(&first);
            let some: Vec<bool> = (0..length).map(|i| i % 7 == 3).collect();
            for haar in [&whole, &whole.pruned(&some).haar] {
                let order = Order::new(haar, &first);
                let mut values: Vec<[f32; 1]> = (0..length).map(|i| [(i as f32 * 0.37).sin()]).collect();
                let mut want = values.clone();
                haar.transform(&mut want);
                for launch in &order.launches {
                    for ranges in launch.iter().rev() {
                        for r in &order.rotations[ranges[0] as usize..ranges[ranges.len() - 1] as usize] {
                            let (left, right) = (values[r.sum as usize][0], values[r.term as usize][0]);
                            values[r.sum as usize] = [r.cosine * left + r.sine * right];
                            values[r.term as usize] = [r.sine * left - r.cosine * right];
                        }
                    }
                }
                assert_eq!(values, want, "{samples} samples");
            }
            // On the host, of the second of two lights; the first one is dark.
            let value = |i: usize| (i as f32 * 0.37).sin();
            let mut want: Vec<[f32; 3]> = (0..length).map(|i| [value(i), 1.0, 0.0]).collect();
            let mut floats: Vec<f32> = want.iter().flat_map(|&[r, g, b]| [0.0, 0.0, 0.0, 5.0, r, g, b, 5.0]).collect();
            whole.transform(&mut want);
            let Pruned { places, first_place, haar } = whole.pruned(&some);
            let transform = HostTransform { places, first_place, order: Order::new(&haar, &first) };
            transform.run(&LightVectors { floats: SharedFloat::of(&mut floats), places: 2, lights: 2 });
            for (i, got) in floats.chunks(8).enumerate().filter(|(i, _)| some[*i]) {
                assert!(got[..3] == [0.0; 3] && got[3] == 5.0 && got[7] == 5.0);
                assert!((0..3).all(|c| (got[4 + c] - want[i][c]).abs() < 1e-4), "{got:?}, want {:?}", want[i]);
            }
        }
    }
}

//! Images of area lights: they get more points until their image changes little.

use glam::Vec3;

use super::{Detail, LightCache, LightPoints, Node, Shade, Source, Step, Term};
use crate::scene::{Light, LightKind};

/// Points of the lattices of an area light: those of each join those before. The last one is for domes alone, of
/// which a room with a window sees little.
const LATTICES: [u32; 3] = [256, 1024, 4096];
/// Points after which the image of an area light is kept, for a comparison at the next number. The first points
/// of a lattice, a power of two of them, are spread evenly.
const CHECKPOINTS: [u32; 6] = [128, 256, 512, 1280, 2304, 5376];
/// An image has enough points if from one checkpoint to the next it changed by less: root mean square, relative to the
/// image.
const LEAST_CHANGE: f32 = 0.01;
/// Points of which the mean is better than interleaved points.
const SHOWN_POINTS: u32 = 32;
/// Points of a light that are shaded in one step.
pub const POINTS_A_STEP: u32 = 8;

impl Node {
    /// Of a leaf: whether its image is compared with the one that has its next points.
    pub(super) fn is_at_checkpoint(&self) -> bool {
        self.needed.is_none() && CHECKPOINTS.contains(&self.points)
    }
}

impl LightCache {
    /// Plans at most `most` steps towards the exact image of a light, each with some of its points, and none beyond a
    /// comparison; returns the slot of the image to show.
    pub(super) fn add_points(&mut self, leaf: usize, light: usize, most: u32, steps: &mut Vec<Step>) -> usize {
        let detail = self.detail;
        let slot = match self.nodes[leaf].slot {
            Some(slot) => {
                self.slots.use_at(slot, self.clock);
                slot
            }
            None => {
                let slot = self.take_slot(leaf);
                let Light { kind, material, .. } = &self.rig.lights[light];
                let is_punctual = self.rig.lights[light].is_punctual();
                let is_interleaved = !is_punctual && detail != Detail::Exact;
                self.compared = self.compared.filter(|&compared| compared != leaf);
                let node = &mut self.nodes[leaf];
                (node.points, node.is_interleaved) = (0, is_interleaved);
                if is_punctual {
                    (node.points, node.needed) = (1, Some(1));
                }
                if is_punctual || is_interleaved {
                    node.coarse = detail == Detail::Coarse || is_interleaved;
                    if *kind == LightKind::Emitter {
                        node.coarse = false;
                        let image = material.as_ref().and_then(|material| self.emitters.get(material));
                        let term = |&image: &usize| Term { source: Source::Emitter(image), scale: Vec3::ONE };
                        let terms = image.map(term).into_iter().collect();
                        steps.push(Step::Sum { target: Source::Slot(slot), terms, kept: 0.0 });
                        return slot;
                    }
                    let points = if is_punctual { LightPoints::One } else { LightPoints::Interleaved };
                    steps.push(Step::Shade(Shade { light, target: Source::Slot(slot), detail, points }));
                    return slot;
                }
                slot
            }
        };
        if detail == Detail::Coarse || self.nodes[leaf].is_complete() {
            return slot;
        }
        let target = self.growing_slot(leaf, slot);
        let image = Source::Slot(target);
        let node = &mut self.nodes[leaf];
        for _ in 0..most {
            let first = node.points;
            if node.needed == Some(first) {
                break;
            }
            if node.is_at_checkpoint() {
                if self.compared.is_some_and(|compared| compared != leaf) {
                    break;
                }
                self.compared = Some(leaf);
                let terms = vec![Term { source: image, scale: Vec3::ONE }];
                steps.push(Step::Sum { target: Source::Checkpoint, terms, kept: 0.0 });
            }
            node.points += POINTS_A_STEP;
            node.coarse = node.needed != Some(node.points);
            let points = of_lattice(first, node.points);
            if first == 0 {
                steps.push(Step::Shade(Shade { light, target: image, detail, points }));
                continue;
            }
            steps.push(Step::Shade(Shade { light, target: Source::SomePoints, detail, points }));
            let [kept, added] = [first, POINTS_A_STEP].map(|points| points as f32 / node.points as f32);
            let terms = vec![Term { source: Source::SomePoints, scale: Vec3::splat(added) }];
            steps.push(Step::Sum { target: image, terms, kept });
            if node.is_at_checkpoint() && self.compared == Some(leaf) {
                steps.push(Step::Compare { light, image });
                break;
            }
        }
        if target != slot && node.points < SHOWN_POINTS {
            return slot;
        }
        (node.slot, node.growing, node.is_interleaved) = (Some(target), None, false);
        if target != slot {
            self.slots.clear(slot);
        }
        target
    }

    /// Whether a leaf's image lacks points that it can get now.
    pub(super) fn gets_points(&self, leaf: usize) -> bool {
        let waits = self.nodes[leaf].is_at_checkpoint() && self.compared.is_some_and(|compared| compared != leaf);
        self.detail != Detail::Coarse && !self.nodes[leaf].is_complete() && !waits
    }

    /// Points of an incomplete leaf's image when it will be shown, compared or complete next.
    pub(super) fn stage(&self, leaf: usize) -> u32 {
        let Node { points, needed, .. } = self.nodes[leaf];
        let next = std::iter::once(SHOWN_POINTS).chain(CHECKPOINTS).find(|&next| next > points);
        needed.into_iter().chain(next).min().expect("no image has the points of all lattices and lacks some")
    }

    /// Tells what a [`Step::Compare`] found: how much the image of a light changed since the checkpoint before; root
    /// mean square, relative to the image.
    pub fn set_change(&mut self, light: usize, change: f32) {
        let node = &mut self.nodes[self.leaf_of[light]];
        let lattices = if self.rig.lights[light].kind == LightKind::Dome { &LATTICES[..] } else { &LATTICES[..2] };
        if change <= LEAST_CHANGE || node.points == lattices.iter().sum::<u32>() {
            (node.needed, node.coarse) = (Some(node.points), false);
            self.compared = None;
            self.release_above(self.leaf_of[light]);
            self.rest = None;
        }
    }

    /// An area light of the whole picture, of which it is not known how many points it needs.
    pub fn undecided(&self) -> Option<usize> {
        (0..self.leaf_of.len()).find(|&light| self.is_undecided(light) && self.is_on(self.leaf_of[light]))
    }

    /// Whether it is not known how many points a light needs.
    pub fn is_undecided(&self, light: usize) -> bool {
        self.nodes[self.leaf_of[light]].needed.is_none() && !self.rig.lights[light].is_punctual()
    }

    /// Lets other lights be compared if the one that is adds nothing to the picture: it gets no more points.
    pub(super) fn stop_comparing_dark(&mut self) {
        self.compared = self.compared.filter(|&leaf| self.is_on(leaf));
    }

    fn is_on(&self, leaf: usize) -> bool {
        let above = std::iter::successors(Some(leaf), |&n| self.nodes[n].parent);
        above.map(|n| self.scale(n)).product::<Vec3>() != Vec3::ZERO
    }

    /// Slot in which the exact image of a leaf grows: another one than that of the image to show, `shown`, if that has
    /// interleaved points and a slot is empty.
    fn growing_slot(&mut self, leaf: usize, shown: usize) -> usize {
        if !self.nodes[leaf].is_interleaved {
            return shown;
        }
        let growing = self.nodes[leaf].growing.or_else(|| self.slots.take_empty(leaf, self.clock));
        self.nodes[leaf].growing = growing;
        growing.inspect(|&slot| self.slots.use_at(slot, self.clock)).unwrap_or(shown)
    }
}

/// The points from `first` to before `end` of the lattices, one after another. They are of one lattice.
fn of_lattice(first: u32, end: u32) -> LightPoints {
    let mut before = 0;
    for of in LATTICES {
        if first < before + of {
            return LightPoints::Some { first: first - before, end: end - before, of };
        }
        before += of;
    }
    unreachable!("{first} is beyond all lattices")
}

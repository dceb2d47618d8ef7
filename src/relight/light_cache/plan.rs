//! Plans: images to shade, sums, and the terms of the picture.

use std::collections::HashSet;

use glam::Vec3;

/// One image of a sum.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Term {
    pub source: Source,
    pub scale: Vec3,
}

/// Where an image is stored.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Source {
    Slot(usize),
    /// The sum of all that is not in the focus.
    Rest,
    /// An emitter as its material says, which no edit changes.
    Emitter(usize),
    /// The mean over some points of an area light, before it joins the image of the light.
    SomePoints,
    /// The image of an area light when it had fewer points.
    Checkpoint,
    /// What final gathering adds to the image of a light, by its number; see
    /// [`LightChanges`](crate::relight::LightChanges).
    Change(u64),
}

/// Accuracy of a light's image.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Detail {
    #[default]
    Exact,
    /// As exact, but area lights begin with interleaved points, and each picture adds some points: the next one
    /// is better.
    Progressive,
    /// Fast: one shadow ray per four samples if rays are traced, interleaved points, and only a part of the compressed
    /// transfer.
    Coarse,
}

/// Shade `light` at unit intensity into `target`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Shade {
    pub light: usize,
    pub target: Source,
    pub detail: Detail,
    pub points: LightPoints,
}

/// The points by which a light is shaded.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LightPoints {
    /// The only one, of a punctual light.
    One,
    /// Some for all view samples together, of an area light that moves: each sample sees another one.
    Interleaved,
    /// `first..end` of the `of` points that an area light is made of, for each view sample.
    Some { first: u32, end: u32, of: u32 },
}

impl LightPoints {
    /// Points that one view sample sees.
    pub fn count(&self) -> usize {
        match *self {
            Self::One | Self::Interleaved => 1,
            Self::Some { first, end, .. } => (end - first) as usize,
        }
    }
}

/// One step of a [`Plan`].
#[derive(Clone, Debug, PartialEq)]
pub enum Step {
    Shade(Shade),
    /// Sum `terms` into `target`, and `kept` times its previous contents.
    Sum {
        target: Source,
        terms: Vec<Term>,
        kept: f32,
    },
    /// Measure how much the image of a light changed since [`Source::Checkpoint`].
    Compare {
        light: usize,
        image: Source,
    },
    /// Draw one light's contribution, or an empty cell, on the contact sheet.
    Show {
        cell: usize,
        term: Option<Term>,
    },
}

impl Step {
    pub fn as_shade(&self) -> Option<&Shade> {
        match self {
            Self::Shade(shade) => Some(shade),
            _ => None,
        }
    }
}

/// Steps that compute images, and the picture as a sum of images.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Plan {
    pub steps: Vec<Step>,
    /// Terms whose sum is the picture.
    pub picture: Vec<Term>,
}

impl Plan {
    /// The light that it compares; each plan compares at most one.
    pub fn compared_light(&self) -> Option<usize> {
        self.steps.iter().find_map(|step| if let Step::Compare { light, .. } = step { Some(*light) } else { None })
    }

    /// Moves each shade forward past steps that do not touch its target, so that shades are adjacent. Several lights
    /// together take half the time in the transfer that they take one by one.
    pub fn batch_shades(&mut self) {
        let mut together = Vec::with_capacity(self.steps.len());
        let mut later = Vec::new();
        // Images that the steps in `later` touch.
        let mut touched = HashSet::new();
        for step in self.steps.drain(..) {
            match &step {
                Step::Shade(shade) => {
                    if touched.contains(&shade.target) {
                        together.append(&mut later);
                        touched.clear();
                    }
                    together.push(step);
                    continue;
                }
                Step::Sum { target, terms, .. } => {
                    touched.extend(terms.iter().map(|term| term.source).chain([*target]));
                }
                Step::Compare { image, .. } => touched.extend([*image, Source::Checkpoint]),
                Step::Show { term, .. } => touched.extend(term.iter().map(|term| term.source)),
            }
            later.push(step);
        }
        together.append(&mut later);
        self.steps = together;
    }
}

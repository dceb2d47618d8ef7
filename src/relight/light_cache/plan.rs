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
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Source {
    Slot(usize),
    /// The sum of all that is not in the focus.
    Rest,
    /// Emission, which no edit changes.
    Emission,
}

/// Accuracy of a light's image.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Detail {
    #[default]
    Exact,
    /// Fast: one shadow ray per four samples if rays are traced, and only a part of the compressed transfer.
    Coarse,
}

/// Shade `light` at unit intensity into `slot`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Shade {
    pub light: usize,
    pub slot: usize,
    pub detail: Detail,
}

/// One step of a [`Plan`].
#[derive(Clone, Debug, PartialEq)]
pub enum Step {
    Shade(Shade),
    /// Sum `terms` into `target`; `accumulate` adds to its previous contents.
    Sum {
        target: Source,
        terms: Vec<Term>,
        accumulate: bool,
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
    /// Moves each shade forward past steps that do not touch its slot, so that shades are adjacent. Several lights
    /// together take half the time in the transfer that they take one by one.
    pub fn batch_shades(&mut self) {
        let mut together = Vec::with_capacity(self.steps.len());
        let mut later = Vec::new();
        // Slots that the steps in `later` touch.
        let mut touched = HashSet::new();
        for step in self.steps.drain(..) {
            match &step {
                Step::Shade(shade) => {
                    if touched.contains(&shade.slot) {
                        together.append(&mut later);
                        touched.clear();
                    }
                    together.push(step);
                    continue;
                }
                Step::Sum { target, terms, .. } => {
                    touched.extend(terms.iter().map(|term| term.source).chain([*target]).filter_map(slot));
                }
                Step::Show { term, .. } => touched.extend(term.iter().filter_map(|term| slot(term.source))),
            }
            later.push(step);
        }
        together.append(&mut later);
        self.steps = together;
    }
}

fn slot(source: Source) -> Option<usize> {
    match source {
        Source::Slot(slot) => Some(slot),
        Source::Rest | Source::Emission => None,
    }
}

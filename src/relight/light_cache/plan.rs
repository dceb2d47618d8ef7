//! What a frame has to do: shades, sums, and the picture of these.

use std::collections::HashSet;

use glam::Vec3;

/// One image of a sum.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Term {
    pub source: Source,
    pub scale: Vec3,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Source {
    Slot(usize),
    /// The sum of all that is not being edited.
    Rest,
    /// Emitters, which never change.
    Emission,
}

/// How closely the image of a light is made.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Detail {
    #[default]
    Exact,
    /// In a hurry: one shadow ray for four samples where rays are traced, and a part of the compressed transfer.
    Coarse,
}

/// Shade `light` at unit intensity into `slot`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Shade {
    pub light: usize,
    pub slot: usize,
    pub detail: Detail,
}

/// A step towards the picture, in the order of [`Plan::steps`].
#[derive(Clone, Debug, PartialEq)]
pub enum Step {
    Shade(Shade),
    /// Sum `terms` into `target`, in addition to what is there if `accumulate`.
    Sum {
        target: Source,
        terms: Vec<Term>,
        accumulate: bool,
    },
    /// Put one light's share, or nothing, into a cell of the contact sheet.
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

/// What a frame has to do.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Plan {
    pub steps: Vec<Step>,
    /// The picture is the sum of these.
    pub picture: Vec<Term>,
}

impl Plan {
    /// Brings each shade forward past the steps that do not touch its slot: several lights together pass through the transfer for
    /// half of what they take one by one.
    pub fn bring_shades_together(&mut self) {
        let mut together = Vec::with_capacity(self.steps.len());
        let mut later = Vec::new();
        // Slots that those touch which come later.
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

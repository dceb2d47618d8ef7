//! Lights are shaded together where that changes no image: several pass through the transfer for little more than one.

use super::{Plan, Source, Step};

impl Plan {
    /// Brings each shade forward past the steps that do not touch its slot.
    pub fn bring_shades_together(&mut self) {
        let mut together = Vec::with_capacity(self.steps.len());
        let mut later = Vec::new();
        // Slots that those touch which come later.
        let mut touched = std::collections::HashSet::new();
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

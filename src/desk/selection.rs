//! The selection: lights that are edited together.

/// Distinct indices of lights. The last one is the primary light: the panel shows its values, and edits of it apply to
/// the others.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Selection {
    lights: Vec<usize>,
}

impl Selection {
    pub fn only(light: usize) -> Self {
        Self { lights: vec![light] }
    }

    pub fn of(lights: impl IntoIterator<Item = usize>) -> Self {
        let mut selection = Self::default();
        lights.into_iter().for_each(|light| selection.add(light));
        selection
    }

    pub fn primary(&self) -> Option<usize> {
        self.lights.last().copied()
    }

    pub fn contains(&self, light: usize) -> bool {
        self.lights.contains(&light)
    }

    pub fn len(&self) -> usize {
        self.lights.len()
    }

    pub fn is_empty(&self) -> bool {
        self.lights.is_empty()
    }

    /// Iterates over the indices, the primary last.
    pub fn iter(&self) -> impl DoubleEndedIterator<Item = usize> + '_ {
        self.lights.iter().copied()
    }

    /// Adds `light` as the primary.
    pub fn add(&mut self, light: usize) {
        self.lights.retain(|&other| other != light);
        self.lights.push(light);
    }

    /// Adds `light` as the primary, or removes it.
    pub fn toggle(&mut self, light: usize) {
        match self.contains(light) {
            true => self.lights.retain(|&other| other != light),
            false => self.lights.push(light),
        }
    }

    /// Adds the range from the primary to `light`, which becomes the primary.
    pub fn extend_to(&mut self, light: usize) {
        let from = self.primary().unwrap_or(light);
        let range = from.min(light)..=from.max(light);
        match from <= light {
            true => range.for_each(|one| self.add(one)),
            false => range.rev().for_each(|one| self.add(one)),
        }
    }

    /// Removes indices of `light_count` and above.
    pub fn within(mut self, light_count: usize) -> Self {
        self.lights.retain(|&light| light < light_count);
        self
    }
}

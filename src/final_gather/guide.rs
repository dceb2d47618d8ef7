//! Which photons matter for the picture [Peter 1998].

use crate::physics::distribution::GridDistribution;

/// Density of the photons that leave a source: over the unit square of their directions or, from a source without a
/// place, of where they cross the scene.
pub struct Guide {
    /// Of each cell of a grid, rows first: what photons of it sent to the picture.
    values: Vec<f64>,
    distribution: GridDistribution,
}

/// Rows and columns of the grid.
const SIDE: usize = 32;
/// Share of the photons that leave evenly.
const EVENLY: f64 = 0.2;

impl Default for Guide {
    fn default() -> Self {
        Self { values: vec![0.0; SIDE * SIDE], distribution: GridDistribution::new([1, 1], |_, _| 1.0) }
    }
}

impl Guide {
    /// A place in the unit square for even numbers in it, and its density.
    pub fn draw(&self, even: [f64; 2]) -> ([f64; 2], f64) {
        self.distribution.warp(even)
    }

    /// Adds what photons sent to the picture, by their places.
    pub fn learn(&mut self, photons: impl Iterator<Item = ([f64; 2], f64)>) {
        let cell = |along: f64| ((along * SIDE as f64) as usize).min(SIDE - 1);
        photons.for_each(|([u, v], value)| self.values[cell(u) * SIDE + cell(v)] += value);
        let total: f64 = self.values.iter().sum();
        if total <= 0.0 {
            return;
        }
        // Means of 3x3 cells: a few photons tell of the neighbours, too. Columns go round.
        let mean = |column: usize, row: usize| {
            let rows = row.saturating_sub(1)..(row + 2).min(SIDE);
            let count = 3.0 * rows.len() as f64;
            let columns = [SIDE - 1, 0, 1].map(|by| (column + by) % SIDE);
            rows.flat_map(|row| columns.map(|column| self.values[row * SIDE + column])).sum::<f64>() / count
        };
        let evenly = EVENLY / (1.0 - EVENLY) * total / (SIDE * SIDE) as f64;
        self.distribution = GridDistribution::new([SIDE; 2], |column, row| mean(column, row) + evenly);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn photons_go_where_they_count() {
        let mut guide = Guide::default();
        assert_eq!(guide.draw([0.3, 0.7]), ([0.3, 0.7], 1.0));
        guide.learn([([0.5, 0.99], 2.0), ([0.5, 0.01], 0.0)].into_iter());
        let (mut near, mut all) = (0, 0.0);
        for i in 0..1 << 16 {
            let even = [f64::from(i / 256) + 0.5, f64::from(i % 256) + 0.5].map(|x| x / 256.0);
            let ([u, v], density) = guide.draw(even);
            near += u32::from((u - 0.5).abs() < 0.07 && !(0.07..0.9).contains(&v));
            all += 1.0 / density;
        }
        assert!((0.75..0.9).contains(&(f64::from(near) / 65536.0)), "{near}");
        // The mean of inverse densities is the area.
        assert!((all / 65536.0 - 1.0).abs() < 0.02, "{all}");
    }
}

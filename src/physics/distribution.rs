//! Piecewise constant distributions on a grid, by cumulative sums.

use rayon::prelude::*;

/// Cells of a grid, each with a share of the whole; rows first.
#[derive(Clone, Debug)]
pub struct GridDistribution {
    columns: usize,
    /// Shares of the rows before each row, and 1.
    rows: Vec<f64>,
    /// For each row, shares of its cells up to each.
    cells: Vec<f64>,
}

/// A place in a grid: a cell, and how far it is into it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GridPlace {
    /// Column and row.
    pub cell: [usize; 2],
    /// From 0 to 1, along the row and along the column.
    pub within: [f64; 2],
}

impl GridDistribution {
    /// `weight` of the cell in a column and a row: not negative. If all are 0, or all of a row, they have equal shares.
    pub fn new([columns, rows]: [usize; 2], weight: impl Fn(usize, usize) -> f64 + Sync) -> Self {
        let cumulative = |weights: &[f64]| {
            let total: f64 = weights.iter().sum();
            let mut sum = 0.0;
            let shares = weights.iter().zip(1..).map(|(weight, count)| {
                sum += weight;
                if total > 0.0 { sum / total } else { f64::from(count) / weights.len() as f64 }
            });
            (shares.collect::<Vec<f64>>(), total)
        };
        let row = |y: usize| cumulative(&(0..columns).map(|x| weight(x, y)).collect::<Vec<f64>>());
        let (cells, totals): (Vec<Vec<f64>>, Vec<f64>) = (0..rows).into_par_iter().map(row).unzip();
        let (up_to, _) = cumulative(&totals);
        Self { columns, rows: [0.0].into_iter().chain(up_to).collect(), cells: cells.concat() }
    }

    /// Columns and rows.
    pub fn size(&self) -> [usize; 2] {
        [self.columns, self.rows.len() - 1]
    }

    /// Maps the unit square to the grid such that each cell gets an area of its share. u selects the row.
    pub fn draw(&self, [u, v]: [f64; 2]) -> GridPlace {
        let [columns, rows] = self.size();
        let y = (self.rows.partition_point(|&before| before <= u).max(1) - 1).min(rows - 1);
        let row = &self.cells[y * columns..][..columns];
        let x = row.partition_point(|&up_to| up_to <= v).min(columns - 1);
        let [before, up_to] = self.bounds([x, y]);
        let within_row = (u - self.rows[y]) / (self.rows[y + 1] - self.rows[y]);
        let within = [(v - before) / (up_to - before), within_row].map(|t| t.clamp(0.0, 1.0));
        GridPlace { cell: [x, y], within }
    }

    /// The inverse of [`Self::draw`].
    pub fn invert(&self, place: &GridPlace) -> [f64; 2] {
        let y = place.cell[1];
        let [before, up_to] = self.bounds(place.cell);
        let [within_cell, within_row] = place.within;
        [self.rows[y] + within_row * (self.rows[y + 1] - self.rows[y]), before + within_cell * (up_to - before)]
    }

    /// Maps the unit square to itself: each cell of an even grid gets its share of the area. Also returns the density
    /// at the new place.
    pub fn warp(&self, at: [f64; 2]) -> ([f64; 2], f64) {
        let GridPlace { cell, within } = self.draw(at);
        let along = |axis: usize| (cell[axis] as f64 + within[axis]) / self.size()[axis] as f64;
        ([along(1), along(0)], self.cell_density(cell))
    }

    /// Density of [`Self::warp`] at a place in the unit square.
    pub fn warp_density(&self, [u, v]: [f64; 2]) -> f64 {
        let [columns, rows] = self.size();
        self.cell_density([(v, columns), (u, rows)].map(|(at, count)| ((at * count as f64) as usize).min(count - 1)))
    }

    fn cell_density(&self, cell: [usize; 2]) -> f64 {
        self.share(cell) * self.cells.len() as f64
    }

    /// Share of a cell.
    pub fn share(&self, cell: [usize; 2]) -> f64 {
        let [before, up_to] = self.bounds(cell);
        (up_to - before) * (self.rows[cell[1] + 1] - self.rows[cell[1]])
    }

    /// Shares of a row before and up to a cell.
    fn bounds(&self, [x, y]: [usize; 2]) -> [f64; 2] {
        let row = &self.cells[y * self.columns..][..self.columns];
        [if x > 0 { row[x - 1] } else { 0.0 }, row[x]]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cells_get_their_share_of_the_square() {
        let grid = GridDistribution::new([5, 3], |x, y| if y == 1 { 0.0 } else { (x * (y + 1)) as f64 });
        let total = 10.0 + 30.0;
        let mut found = [[0u32; 5]; 3];
        for i in 0..1 << 16 {
            let at = [f64::from(i / 256) + 0.5, f64::from(i % 256) + 0.5].map(|x| x / 256.0);
            let place = grid.draw(at);
            found[place.cell[1]][place.cell[0]] += 1;
            let back = grid.invert(&place);
            assert!((back[0] - at[0]).abs() + (back[1] - at[1]).abs() < 1e-12, "{at:?}: {back:?}");
        }
        for (y, row) in found.iter().enumerate() {
            for (x, &count) in row.iter().enumerate() {
                let want = if y == 1 { 0.0 } else { (x * (y + 1)) as f64 / total };
                assert!((grid.share([x, y]) - want).abs() < 1e-12);
                assert!((f64::from(count) / 65536.0 - want).abs() < 0.005, "{x}, {y}: {count}");
            }
        }
    }

    #[test]
    fn without_weights_all_cells_are_alike() {
        let grid = GridDistribution::new([4, 2], |_, _| 0.0);
        assert!((0..8).all(|i| grid.share([i % 4, i / 4]) == 0.125));
    }
}

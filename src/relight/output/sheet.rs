//! The contact sheet: each light's contribution to the picture, side by side.

use glam::{UVec2, Vec3};

use super::{Output, Outputs};
use crate::gpu::Frame;
use crate::relight::light_cache::{Plan, Shade, Source, Step, Term};
use crate::relight::passes::FrameResources;
use crate::shared::{SheetPush, SumTerm};

/// Layout of the cells: row by row, n x n cells with the smallest n that fits all lights.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Grid {
    columns: u32,
    size: [u32; 2],
}

impl Grid {
    /// `size`: width and height of the picture, pixels.
    pub fn new(light_count: usize, size: [u32; 2]) -> Self {
        let columns = (1..).find(|&columns: &u32| columns as usize * columns as usize >= light_count);
        Self { columns: columns.expect("some number is large enough"), size }
    }

    /// Number of cells, empty ones included.
    pub fn len(self) -> usize {
        (self.columns * self.columns) as usize
    }

    pub fn is_empty(self) -> bool {
        self.len() == 0
    }

    /// Left, top, width and height of a cell, pixels. The cells cover the picture without overlap.
    pub fn cell(self, index: usize) -> [u32; 4] {
        let (column, row) = (index as u32 % self.columns, index as u32 / self.columns);
        let edge = |axis: usize, i: u32| self.size[axis] * i / self.columns;
        let [left, top] = [edge(0, column), edge(1, row)];
        [left, top, edge(0, column + 1) - left, edge(1, row + 1) - top]
    }

    /// Index of the cell that contains a pixel.
    pub fn at(self, [x, y]: [u32; 2]) -> Option<usize> {
        (0..self.len()).find(|&index| {
            let [left, top, width, height] = self.cell(index);
            (left..left + width).contains(&x) && (top..top + height).contains(&y)
        })
    }
}

/// What each cell currently shows.
#[derive(Default)]
pub(in crate::relight) struct Sheet {
    output: Option<Output>,
    cells: Vec<Option<Term>>,
}

impl Sheet {
    /// Removes cells from a plan that are already up to date.
    pub fn remove_unchanged(&mut self, plan: &mut Plan, output: &Output) {
        let cells = plan.steps.iter().filter(|step| matches!(step, Step::Show { .. })).count();
        if self.output.as_ref() != Some(output) || self.cells.len() != cells {
            (self.output, self.cells) = (Some(output.clone()), vec![None; cells]);
        }
        let mut changed = Vec::new();
        plan.steps.retain(|step| match *step {
            Step::Shade(Shade { target, .. }) | Step::Sum { target, .. } => {
                changed.push(target);
                true
            }
            Step::Compare { .. } => true,
            Step::Show { cell, term } => {
                let is_new = term.is_some_and(|term| changed.contains(&term.source));
                // `None` means never drawn; a drawn cell without light has a term of scale 0.
                let term = term.unwrap_or(Term { source: Source::Rest, scale: Vec3::ZERO });
                self.cells[cell].replace(term) != Some(term) || is_new
            }
        });
    }

    /// Invalidates all cells: the pixels were overwritten.
    pub fn invalidate(&mut self) {
        self.output = None;
    }
}

impl FrameResources<'_> {
    /// Draws one light's contribution, or black, into its cell.
    pub(in crate::relight) fn show(
        &self,
        frame: &mut Frame,
        cell: usize,
        term: Option<Term>,
        outputs: &Outputs,
        output: &Output,
    ) {
        let tiling = self.framebuffer.tiling;
        let [left, top, width, height] = Grid::new(self.rig.lights.len(), [tiling.width, tiling.height]).cell(cell);
        if width == 0 || height == 0 {
            return; // more lights than pixels
        }
        let mut pass = frame.pass("contact sheet");
        let blank: SumTerm = bytemuck::Zeroable::zeroed();
        let push = SheetPush {
            term_count: u32::from(term.is_some()),
            term: term.map_or(blank, |term| output.exposed(self.read_terms(&mut pass, &[term])[0])),
            target: pass.write(outputs.pixels(output)),
            display_table: outputs.display_table(output).map_or(bytemuck::Zeroable::zeroed(), |table| pass.read(table)),
            size: UVec2::new(tiling.width, tiling.height),
            corner: UVec2::new(left, top),
            cell: UVec2::new(width, height),
            blue_first: u32::from(output.is_blue_first()),
        };
        pass.dispatch_tiles(outputs.sheet_kernel(output), &push, [width, height]);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cells_cover_the_picture_once() {
        for lights in [0, 1, 2, 4, 5, 16, 17, 100] {
            let grid = Grid::new(lights, [73, 41]);
            assert!(grid.len() >= lights);
            let mut covered = vec![0; 73 * 41];
            for index in 0..grid.len() {
                let [left, top, width, height] = grid.cell(index);
                for y in top..top + height {
                    for x in left..left + width {
                        covered[(y * 73 + x) as usize] += 1;
                        assert_eq!(grid.at([x, y]), Some(index));
                    }
                }
            }
            assert!(covered.iter().all(|&count| count == 1), "{lights} lights");
        }
    }
}

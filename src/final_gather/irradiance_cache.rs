//! Irradiance of surfaces by photons, in cells.

use glam::Vec3;

use super::photons::Landing;
use super::surface_cells::SurfaceCells;

/// Mean irradiance of cells from each source at unit strength, over all photons so far.
pub struct IrradianceCache {
    sources: usize,
    /// Sums over rounds of photons, by cell and source: light that was reflected before.
    reflected: Vec<Vec3>,
    /// The same for light straight from the source: greatest channel.
    direct: Vec<f32>,
    /// 1 / number of rounds.
    share: f32,
    rounds: u32,
}

impl IrradianceCache {
    pub fn new(cells: &SurfaceCells, sources: usize) -> Self {
        let count = cells.len() * sources;
        Self { sources, reflected: vec![Vec3::ZERO; count], direct: vec![0.0; count], share: 0.0, rounds: 0 }
    }

    /// Adds light that was reflected before from a round of photons, which is an estimate of its own.
    pub fn add_reflected(&mut self, cells: &SurfaceCells, landings: &[Landing]) {
        self.land(cells, landings, |cache, at, irradiance| cache.reflected[at] += irradiance, false);
        self.rounds += 1;
        self.share = 1.0 / self.rounds as f32;
    }

    /// Adds direct light from a round of photons.
    pub fn add_direct(&mut self, cells: &SurfaceCells, landings: &[Landing]) {
        self.land(cells, landings, |cache, at, irradiance| cache.direct[at] += irradiance.max_element(), true);
    }

    fn land(
        &mut self,
        cells: &SurfaceCells,
        landings: &[Landing],
        add: impl Fn(&mut Self, usize, Vec3),
        is_direct: bool,
    ) {
        for &Landing { cell, source, power, .. } in landings.iter().filter(|landing| landing.is_direct == is_direct) {
            add(self, cell as usize * self.sources + source as usize, power / cells.area(cell));
        }
    }

    /// Of each source: irradiance of a cell by light that was reflected before.
    pub fn reflected(&self, cell: u32) -> impl Iterator<Item = Vec3> {
        let first = cell as usize * self.sources;
        self.reflected[first..first + self.sources].iter().map(|sum| *sum * self.share)
    }

    /// Of each source: greatest channel of direct irradiance.
    pub fn direct(&self, cell: u32) -> &[f32] {
        let first = cell as usize * self.sources;
        &self.direct[first..first + self.sources]
    }
}

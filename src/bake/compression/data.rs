//! What is left of the operator, and its application on the CPU.

use glam::{DVec3, Vec3};
use half::f16;

use super::haar::Haar;

/// T as three products of small dense blocks: of light's Haar terms each supercluster of pixels makes y = V λ̂[J],
/// each of its tiles c = B y, each pixel of a tile u·c, channel by channel. B and the rows u serve all three channels.
/// So do V's columns for most terms, behind a [tint](Self::tints) of light; for the others V has columns for each channel.
///
/// All blocks are row-major; ranks and lengths of lists are multiples of [`MULTIPLE`].
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Compressed {
    /// Coefficients of direct light, and as many Haar terms.
    pub coefficients: usize,
    pub superclusters: Vec<Supercluster>,
    /// In the order of their superclusters.
    pub tiles: Vec<Tile>,
    /// The lists J, indices of Haar terms: those with factors for each channel, then those with a tint, both ascending.
    pub terms: Vec<u32>,
    /// What each of these is multiplied by before V: 1 where each channel has factors.
    pub tints: Vec<Vec3>,
    /// For each supercluster the blocks of red, green and blue in turn, rank x own terms; then that of all three, rank x others.
    pub v: Vec<f16>,
    /// For each tile: its rank x the rank of its supercluster.
    pub b: Vec<f16>,
    /// For each tile: its view samples x its rank.
    pub u: Vec<f16>,
    /// Indices into [`DeepFramebuffer::samples`](crate::bake::DeepFramebuffer::samples) of the rows of all tiles, each at most once; what is
    /// not listed gets no indirect light.
    pub samples: Vec<u32>,
    /// Indirect radiance of emitters at these; empty without any.
    pub emission: Vec<DVec3>,
    /// What the products are multiplied by at last.
    pub scale: f32,
}

/// Where the parts of a supercluster begin, and how many there are.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Supercluster {
    pub first_term: u32,
    pub terms: u32,
    /// How many of these have factors for each channel.
    pub own: u32,
    pub rank: u32,
    pub first_tile: u32,
    pub tiles: u32,
    pub first_v: u64,
}

/// Where the parts of a tile begin, and how many there are.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Tile {
    pub supercluster: u32,
    pub first_sample: u32,
    pub samples: u32,
    pub rank: u32,
    pub first_b: u64,
    pub first_u: u64,
}

/// Ranks and lists come in multiples of this: 16 bytes of factors.
pub const MULTIPLE: usize = 8;

impl Compressed {
    /// Indirect radiance of the rows in `samples`, from the Haar terms of direct light.
    pub fn apply(&self, terms: &[DVec3]) -> Vec<DVec3> {
        assert_eq!(terms.len(), self.coefficients);
        let mut radiance = Vec::with_capacity(self.samples.len());
        for supercluster in &self.superclusters {
            let y = self.project(supercluster, terms);
            let tiles = supercluster.first_tile as usize..(supercluster.first_tile + supercluster.tiles) as usize;
            for tile in &self.tiles[tiles] {
                let c = product(&self.b[tile.first_b as usize..], tile.rank as usize, &y);
                let pixels = product(&self.u[tile.first_u as usize..], tile.samples as usize, &c);
                radiance.extend(pixels.into_iter().map(|p| p * f64::from(self.scale)));
            }
        }
        radiance
    }

    /// [`Self::apply`] to coefficients of direct light.
    pub fn relight(&self, haar: &Haar, direct: &[DVec3]) -> Vec<DVec3> {
        self.apply(&haar.terms(direct))
    }

    fn project(&self, supercluster: &Supercluster, terms: &[DVec3]) -> Vec<DVec3> {
        let first = supercluster.first_term as usize;
        let [rank, count, own] = [supercluster.rank, supercluster.terms, supercluster.own].map(|n| n as usize);
        let light = |i: usize| terms[self.terms[first + i] as usize] * self.tints[first + i].as_dvec3();
        let light: Vec<DVec3> = (0..count).map(light).collect();
        let (light, tinted) = light.split_at(own);
        let block = |channel: usize| &self.v[supercluster.first_v as usize + channel * rank * own..];
        let [red, green, blue] = [0, 1, 2].map(|channel| product(block(channel), rank, light));
        let shared = product(block(3), rank, tinted);
        (0..rank).map(|r| DVec3::new(red[r].x, green[r].y, blue[r].z) + shared[r]).collect()
    }

    /// Multiply-adds of all three channels.
    pub fn multiply_adds(&self) -> u64 {
        let of_v = |s: &Supercluster| 3 * u64::from(s.rank) * u64::from(s.terms);
        3 * (self.u.len() + self.b.len()) as u64 + self.superclusters.iter().map(of_v).sum::<u64>()
    }

    /// Bytes that a multiplication reads: factors, lists and tints.
    pub fn bytes(&self) -> u64 {
        let lists = 4 * (self.terms.len() + self.samples.len()) + size_of_val(&self.tints[..]);
        (2 * (self.u.len() + self.b.len() + self.v.len()) + lists) as u64
    }
}

/// The first `rows` rows of a row-major block times a vector.
fn product(block: &[f16], rows: usize, vector: &[DVec3]) -> Vec<DVec3> {
    let width = vector.len();
    let row = |r: usize| -> DVec3 { (0..width).map(|i| block[r * width + i].to_f64() * vector[i]).sum() };
    (0..rows).map(row).collect()
}

//! Light of domes by the compressed map from cells of the sky to view samples: no rays, whatever changes in the sky.
//!
//! While a dome moves, this is all of its light but that of [suns](Sun), which are traced. At rest
//! it is the light that mirrors throw onto other surfaces; points of the dome give the rest.
//!
//! 1. On the host: the mean radiance of each cell, and its Haar transform.
//! 2. `light of the sky` (load_terms.comp): the terms, into a vector.
//! 3. `transfer`, `transfer to pixels`: the chain, as that of gather samples.

use std::f64::consts::PI;
use std::sync::Arc;

use glam::{Vec3, Vec4};

use super::block_product::{Product, Products};
use crate::bake::compression::haar::Haar;
use crate::bake::compression::sky_haar;
use crate::bake::transfer::sky::SkyTransfer;
use crate::bake::transport::sky;
use crate::error::Result;
use crate::gpu::{Access, Buffer, Context, Frame, Kernel};
use crate::physics::sequence::fibonacci_lattice;
use crate::physics::sky_cells;
use crate::relight::light_cache::Detail;
use crate::relight::light_target::LightTargets;
use crate::scene::sky_map::Sun;
use crate::scene::{Light, MeshSpace};
use crate::shared::{LoadTermsPush, PackedLight};

/// The map on the device.
pub struct SkyLight {
    /// The Haar terms, and the results of the chain.
    vector: Buffer<Vec4>,
    load: Kernel<LoadTermsPush>,
    chain: Vec<Product>,
    /// Whether it matters at rest.
    pub has_mirrors: bool,
}

/// Terms of the skies of a frame, on their way to the device.
pub struct SkyTerms {
    haar: Haar,
    /// Scratch space: RGB of each column.
    coefficients: Vec<[f32; 3]>,
    buffers: [Buffer<Vec4>; SKIES_A_FRAME],
    used: usize,
}

/// Factor from the squared radius of a disk of directions to the increase of a lobe's squared alpha, as in
/// shade_soft.comp.
const WIDENING: f64 = 0.25;
/// Directions that stand for a sun.
const SUN_POINTS: u32 = 64;
/// Number of domes whose images one frame renders with the map.
const SKIES_A_FRAME: usize = 2;

impl SkyLight {
    /// Uploads `transfer`; `None` if no light of the sky arrives.
    pub fn new(context: &Arc<Context>, transfer: &SkyTransfer, products: &mut Products) -> Result<Option<Self>> {
        let Some((last, inner)) = transfer.chain.split_last() else { return Ok(None) };
        let mut chain = products.of(inner, false)?;
        chain.extend(products.of(std::slice::from_ref(last), true)?);
        Ok(Some(Self {
            vector: Buffer::new(context, "light of the sky (vector)", Access::Device, transfer.vector_length)?,
            load: Kernel::new(context, ())?,
            chain,
            has_mirrors: transfer.has_mirrors(),
        }))
    }

    /// Maximum number of passes on the device that [`Self::add`] records.
    pub fn pass_count(&self) -> usize {
        1 + self.chain.iter().map(Product::pass_count).sum::<usize>()
    }

    /// Adds the light of a sky, whose terms are in a buffer, to the image of one light.
    pub fn add(&self, frame: &mut Frame, terms: &Buffer<Vec4>, targets: &LightTargets) -> Result<()> {
        let mut pass = frame.pass("light of the sky");
        let push = LoadTermsPush {
            terms: pass.read(terms),
            vector: pass.write(&self.vector),
            count: terms.len() as u32,
            unused: 0,
        };
        pass.dispatch(&self.load, &push, push.count);
        for product in &self.chain {
            product.run(frame, &self.vector, targets)?;
        }
        Ok(())
    }
}

impl SkyTerms {
    pub fn new(context: &Arc<Context>) -> Result<Self> {
        let buffer = || Buffer::new(context, "light of the sky (terms)", Access::HostWrites, sky::COLUMNS);
        let coefficients = vec![[0.0; 3]; sky::COLUMNS];
        Ok(Self { haar: sky_haar(), coefficients, buffers: [buffer()?, buffer()?], used: 0 })
    }

    /// Begins a new frame: all buffers are free.
    pub fn restart(&mut self) {
        self.used = 0;
    }

    /// Whether a buffer is free.
    pub fn has_room(&self) -> bool {
        self.used < self.buffers.len()
    }

    /// Computes the terms of a dome at unit intensity: light that leaves mirrors, and if `straight` all other light but
    /// that of [traced](is_traced) suns. Returns the index of their [buffer](Self::buffer).
    pub fn compute(&mut self, light: &Light, straight: bool, detail: Detail) -> usize {
        let parts = light.sky().parts();
        let (seen, by_mirrors) = self.coefficients.split_at_mut(sky_cells::COUNT);
        for (cell, radiance) in parts.glow(light.turns()).into_iter().enumerate() {
            by_mirrors[cell] = radiance.to_array();
        }
        match straight {
            true => seen.copy_from_slice(by_mirrors),
            false => seen.fill([0.0; 3]),
        }
        for sun in parts.suns() {
            let radiance = (sun.irradiance / (f64::from(SUN_POINTS) * sky_cells::SOLID_ANGLE)).as_vec3();
            for i in 0..SUN_POINTS {
                let direction = light.turn() * sun.direction_at(fibonacci_lattice(i, SUN_POINTS));
                let cell = sky_cells::index(direction.as_vec3());
                by_mirrors[cell] = (Vec3::from(by_mirrors[cell]) + radiance).to_array();
                if straight && !is_traced(sun, detail) {
                    seen[cell] = (Vec3::from(seen[cell]) + radiance).to_array();
                }
            }
        }
        self.haar.transform(&mut self.coefficients);
        let index = self.used;
        self.used += 1;
        let terms = self.buffers[index].host_mut();
        terms.iter_mut().zip(&self.coefficients).for_each(|(term, &[r, g, b])| *term = Vec4::new(r, g, b, 0.0));
        index
    }

    pub fn buffer(&self, index: usize) -> &Buffer<Vec4> {
        &self.buffers[index]
    }
}

/// Whether a sun is traced while its dome moves. Large ones are left to the cells if there is little time.
fn is_traced(sun: &Sun, detail: Detail) -> bool {
    detail != Detail::Coarse || !sun.is_large()
}

/// The traced suns of a dome as punctual lights, at unit intensity.
pub fn suns(light: &Light, space: MeshSpace, detail: Detail) -> Vec<PackedLight> {
    let packed = light.pack(space);
    let sun = |sun: &Sun| {
        let brightness = sun.irradiance.max_element();
        PackedLight {
            direction: (light.turn() * -sun.direction).as_vec3(),
            position: (sun.irradiance / brightness).as_vec3(),
            strength: brightness as f32,
            narrowing: (WIDENING * sun.solid_angle / PI) as f32,
            ..packed
        }
    };
    light.sky().parts().suns().iter().filter(|sun| is_traced(sun, detail)).map(sun).collect()
}

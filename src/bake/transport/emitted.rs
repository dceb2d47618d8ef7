//! Indirect light of emitters: one image for each, made while the rows of Φ are gathered.

use glam::{DVec3, Vec3};

use super::LightTransport;
use crate::bake::csr_matrix::CsrMatrix;
use crate::scene::Emitters;

/// Indirect light of one emitter.
#[derive(Clone, Debug, PartialEq)]
pub struct EmitterLight {
    /// Index into the scene's [`Emitters`].
    pub emitter: u32,
    /// By view sample.
    pub radiance: Vec<Vec3>,
}

/// What the rows of Φ are multiplied by for the light of each emitter.
#[derive(Default)]
pub struct Emitted {
    operands: Vec<(u32, Vec<DVec3>)>,
}

impl Emitted {
    /// Emitters without a gather sample are left out: no path hit them.
    pub(super) fn new(transport: &LightTransport) -> Self {
        let scene = transport.scene();
        let emitters = Emitters::of(scene);
        let operand = |emitter: u32| {
            let is_of = |material: u32| emitters.index(material) == Some(emitter);
            let emission = transport.radiating(|sample| match is_of(sample.material) {
                true => sample.emission.as_dvec3(),
                false => DVec3::ZERO,
            });
            emission.iter().any(|e| *e != DVec3::ZERO).then(|| (emitter, transport.bounce(&emission).0))
        };
        Self { operands: (0..emitters.len() as u32).filter_map(operand).collect() }
    }

    /// Number of emitters.
    pub fn count(&self) -> usize {
        self.operands.len()
    }

    /// Radiance at the view samples of `rows`: for each row that of all emitters.
    pub fn radiance(&self, rows: &CsrMatrix) -> Vec<Vec3> {
        let products: Vec<Vec<DVec3>> = self.operands.iter().map(|(_, operand)| rows.multiply(operand)).collect();
        (0..rows.len()).flat_map(|row| products.iter().map(move |product| product[row].as_vec3())).collect()
    }

    /// Dark images of all emitters.
    pub fn images(&self, view_samples: usize) -> Vec<EmitterLight> {
        let image = |&(emitter, _): &_| EmitterLight { emitter, radiance: vec![Vec3::ZERO; view_samples] };
        self.operands.iter().map(image).collect()
    }
}

/// Writes [`Emitted::radiance`] of `samples` into `images`.
pub fn place(images: &mut [EmitterLight], samples: &[u32], radiance: &[Vec3]) {
    for (&sample, of_sample) in samples.iter().zip(radiance.chunks(images.len().max(1))) {
        images.iter_mut().zip(of_sample).for_each(|(image, value)| image.radiance[sample as usize] = *value);
    }
}

//! Spectral radius, bounces and what precision costs, against albedo.

use glam::{DVec3, Vec3};
use relume::Result;
use relume::bake::baselines::thesis::{Thesis, ThesisSettings};
use relume::bake::brdf_factors::svd::Terms;
use relume::bake::transfer::Transfer;
use relume::bake::transport::direct;
use relume::bake::transport::directions::Lobe;
use relume::bake::transport::{LightTransport, Outgoing, TransferSettings};
use relume::bake::{BakeSettings, DeepFramebuffer, bake};
use relume::report::stability::{MOST_BOUNCES, Stability};
use relume::scene::{Material, Scene};
use relume::storage::journal::Journal;
use relume::trace::bvh::TracedScene;

use super::lab::Lab;

const ALBEDOS: [f64; 7] = [0.1, 0.3, 0.5, 0.7, 0.9, 0.99, 0.999];
const GATHER_SAMPLES: usize = 576;
const RAYS: u32 = 256;

impl Lab<'_> {
    /// Measured unless it was before.
    pub fn stability(&mut self) -> Result<Vec<Stability>> {
        let what = format!("stability {}", self.identity);
        if let Some(rows) = self.kept.get(&what) {
            return Ok(rows);
        }
        let rows: Vec<Stability> = ALBEDOS
            .iter()
            .map(|&albedo| self.painted(albedo))
            .collect::<Result<Vec<_>>>()?
            .into_iter()
            .flatten()
            .collect();
        self.kept.keep(&what, &rows)?;
        Ok(rows)
    }

    /// None where no gather sample is lit.
    fn painted(&self, albedo: f64) -> Result<Option<Stability>> {
        let mut scene = Scene::load(self.path)?;
        scene.materials.iter_mut().for_each(|material| *material = matt(albedo as f32));
        let scene = TracedScene::new(scene);
        let session = &self.session;
        // Nobody looks at it: the smallest picture will do.
        let settings = BakeSettings { width: 8, height: 8, layers: 1, samples: 1 };
        let framebuffer = bake(&scene, &session.framebuffer.camera, &session.rig, &settings, &|_| ());
        let settings = TransferSettings {
            outgoing: Outgoing::Diffuse,
            samples: GATHER_SAMPLES,
            paths: TransferSettings::paths_for(GATHER_SAMPLES),
            coarse_samples: GATHER_SAMPLES,
            points: 16,
            rays: RAYS,
            layers: 1,
            bounces: None,
            seed: self.view.seed,
        };
        let transfer = LightTransport::new(&scene, &framebuffer, &settings, &|_| ());
        let thesis = ThesisSettings {
            outgoing: Outgoing::Diffuse,
            samples: GATHER_SAMPLES,
            terms: Terms::Count(1),
            bounces: 5,
            seed: self.view.seed,
        };
        let thesis = Thesis::new(&scene, &framebuffer, &thesis, &|_| ());
        let Some(light) = session.rig.lights.first() else { return Ok(None) };
        let direct = direct::shade(&scene, &transfer.fine, &light.pack(scene.space));
        let [single, half] = precision(&transfer, &framebuffer, &direct);
        let (all, residual) = transfer.bounce(&direct);
        if squares(&all) == 0.0 {
            return Ok(None);
        }
        let left = |sum: &[DVec3]| {
            let rest: Vec<DVec3> = all.iter().zip(sum).map(|(a, b)| *a - *b).collect();
            (squares(&rest) / squares(&all)).sqrt()
        };
        // The picture's n-th bounce is the n-th term of this sum.
        let (mut term, mut sum) = (direct.clone(), direct);
        let (mut bounces, mut left_after_five) = (None, 0.0);
        for count in 1..=MOST_BOUNCES {
            let error = left(&sum);
            if count == 5 {
                left_after_five = error;
            }
            if error <= 1e-3 && bounces.is_none() {
                bounces = Some(count);
            }
            if bounces.is_some() && count >= 5 {
                break;
            }
            term = transfer.bounce_matrix.multiply(&term);
            sum.iter_mut().zip(&term).for_each(|(sum, term)| *sum += *term);
        }
        Ok(Some(Stability {
            albedo,
            radius: transfer.certificate.spectral_radius,
            thesis_radius: thesis.spectral_radius,
            residual,
            bounces,
            left_after_five,
            single,
            half,
        }))
    }
}

/// How far single precision, and factors in half precision, are from double precision: relative root mean square of
/// what the camera sees after all bounces.
fn precision(transfer: &LightTransport, framebuffer: &DeepFramebuffer, direct: &[DVec3]) -> [f64; 2] {
    let seen: Vec<u32> = (0..framebuffer.samples.len() as u32).collect();
    let rows = transfer.rows(&seen, Lobe::All);
    let further = transfer.further_bounces();
    let bounced = |i: usize| {
        let sum = |c: usize| (0..direct.len()).map(|j| further[c][(i, j)] * direct[j][c]).sum::<f64>();
        direct[i] + DVec3::from_array([0, 1, 2].map(sum))
    };
    let double = rows.multiply(&(0..direct.len()).map(bounced).collect::<Vec<_>>());
    let bounced = |i: usize| {
        let sum = |c: usize| (0..direct.len()).map(|j| further[c][(i, j)] as f32 * direct[j][c] as f32).sum::<f32>();
        direct[i].as_vec3() + Vec3::from([0, 1, 2].map(sum))
    };
    let all: Vec<Vec3> = (0..direct.len()).map(bounced).collect();
    let of_row =
        |r: usize| rows.row(r).map(|(j, factors)| Vec3::from(factors) * all[j as usize]).sum::<Vec3>().as_dvec3();
    let single: Vec<DVec3> = (0..seen.len()).map(of_row).collect();
    let dense = Transfer::dense(transfer, framebuffer, Lobe::All, &mut Journal::default(), &|_| ());
    [single, dense.apply(direct)].map(|picture| {
        let off: Vec<DVec3> = picture.iter().zip(&double).map(|(a, b)| *a - *b).collect();
        (squares(&off) / squares(&double).max(f64::MIN_POSITIVE)).sqrt()
    })
}

fn squares(values: &[DVec3]) -> f64 {
    values.iter().map(|v| v.length_squared()).sum()
}

/// Lambert's reflection of so much light.
fn matt(albedo: f32) -> Material {
    let base_color = Vec3::splat(albedo).extend(1.0);
    Material { base_color, metallic: 0.0, specular: 0.0, ..Material::default() }
}

//! The operator's pictures of some lights, refined by what final gathering found, and the error that is left.

use glam::Vec3;

use super::Combination;

/// What passes found of one light at unit strength.
#[derive(Clone)]
pub struct Estimate {
    /// Means over two independent halves of the passes, row by row.
    pub halves: [Vec<Vec3>; 2],
    /// Of each pixel: rays in each half.
    pub rays: [Vec<u32>; 2],
    pub passes: u32,
}

/// What final gathering makes of the operator's pictures of some lights.
pub struct Refined {
    /// Of each light what is added to its picture at unit strength, row by row.
    pub changes: Vec<Vec<Vec3>>,
    /// Expected squared error of each pixel, mean over its channels; of all lights together.
    pub errors2: Vec<f64>,
    /// Of each light its part of the squared error at unit strength, relative to `errors2`.
    pub parts: Vec<f64>,
}

impl Estimate {
    /// The estimate by the passes of both.
    pub fn joined(mut self, other: &Self) -> Self {
        for half in 0..2 {
            let mine = self.halves[half].iter_mut().zip(&mut self.rays[half]);
            let others = other.halves[half].iter().zip(&other.rays[half]);
            for ((pixel, rays), (other_pixel, other_rays)) in mine.zip(others) {
                let share = *other_rays as f32 / (*rays + other_rays).max(1) as f32;
                *pixel = pixel.lerp(*other_pixel, share);
                *rays += other_rays;
            }
        }
        self.passes += other.passes;
        self
    }
}

impl Refined {
    /// From pictures of `width` pixels a row. Of each light: its scale in the picture, its indirect light by the
    /// operator at unit strength, and by final gathering.
    pub fn new(width: usize, lights: &[(Vec3, &[Vec3], &Estimate)]) -> Self {
        let count = lights.first().map_or(0, |(_, operator, _)| operator.len());
        let [mut biased, mut a, mut b] = [(); 3].map(|()| vec![Vec3::ZERO; count]);
        let add = |sum: &mut [Vec3], scale: Vec3, image: &[Vec3]| {
            sum.iter_mut().zip(image).for_each(|(sum, value)| *sum += scale * *value);
        };
        // Of each light: squared differences of its halves.
        let mut noises = Vec::with_capacity(lights.len());
        for (scale, operator, Estimate { halves, .. }) in lights {
            add(&mut biased, *scale, operator);
            add(&mut a, *scale, &halves[0]);
            add(&mut b, *scale, &halves[1]);
            let noise = |(a, b): (&Vec3, &Vec3)| (*scale * (*a - *b)).as_dvec3().length_squared();
            noises.push(halves[0].iter().zip(&halves[1]).map(noise).filter(|noise| noise.is_finite()).sum::<f64>());
        }
        let combination = Combination::new(width, &biased, [&a, &b]);
        let all: f64 = noises.iter().sum();
        let part = |((scale, ..), noise): (&(Vec3, &[Vec3], &Estimate), f64)| {
            let strength2 = scale.as_dvec3().length_squared() / 3.0;
            if all > 0.0 && strength2 > 0.0 { noise / all / strength2 } else { 0.0 }
        };
        let changes =
            lights.iter().map(|(_, operator, Estimate { halves: [a, b], .. })| combination.change(operator, [a, b]));
        Self {
            changes: changes.collect(),
            errors2: combination.errors2(),
            parts: lights.iter().zip(noises).map(part).collect(),
        }
    }

    /// Expected error of a pixel, root mean square.
    pub fn error(&self) -> f64 {
        mean(&self.errors2).sqrt()
    }
}

/// Mean of the squared errors of pixels.
pub fn mean(errors2: &[f64]) -> f64 {
    errors2.iter().sum::<f64>() / errors2.len().max(1) as f64
}

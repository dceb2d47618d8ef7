//! What a scene does not pay for.

use glam::UVec2;
use relume::scene::Rig;
use relume::session::{FramebufferCounts, NoSky, Unneeded};
use relume::shared::{Brdf, ViewSample};

/// Something that a scene does not need.
#[derive(serde::Serialize)]
pub struct LeftOut {
    pub what: &'static str,
    pub why: String,
    pub saves: String,
}

/// Share of the surfaces that is not worth a word.
const LITTLE: f64 = 0.01;

/// `traced`: shadow rays are traced, no maps are drawn. `unneeded`: `None` without indirect light.
pub fn left_out(counts: &FramebufferCounts, rig: &Rig, traced: bool, unneeded: Option<Unneeded>) -> Vec<LeftOut> {
    let mut list = Vec::new();
    let mut add = |what, why: &str, saves: String| list.push(LeftOut { what, why: why.into(), saves });
    let megabytes = |bytes: usize| format!("{:.1} MB", bytes as f64 * 1e-6);
    let per_sample = size_of::<ViewSample>();
    let mirror_layers = counts.layers.len().saturating_sub(1);
    let full_layers = mirror_layers * counts.pixels;
    let deeper: usize = counts.layers.iter().skip(1).sum();
    if deeper == 0 && full_layers > 0 {
        let saves = format!("{mirror_layers} layers, {}", megabytes(full_layers * per_sample));
        add("mirror layers", "no mirror is visible", saves);
    } else if deeper < full_layers {
        let saves =
            format!("{} view samples, {}", full_layers - deeper, megabytes((full_layers - deeper) * per_sample));
        add("parts of mirror layers", "mirrors cover a part of the picture", saves);
    }
    if !counts.has_specular {
        add("the specular lobe", "no visible surface has one", "its share of the shading kernel".into());
    }
    match unneeded {
        None => add("indirect light", "--gi off", "gather samples, their transfer, and its passes".into()),
        Some(Unneeded { unseen, .. }) if unseen > LITTLE => {
            let saves = format!("the samples of {:.0} % of all surfaces", 100.0 * unseen);
            add("gather samples nobody sees", "no light reaches the eye from there, over any bounces", saves);
        }
        Some(_) => (),
    }
    if let Some(why) = unneeded.and_then(|unneeded| unneeded.sky) {
        let why = match why {
            NoSky::NoDome => "no light is a dome",
            NoSky::Closed => "hardly any ray leaves the scene",
        };
        add("light of the sky", why, "a compressed map of its own".into());
    }
    if counts.own_brdfs == 0 {
        let saves = megabytes(counts.pixels * size_of::<Brdf>());
        add("BRDFs of single samples", "no texture or vertex colour is visible", saves);
    }
    if !rig.has_factors() {
        let saves = format!("{} for each light that moves", megabytes(counts.samples * size_of::<UVec2>()));
        add("factors on light", "no light has filters, or links that scale its light", saves);
    }
    if traced {
        add("shadow maps", "rays are traced on the CPU", "drawing, and 24 MB at 1024 texels".into());
    }
    list
}

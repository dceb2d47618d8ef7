//! How near sums of δ products come to GGX: the thesis's singular values, and harmonics.

use std::f64::consts::{PI, TAU};
use std::fmt::Write;
use std::path::Path;
use std::sync::OnceLock;

use glam::{DVec3, Vec3};
use relume::bake::brdf_factors::HarmonicProjection;
use relume::bake::brdf_factors::harmonics::{Harmonics, MAX_FUNCTIONS};
use relume::bake::brdf_factors::svd::{self, Factors, Terms};
use relume::physics::brdf::{Lobes, f};
use relume::physics::sequence::Points;
use relume::shared::Brdf;

const ROUGHNESS: [f32; 5] = [0.2, 0.3, 0.4, 0.55, 0.8];
/// δ, of singular values and of harmonics.
const TERMS: [usize; 7] = [1, 2, 4, 8, 16, 32, 64];
const FUNCTIONS: [usize; 7] = [1, 4, 9, 16, 25, 36, 49];

/// What one roughness gives, for each δ.
struct Measured {
    roughness: f32,
    /// At the 812 directions that singular values are of: δ of `TERMS`, `FUNCTIONS`, and as many singular values as
    /// these.
    terms_at_texels: Near,
    functions_at_texels: Near,
    as_many_at_texels: Near,
    /// Over all directions.
    terms: Near,
    functions: Near,
    /// Share of light reflected, from the direction of which most is.
    most_of_terms: [f64; 7],
    most_of_functions: [f64; 7],
}

/// How near so many products come.
struct Near {
    /// Relative error, root mean square.
    errors: [f64; 7],
    /// Share of even light that is reflected.
    reflected: [f64; 7],
}

/// A pair of directions, the BRDF there, and how much it counts.
struct Pair {
    wi: Vec3,
    wo: Vec3,
    f: f64,
    weight: f64,
}

fn white_metal(roughness: f32) -> Brdf {
    let alpha = roughness * roughness;
    Brdf { diffuse: Vec3::ZERO, alpha, f0: Vec3::ONE, f90: 1.0, dielectric_f0: 0.0, dielectric_f90: 0.0 }
}

/// Cosine-distributed about +Z.
fn on_disc(u: f64, v: f64) -> DVec3 {
    let (sine, cosine) = (TAU * v).sin_cos();
    DVec3::new(u.sqrt() * cosine, u.sqrt() * sine, (1.0 - u).sqrt())
}

/// Pairs over both hemispheres under projected solid angle; half of the second directions follow the lobe.
fn drawn(brdf: &Brdf) -> Vec<Pair> {
    let points = Points::new(1, 0);
    let pair = |i: u32| {
        let ([u, v, w, x], [choice, ..]) = (points.at(i, 0), points.at(i, 1));
        let wi = on_disc(u, v);
        let lobes = Lobes::new(brdf, DVec3::Z, wi)?;
        let wo = if choice < 0.5 { lobes.sample([w, x, 0.0])? } else { on_disc(w, x) };
        let at = lobes.at(wo);
        let density = 0.5 * (at.density + wo.z / PI);
        Some(Pair { wi: wi.as_vec3(), wo: wo.as_vec3(), f: at.sum().x / wo.z, weight: wo.z / density })
    };
    (0..1 << 15).filter_map(pair).collect()
}

/// All pairs of the 812 directions, which stand for equal projected solid angles.
fn texels(brdf: &Brdf) -> Vec<Pair> {
    let directions = svd::directions();
    let pair = |wi: DVec3, wo: DVec3| {
        let f = f(brdf, DVec3::Z, wi, wo).x;
        Pair { wi: wi.as_vec3(), wo: wo.as_vec3(), f, weight: 1.0 }
    };
    directions.iter().flat_map(|wi| directions.iter().map(move |wo| pair(*wi, *wo))).collect()
}

/// h_i k_i of a pair of directions, `wi` and `wo`.
type Products<'a> = &'a dyn Fn(Vec3, Vec3) -> Vec<f64>;

fn added(products: Vec<f64>, counts: [usize; 7]) -> [f64; 7] {
    counts.map(|count| products[..count].iter().sum())
}

fn near(pairs: &[Pair], counts: [usize; 7], products: Products) -> Near {
    let (mut errors, mut reflected, mut norm) = ([0.0; 7], [0.0; 7], 0.0);
    for pair in pairs {
        let sums = added(products(pair.wi, pair.wo), counts);
        errors.iter_mut().zip(sums).for_each(|(error, sum)| *error += pair.weight * (sum - pair.f).powi(2));
        reflected.iter_mut().zip(sums).for_each(|(all, sum)| *all += pair.weight * PI * sum);
        norm += pair.weight * pair.f * pair.f;
    }
    let weight: f64 = pairs.iter().map(|pair| pair.weight).sum();
    Near { errors: errors.map(|error| (error / norm).sqrt()), reflected: reflected.map(|all| all / weight) }
}

/// The largest share of light that so many products reflect, over light from 45 angles, turned about as they grow.
fn most_reflected(counts: [usize; 7], products: Products) -> [f64; 7] {
    let mut most = [0.0f64; 7];
    let points = Points::new(2, 0);
    for degrees in (0..90).step_by(2) {
        let (sine, cosine) = f64::from(degrees).to_radians().sin_cos();
        let (y, x) = (1.2 * f64::from(degrees)).sin_cos();
        let wi = DVec3::new(sine * x, sine * y, cosine).as_vec3();
        let mut reflected = [0.0; 7];
        let draws = 1 << 12;
        for i in 0..draws {
            let [u, v, ..] = points.at(i, 0);
            let sums = added(products(wi, on_disc(u, v).as_vec3()), counts);
            reflected.iter_mut().zip(sums).for_each(|(all, sum)| *all += PI * sum / f64::from(draws));
        }
        most.iter_mut().zip(reflected).for_each(|(most, reflected)| *most = most.max(reflected));
    }
    most
}

fn measure(roughness: f32) -> Measured {
    let brdf = white_metal(roughness);
    let factors = Factors::new(&brdf, Terms::Count(TERMS[6]));
    let terms = |wi: Vec3, wo: Vec3| {
        let (mut h, mut k) = ([Vec3::ZERO; TERMS[6]], [Vec3::ZERO; TERMS[6]]);
        factors.h(wo, &mut h);
        factors.k(wi, &mut k);
        h.iter().zip(&k).map(|(h, k)| f64::from(h.x * k.x)).collect()
    };
    let functions = |wi: Vec3, wo: Vec3| {
        let (mut h, mut k) = ([0.0; MAX_FUNCTIONS], [Vec3::ZERO; MAX_FUNCTIONS]);
        Harmonics::get().evaluate(wo, &mut h);
        HarmonicProjection::get().project(&brdf, wi, &mut k);
        h.iter().zip(&k).map(|(h, k)| f64::from(h * k.x)).collect()
    };
    let (drawn, texels) = (drawn(&brdf), texels(&brdf));
    Measured {
        roughness,
        terms_at_texels: near(&texels, TERMS, &terms),
        functions_at_texels: near(&texels, FUNCTIONS, &functions),
        as_many_at_texels: near(&texels, FUNCTIONS, &terms),
        terms: near(&drawn, TERMS, &terms),
        functions: near(&drawn, FUNCTIONS, &functions),
        most_of_terms: most_reflected(TERMS, &terms),
        most_of_functions: most_reflected(FUNCTIONS, &functions),
    }
}

fn measured() -> &'static [Measured; 5] {
    static MEASURED: OnceLock<[Measured; 5]> = OnceLock::new();
    MEASURED.get_or_init(|| ROUGHNESS.map(measure))
}

/// More are better, of singular values where these are from: everywhere else interpolation has its share.
#[test]
fn errors_fall_with_more_terms() {
    for m in measured() {
        for errors in [m.terms_at_texels.errors, m.functions.errors] {
            assert!(errors.is_sorted_by(|a, b| a >= b), "roughness {}: {errors:?}", m.roughness);
            assert!(errors[6] < 0.96 * errors[0], "roughness {}: {errors:?}", m.roughness);
        }
    }
}

/// In the norm that they are the best in, as many singular values are nearer than any other products.
#[test]
fn singular_values_are_nearest_in_their_norm() {
    for m in measured() {
        let (harmonics, svd) = (m.functions_at_texels.errors, m.as_many_at_texels.errors);
        assert!(svd.iter().zip(harmonics).all(|(svd, harmonics)| *svd <= harmonics), "{svd:?}, {harmonics:?}");
    }
}

/// However many harmonics reflect what the BRDF does, a white metal 1 at most; singular values reflect more.
#[test]
fn harmonics_never_add_energy() {
    for m in measured() {
        let most @ [one, ..] = m.most_of_functions;
        // 4096 directions drawn.
        assert!(most.iter().all(|most| (most - one).abs() < 5e-3 && *most < 1.003), "{}: {most:?}", m.roughness);
    }
    let most = measured().iter().flat_map(|m| m.most_of_terms).fold(0.0, f64::max);
    assert!(most > 1.05, "{most}");
}

const BEGIN: &str = "<!-- basis: written by BLESS=1 cargo test --release --test brdf_factors -->\n";
const END: &str = "<!-- end of basis -->";

/// The tables of docs/accuracy.md and the plot docs/basis.svg; `BLESS=1` writes them.
#[test]
fn tables_and_plot_are_those_of_the_documentation() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let (page, picture) = (root.join("docs/accuracy.md"), root.join("docs/basis.svg"));
    let document = std::fs::read_to_string(&page).unwrap();
    let (before, rest) = document.split_once(BEGIN).expect("a mark before the tables");
    let (tables, after) = rest.split_once(END).expect("a mark after them");
    let now = [markdown(), plot()];
    if std::env::var_os("BLESS").is_some() {
        std::fs::write(&page, format!("{before}{BEGIN}{}{END}{after}", now[0])).unwrap();
        std::fs::write(&picture, &now[1]).unwrap();
        return;
    }
    let picture = std::fs::read_to_string(&picture).unwrap();
    let separators = ['|', ' ', ',', '"', '<', '>', '\n'];
    let numbers = |text: &str| -> Vec<f64> { text.split(separators).filter_map(|word| word.parse().ok()).collect() };
    for (now, then) in now.iter().zip([tables, &picture]) {
        let (got, want) = (numbers(now), numbers(then));
        assert_eq!(got.len(), want.len(), "other numbers are now:\n{now}");
        // Of two equal singular values, of which δ may keep one, another machine may find another mixture.
        let same = |(got, want): (&f64, &f64)| (got - want).abs() < 0.3 + 0.02 * want.abs();
        assert!(got.iter().zip(&want).all(same), "now:\n{now}");
    }
}

/// A row of a table: what it tells, and where from.
type Row = (&'static str, fn(&Measured) -> [f64; 7]);

fn markdown() -> String {
    let mut text = String::new();
    let mut table = |counts: [usize; 7], rows: &[Row]| {
        writeln!(text, "\n| roughness | δ | {} |", counts.map(|c| c.to_string()).join(" | ")).unwrap();
        writeln!(text, "|---|---|{}", "---|".repeat(7)).unwrap();
        for (m, (what, of)) in measured().iter().flat_map(|m| rows.iter().map(move |row| (m, row))) {
            let figures = of(m).map(|figure| format!("{:.1}", 100.0 * figure)).join(" | ");
            writeln!(text, "| {} | {what} | {figures} |", m.roughness).unwrap();
        }
    };
    table(
        TERMS,
        &[
            ("SVD, at its directions", |m| m.terms_at_texels.errors),
            ("SVD, everywhere", |m| m.terms.errors),
            ("reflected of even light", |m| m.terms_at_texels.reflected),
        ],
    );
    table(
        FUNCTIONS,
        &[
            ("harmonics, everywhere", |m| m.functions.errors),
            ("reflected of even light", |m| m.functions_at_texels.reflected),
        ],
    );
    text.push('\n');
    text
}

/// A panel for each roughness: error, 0.1 to 200 %, over δ, 1 to 64, both logarithmic.
fn plot() -> String {
    const PANEL: [f64; 2] = [150.0, 190.0];
    const CURVES: [(&str, &str, &str); 3] = [
        ("SVD, at its 812 directions", "#c05a00", " stroke-dasharray=\"4 3\""),
        ("SVD, everywhere", "#c05a00", ""),
        ("harmonics, everywhere", "#1768b5", ""),
    ];
    let x = |count: f64| PANEL[0] * count.log2() / 6.0;
    let y = |error: f64| PANEL[1] * (2.0 / error.clamp(0.001, 2.0)).ln() / 2000.0f64.ln();
    // On a ground of its own, for readers in dark as in light.
    let mut svg = String::from(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 900 300\" font-family=\"sans-serif\" font-size=\"12\">\n\
         <title>Relative error of GGX in delta products, by roughness</title>\n\
         <rect width=\"900\" height=\"300\" rx=\"6\" fill=\"#ffffff\"/>\n",
    );
    for (i, m) in measured().iter().enumerate() {
        writeln!(svg, "<g transform=\"translate({} 40)\" fill=\"#333333\">", 50.0 + 170.0 * i as f64).unwrap();
        writeln!(svg, "<text x=\"75\" y=\"-12\" text-anchor=\"middle\">roughness {}</text>", m.roughness).unwrap();
        for error in [0.001, 0.01, 0.1, 1.0] {
            let y = y(error);
            writeln!(svg, "<path d=\"M 0 {y:.1} h 150\" stroke=\"#dddddd\"/>").unwrap();
            if i == 0 {
                writeln!(svg, "<text x=\"-6\" y=\"{:.1}\" text-anchor=\"end\">{} %</text>", y + 4.0, 100.0 * error)
                    .unwrap();
            }
        }
        for count in [1, 4, 16, 64] {
            let x = x(f64::from(count));
            writeln!(svg, "<text x=\"{x:.1}\" y=\"206\" text-anchor=\"middle\">{count}</text>").unwrap();
        }
        for ((_, color, dashes), (counts, errors)) in CURVES.iter().zip([
            (TERMS, m.terms_at_texels.errors),
            (TERMS, m.terms.errors),
            (FUNCTIONS, m.functions.errors),
        ]) {
            let point = |(count, error): (usize, f64)| format!("{:.1} {:.1}", x(count as f64), y(error));
            let line = counts.into_iter().zip(errors).map(point).collect::<Vec<_>>().join(" L ");
            writeln!(svg, "<path d=\"M {line}\" style=\"fill:none\" stroke-linejoin=\"round\" stroke=\"{color}\" stroke-width=\"2\"{dashes}/>")
                .unwrap();
        }
        svg.push_str("</g>\n");
    }
    svg.push_str("<text x=\"465\" y=\"264\" text-anchor=\"middle\" fill=\"#333333\">number of products δ</text>\n");
    for (i, (name, color, dashes)) in CURVES.iter().enumerate() {
        let x = 150.0 + 220.0 * i as f64;
        writeln!(
            svg,
            "<path d=\"M {x} 282 h 28\" stroke=\"{color}\" stroke-width=\"2\"{dashes}/>\
             <text x=\"{}\" y=\"286\" fill=\"#333333\">{name}</text>",
            x + 34.0
        )
        .unwrap();
    }
    svg + "</svg>\n"
}

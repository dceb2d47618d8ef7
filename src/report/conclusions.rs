//! What the numbers say, in sentences that change when they do.

use super::table::significant;
use super::{Ablation, EditTime, Method, Point, SceneReport};

/// More work that leaves this share of the error has not helped.
const HELPED: f64 = 0.9;

/// Sentences on one scene.
pub fn of_scene(scene: &SceneReport) -> Vec<String> {
    let mut said = Vec::new();
    said.extend(best_of_ours(scene));
    said.extend(path_tracing(scene));
    said.extend(beside_the_thesis(scene));
    said.extend(beside_wavelets(scene));
    for method in Method::ALL {
        said.extend(where_it_ends(scene, method));
    }
    said.extend(slowest_and_fastest_edit(scene));
    said.extend(maps_and_rays(scene));
    said.extend(scene.ablation.as_ref().map(ablation));
    said
}

/// Points of a method, the least work first.
pub(super) fn curve(scene: &SceneReport, method: Method) -> Vec<&Point> {
    scene.points.iter().filter(|p| p.method == method).collect()
}

/// CPU seconds to the first picture.
pub(super) fn total(point: &Point) -> f64 {
    point.precompute.cpu + point.frame.cpu
}

fn least<'a>(points: impl IntoIterator<Item = &'a Point>) -> Option<&'a Point> {
    points.into_iter().min_by(|p, q| p.errors.indirect.total_cmp(&q.errors.indirect))
}

/// Slope of a straight line through logarithms.
pub fn exponent(points: impl IntoIterator<Item = [f64; 2]>) -> Option<f64> {
    let logs: Vec<[f64; 2]> = points.into_iter().filter(|p| p[0] > 0.0 && p[1] > 0.0).map(|p| p.map(f64::ln)).collect();
    let count = logs.len() as f64;
    let mean = |of: usize| logs.iter().map(|p| p[of]).sum::<f64>() / count;
    let [x, y] = [mean(0), mean(1)];
    let spread: f64 = logs.iter().map(|p| (p[0] - x).powi(2)).sum();
    let together: f64 = logs.iter().map(|p| (p[0] - x) * (p[1] - y)).sum();
    (logs.len() > 1 && spread > 0.0).then(|| together / spread)
}

/// Path tracing's time to an error: between the pictures that were made, else by 1/sqrt(n) beyond them, which is told.
pub fn path_tracing_seconds(scene: &SceneReport, error: f64) -> Option<(f64, bool)> {
    let points = curve(scene, Method::PathTracing);
    let [x, y] = [|p: &Point| p.frame.cpu.max(1e-3).ln(), |p: &Point| p.errors.indirect.ln()];
    for pair in points.windows(2) {
        let [before, after] = [y(pair[0]), y(pair[1])];
        if before >= error.ln() && error.ln() >= after && before > after {
            let share = (before - error.ln()) / (before - after);
            return Some(((x(pair[0]) + share * (x(pair[1]) - x(pair[0]))).exp(), false));
        }
    }
    let nearest = if points.first()?.errors.indirect < error { points.first()? } else { points.last()? };
    Some((nearest.frame.cpu * (nearest.errors.indirect / error).powi(2), true))
}

fn best_of_ours(scene: &SceneReport) -> Option<String> {
    let ours = least(scene.points.iter().filter(|p| p.method.is_ours()))?;
    let (seconds, extrapolated) = path_tracing_seconds(scene, ours.errors.indirect)?;
    let how = if extrapolated { " (extrapolated as 1/√n from what was run)" } else { "" };
    let first = seconds / total(ours);
    let again = seconds / ours.frame.cpu;
    let bake = match first >= 1.0 {
        true => format!("{} times as long as bake and picture together", significant(first)),
        false => format!("{} of the time that bake and picture take together", percent(first)),
    };
    Some(format!(
        "Ours (`{}`) comes as near as {} to the truth's indirect light, in {} CPU seconds of bake and {} for each picture after \
         an edit. Path tracing takes {} CPU seconds{how} for the same error: {bake}, and {} times as long as a picture after an \
         edit.",
        ours.setting,
        percent(ours.errors.indirect),
        significant(ours.precompute.cpu),
        significant(ours.frame.cpu),
        significant(seconds),
        significant(again),
    ))
}

fn path_tracing(scene: &SceneReport) -> Option<String> {
    let points = curve(scene, Method::PathTracing);
    let slope = exponent(points.iter().map(|p| [p.frame.cpu, p.errors.indirect]))?;
    if slope >= 0.0 {
        return Some(format!(
            "Path tracing's error does not fall with time here (exponent {slope:+.2}); 0.5 is expected."
        ));
    }
    Some(format!(
        "Path tracing's error falls as time to the power {slope:.2}, where independent samples give -0.5: half the error takes \
         {} times as long.",
        significant(0.5f64.powf(1.0 / slope))
    ))
}

fn beside_the_thesis(scene: &SceneReport) -> Option<String> {
    let theirs =
        least(scene.points.iter().filter(|p| matches!(p.method, Method::ThesisDiffuse | Method::ThesisGlossy)))?;
    let ours = least(scene.points.iter().filter(|p| p.method.is_ours()))?;
    let ratio = theirs.errors.indirect / ours.errors.indirect;
    let nearer = match ratio >= 1.0 {
        true => format!("{} times as far from the truth", significant(ratio)),
        false => format!("nearer the truth by a factor of {}", significant(1.0 / ratio)),
    };
    Some(format!(
        "The thesis's method at its best here ({}, `{}`) has {}, {nearer} than ours at its best, in {} times its bake.",
        theirs.method.name().split(", more").next().unwrap_or_default(),
        theirs.setting,
        percent(theirs.errors.indirect),
        significant(theirs.precompute.cpu / ours.precompute.cpu),
    ))
}

/// Nested blocks and wavelets compressed to the same error of their rows.
fn beside_wavelets(scene: &SceneReport) -> Option<String> {
    let [nested, haar] = [Method::Compressed, Method::Haar].map(|method| curve(scene, method));
    let pairs = haar.iter().filter_map(|h| {
        let n = nested.iter().find(|n| n.setting == h.setting.replace(" --transfer haar", ""))?;
        Some((*n, *h))
    });
    let (nested, haar) = pairs.min_by(|p, q| p.1.errors.indirect.total_cmp(&q.1.errors.indirect))?;
    let times = |ratio: f64| format!("{} times", significant(ratio));
    Some(format!(
        "Asked for the same error (`{}`), Haar wavelets take {} the memory of nested blocks and {} the CPU time a picture, and come \
         as near as {} where those come as near as {}.",
        nested.setting,
        times(haar.bytes as f64 / nested.bytes.max(1) as f64),
        times(haar.frame.cpu / nested.frame.cpu),
        percent(haar.errors.indirect),
        percent(nested.errors.indirect),
    ))
}

/// The first point after which nothing is better by a tenth.
pub fn last_that_helped<'a>(points: &[&'a Point]) -> Option<&'a Point> {
    let helped = |i: usize| points[i + 1..].iter().any(|p| p.errors.indirect < HELPED * points[i].errors.indirect);
    (0..points.len()).find(|&i| !helped(i)).map(|i| points[i])
}

fn where_it_ends(scene: &SceneReport, method: Method) -> Option<String> {
    let points = curve(scene, method);
    let [stop, last] = [last_that_helped(&points)?, *points.last()?];
    if points.len() < 2 {
        return None;
    }
    let name = capitalized(method.name());
    if std::ptr::eq(stop, last) {
        return Some(format!(
            "{name}: still better at the end of what was run (`{}`, {}).",
            last.setting,
            percent(last.errors.indirect)
        ));
    }
    Some(format!(
        "{name}: stops improving at `{}` ({}), since {}.",
        stop.setting,
        percent(stop.errors.indirect),
        reason(scene, method, stop)
    ))
}

/// Why more of the same does not help.
fn reason(scene: &SceneReport, method: Method, stop: &Point) -> String {
    let errors = stop.errors;
    if errors.indirect <= 0.0 {
        return "nothing is left that the truth can tell".into();
    }
    if errors.indirect < 2.0 * scene.floors.indirect {
        return format!("below {} the truth's own noise hides what is left", percent(2.0 * scene.floors.indirect));
    }
    let beyond = curve(scene, method).into_iter().skip_while(|p| p.setting != stop.setting);
    let no_sum = beyond.filter_map(|p| Some((p, p.spectral_radius.filter(|r| *r >= 1.0)?))).next();
    if let Some((point, radius)) = no_sum {
        let radius = significant(radius);
        return format!("with `{}` its series has no sum: G's spectral radius is {radius}", point.setting);
    }
    if errors.indirect_bias.abs() > 0.5 * errors.indirect {
        return format!("the picture as a whole is off by {}", percent(errors.indirect_bias));
    }
    // What a compressed operator has been measured to leave, beside the whole error.
    let compression = stop.held_out.unwrap_or(0.0);
    if matches!(method, Method::Compressed | Method::Haar) && compression < 0.5 * errors.indirect {
        return format!(
            "compression leaves {} of its rows there: the rest of the {} is these rows' own, of gather samples and rays",
            percent(compression),
            percent(errors.indirect)
        );
    }
    let other = match method {
        Method::GatherSamples => Some(Method::Rays),
        Method::Rays => Some(Method::GatherSamples),
        _ => None,
    };
    let other = other.and_then(|other| Some((other, least(curve(scene, other))?)));
    if let Some((other, best)) = other.filter(|(_, best)| best.errors.indirect < HELPED * errors.indirect) {
        return format!(
            "{} takes it to {} (`{}`)",
            other.name().trim_start_matches("ours, "),
            percent(best.errors.indirect),
            best.setting
        );
    }
    if compression > 0.5 * errors.indirect {
        return format!(
            "compression alone leaves {} of its rows, which a smaller `--error` lowers",
            percent(compression)
        );
    }
    patches(stop)
}

/// Of what kind an error is: means of 4x4 pixels keep what is smooth, and a quarter of what is noise.
fn patches(point: &Point) -> String {
    let share = point.errors.indirect_4x4 / point.errors.indirect;
    let kind = match share {
        s if s > 0.7 => "it lies in patches, wider than that",
        s if s > 0.4 => "it is noise in part",
        _ => "it is noise, pixel by pixel",
    };
    format!("of its error {} are left on means of 4x4 pixels: {kind}", percent(share))
}

fn slowest_and_fastest_edit(scene: &SceneReport) -> Option<String> {
    let changed: Vec<&EditTime> = scene.edits.iter().filter(|e| e.edit != "none").collect();
    let by = |p: &&&EditTime, q: &&&EditTime| p.median_ms.total_cmp(&q.median_ms);
    let (fast, slow) = (changed.iter().min_by(by)?, changed.iter().max_by(by)?);
    let pass = slow.passes.iter().max_by(|p, q| p.median_ms.total_cmp(&q.median_ms))?;
    let describe = |e: &EditTime| {
        format!("`{}` of a {} ({} ms, {} shadows)", e.edit, e.light, significant(e.median_ms), e.shadows)
    };
    Some(format!(
        "Of the edits {} is the fastest and {} the slowest, of which the pass \"{}\" takes {} ms.",
        describe(fast),
        describe(slow),
        pass.name,
        significant(pass.median_ms)
    ))
}

fn maps_and_rays(scene: &SceneReport) -> Option<String> {
    let find = |shadows: &str| scene.edits.iter().find(|e| e.edit == "move_direct" && e.shadows == shadows);
    let (traced, map) = (find("traced")?, find("map")?);
    let ratio = map.median_ms / traced.median_ms;
    let (faster, slower, ratio) = if ratio >= 1.0 { ("traced", "a map", ratio) } else { ("maps", "rays", 1.0 / ratio) };
    Some(format!(
        "Without indirect light a moved {} is {} times as fast with {faster} shadows as with {slower}.",
        traced.light,
        significant(ratio)
    ))
}

fn ablation(ablation: &Ablation) -> String {
    let [as_is, all] = ablation.shading_ms;
    let same = match ablation.difference {
        0.0 => "to the last bit".to_owned(),
        difference => format!("to {} of its mean", percent(difference)),
    };
    format!(
        "With nothing left out (`--force-all`) the picture is the same {same}, and shading a moved light takes {} ms instead of \
         {}.",
        significant(all),
        significant(as_is)
    )
}

pub(super) fn percent(share: f64) -> String {
    format!("{} %", significant(100.0 * share))
}

fn capitalized(text: &str) -> String {
    let mut letters = text.chars();
    letters.next().map_or_else(String::new, |first| first.to_uppercase().collect::<String>() + letters.as_str())
}

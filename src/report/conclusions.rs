//! Sentences for the report page, computed from the measured numbers.

use super::table::significant;
use super::{Ablation, EditTime, Method, Point, SceneReport};

/// More work helps if it reduces the error below this share of it.
const IMPROVEMENT_RATIO: f64 = 0.9;

/// Returns the sentences about one scene.
pub fn of_scene(scene: &SceneReport) -> Vec<String> {
    let mut said = Vec::new();
    said.extend(best_of_ours(scene));
    said.extend(path_tracing(scene));
    said.extend(compare_with_thesis(scene));
    said.extend(compare_with_wavelets(scene));
    for method in Method::ALL {
        said.extend(convergence_limit(scene, method));
    }
    said.extend(not_finite(scene));
    said.extend(slowest_and_fastest_edit(scene));
    said.extend(maps_and_rays(scene));
    said.extend(scene.ablation.as_ref().map(ablation));
    said
}

/// Returns the points of a method, in order of increasing work.
pub(super) fn curve(scene: &SceneReport, method: Method) -> Vec<&Point> {
    scene.points.iter().filter(|p| p.method == method).collect()
}

fn least<'a>(points: impl IntoIterator<Item = &'a Point>) -> Option<&'a Point> {
    points.into_iter().min_by(|p, q| p.errors.indirect.total_cmp(&q.errors.indirect))
}

/// Returns the exponent of a power law: the least-squares slope of the points' logarithms. Points with a coordinate of
/// zero or less are ignored. `None` if fewer than two distinct x remain.
pub fn exponent(points: impl IntoIterator<Item = [f64; 2]>) -> Option<f64> {
    let logs: Vec<[f64; 2]> = points.into_iter().filter(|p| p[0] > 0.0 && p[1] > 0.0).map(|p| p.map(f64::ln)).collect();
    let count = logs.len() as f64;
    let mean = |of: usize| logs.iter().map(|p| p[of]).sum::<f64>() / count;
    let [x, y] = [mean(0), mean(1)];
    let spread: f64 = logs.iter().map(|p| (p[0] - x).powi(2)).sum();
    let together: f64 = logs.iter().map(|p| (p[0] - x) * (p[1] - y)).sum();
    (logs.len() > 1 && spread > 0.0).then(|| together / spread)
}

/// Returns the CPU seconds that path tracing takes to reach `error`, and whether they are extrapolated. They are
/// interpolated between the measured pictures, or else extrapolated as 1/sqrt(n).
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
    // Errors below the noise floor of the ground truth cannot be measured.
    let error = ours.errors.indirect.max(scene.floors.indirect);
    let below =
        if error > ours.errors.indirect { " (below this the noise of the ground truth hides errors)" } else { "" };
    let (seconds, extrapolated) = path_tracing_seconds(scene, error).filter(|_| error > 0.0)?;
    let how = if extrapolated { " (extrapolated as 1/√n from the samples that were run)" } else { "" };
    let first = ratio(seconds, ours.total_cpu())?;
    let bake = match first >= 1.0 {
        true => format!("{} times as long as bake and picture together", significant(first)),
        false => format!("{} of the time that bake and picture take together", percent(first)),
    };
    Some(format!(
        "Our best setting (`{}`) has an error of {}{below} in indirect light, with {} CPU seconds of bake and {} for \
         each picture after an edit. Path tracing takes {} CPU seconds{how} for the same error: {bake}, and {} times \
         as long as a picture after an edit.",
        ours.setting,
        percent(error),
        significant(ours.precompute.cpu),
        significant(ours.frame.cpu),
        significant(seconds),
        significant(ratio(seconds, ours.frame.cpu)?),
    ))
}

/// Returns `a / b`, or `None` if it is not finite.
fn ratio(a: f64, b: f64) -> Option<f64> {
    Some(a / b).filter(|ratio| ratio.is_finite())
}

fn path_tracing(scene: &SceneReport) -> Option<String> {
    let points = curve(scene, Method::PathTracing);
    let slope = exponent(points.iter().map(|p| [p.frame.cpu, p.errors.indirect]))?;
    if slope >= 0.0 {
        return Some(format!(
            "Path tracing's error does not fall with time here (exponent {slope:+.2}); -0.5 is expected."
        ));
    }
    Some(format!(
        "Path tracing's error falls with time to the power {slope:.2} (independent samples give -0.5): half the error \
         takes {} times as long.",
        significant(0.5f64.powf(1.0 / slope))
    ))
}

fn compare_with_thesis(scene: &SceneReport) -> Option<String> {
    let theirs =
        least(scene.points.iter().filter(|p| matches!(p.method, Method::ThesisDiffuse | Method::ThesisGlossy)))?;
    let ours = least(scene.points.iter().filter(|p| p.method.is_ours()))?;
    let [far, near] = [theirs, ours].map(|p| p.errors.indirect.max(scene.floors.indirect));
    Some(format!(
        "The thesis's best setting here ({}, `{}`) has an error of {}, {} times that of our best (`{}`), whose bake \
         takes {} times as long.",
        theirs.method.name().split(", more").next().unwrap_or_default(),
        theirs.setting,
        percent(far),
        significant(ratio(far, near)?),
        ours.setting,
        significant(ratio(ours.precompute.cpu, theirs.precompute.cpu)?),
    ))
}

/// Compares nested blocks with Haar wavelets at the same error tolerance of their rows.
fn compare_with_wavelets(scene: &SceneReport) -> Option<String> {
    let [nested, haar] = [Method::Compressed, Method::Haar].map(|method| curve(scene, method));
    let pairs = haar.iter().filter_map(|h| {
        let n = nested.iter().find(|n| n.setting == h.setting.replace(" --transfer haar", ""))?;
        Some((*n, *h))
    });
    let (nested, haar) = pairs.min_by(|p, q| p.1.errors.indirect.total_cmp(&q.1.errors.indirect))?;
    let times = |ratio: f64| format!("{} times", significant(ratio));
    Some(format!(
        "With the same error tolerance (`{}`), Haar wavelets take {} the memory of nested blocks and {} the CPU time \
         per picture; their error is {}, that of nested blocks {}.",
        nested.setting,
        times(ratio(haar.bytes as f64, nested.bytes as f64)?),
        times(ratio(haar.frame.cpu, nested.frame.cpu)?),
        percent(haar.errors.indirect),
        percent(nested.errors.indirect),
    ))
}

/// Returns the first point that no later point improves on by more than 10 %.
pub fn last_improvement<'a>(points: &[&'a Point]) -> Option<&'a Point> {
    let helped =
        |i: usize| points[i + 1..].iter().any(|p| p.errors.indirect < IMPROVEMENT_RATIO * points[i].errors.indirect);
    (0..points.len()).find(|&i| !helped(i)).map(|i| points[i])
}

fn convergence_limit(scene: &SceneReport, method: Method) -> Option<String> {
    let points = curve(scene, method);
    let [stop, last] = [last_improvement(&points)?, *points.last()?];
    if points.len() < 2 {
        return None;
    }
    let name = capitalized(method.name());
    if std::ptr::eq(stop, last) {
        return Some(format!(
            "{name}: still improving at the last setting (`{}`, {}).",
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

/// Returns the reason why more work along the curve does not reduce the error.
fn reason(scene: &SceneReport, method: Method, stop: &Point) -> String {
    let errors = stop.errors;
    if errors.indirect <= 0.0 {
        return "the ground truth measures no remaining error".into();
    }
    if errors.indirect < 2.0 * scene.floors.indirect {
        return format!("below {} the noise of the ground truth hides the error", percent(2.0 * scene.floors.indirect));
    }
    let radius = |p: &Point| p.spectral_radius.unwrap_or(0.0);
    let mut beyond = curve(scene, method).into_iter().skip_while(|p| p.setting != stop.setting);
    let diverges = |p: &&Point| radius(p) >= 1.0 && radius(p) > radius(stop) && p.errors.indirect > errors.indirect;
    if let Some(point) = beyond.find(diverges) {
        let [there, here] = [point, stop].map(|p| significant(radius(p)));
        return format!(
            "with `{}` its series diverges: the spectral radius of G is {there} there, {here} here",
            point.setting
        );
    }
    if errors.indirect_bias.abs() * scene.floors.mean > 0.5 * errors.indirect {
        return format!("the mean of the indirect light is off by {}", percent(errors.indirect_bias));
    }
    // Curves that refine something else.
    let others = [Method::GatherSamples, Method::Rays, Method::Compressed].into_iter().filter(|other| *other != method);
    let best =
        least(others.filter(|_| method.is_ours() || method == Method::Haar).flat_map(|other| curve(scene, other)));
    if let Some(best) = best.filter(|best| best.errors.indirect < IMPROVEMENT_RATIO * errors.indirect) {
        let name = best.method.name().trim_start_matches("ours, ");
        return format!(
            "the remaining error has another cause: with {name} it is {} (`{}`)",
            percent(best.errors.indirect),
            best.setting
        );
    }
    patches(stop)
}

/// Classifies an error: averaging 4x4 pixels preserves a smooth error and reduces per-pixel noise to a quarter.
fn patches(point: &Point) -> String {
    let share = point.errors.indirect_4x4 / point.errors.indirect;
    let kind = match share {
        s if s > 0.7 => "it lies in larger patches",
        s if s > 0.4 => "it is partly noise",
        _ => "it is per-pixel noise",
    };
    format!("{} of its error remains in means of 4x4 pixels: {kind}", percent(share))
}

fn not_finite(scene: &SceneReport) -> Option<String> {
    let point = scene.points.iter().max_by_key(|p| p.errors.non_finite).filter(|p| p.errors.non_finite > 0)?;
    Some(format!(
        "{} pixels of `{}` are infinite or not a number; its errors exclude them.",
        point.errors.non_finite, point.setting
    ))
}

fn slowest_and_fastest_edit(scene: &SceneReport) -> Option<String> {
    let changed: Vec<&EditTime> = scene.edits.iter().filter(|e| e.edit != "none").collect();
    let by = |p: &&&EditTime, q: &&&EditTime| p.median_ms.total_cmp(&q.median_ms);
    let (fast, slow) = (changed.iter().min_by(by)?, changed.iter().max_by(by)?);
    let pass = slow.passes.iter().max_by(|p, q| p.median_ms.total_cmp(&q.median_ms));
    let pass = pass.map_or_else(String::new, |pass| {
        format!(", where the pass \"{}\" takes {} ms", pass.name, significant(pass.median_ms))
    });
    let describe = |e: &EditTime| {
        format!("`{}` of a {} light ({} ms, {} shadows)", e.edit, e.light, significant(e.median_ms), e.shadows)
    };
    Some(format!("The fastest edit is {}; the slowest is {}{pass}.", describe(fast), describe(slow)))
}

fn maps_and_rays(scene: &SceneReport) -> Option<String> {
    let find = |shadows: &str| scene.edits.iter().find(|e| e.edit == "move_direct" && e.shadows == shadows);
    let (traced, map) = (find("traced")?, find("map")?);
    let ratio = map.median_ms / traced.median_ms;
    let (faster, slower, ratio) =
        if ratio >= 1.0 { ("traced shadows", "a map", ratio) } else { ("a map", "traced shadows", 1.0 / ratio) };
    Some(format!(
        "Without indirect light, moving a {} light is {} times as fast with {faster} as with {slower}.",
        traced.light,
        significant(ratio)
    ))
}

fn ablation(ablation: &Ablation) -> String {
    let [edit, shading] = [ablation.edit_ms, ablation.shading_ms].map(|ms| ms.map(significant));
    let [bytes, all_bytes] = ablation.bytes.map(|bytes| significant(1e-6 * bytes as f64));
    let same = match ablation.difference {
        0.0 => "the same, bit for bit".to_owned(),
        difference => format!("the same within {} of its mean", percent(difference)),
    };
    format!(
        "With the complete deep framebuffer (`--force-all`) the picture is {same}; moving a light takes {} ms instead \
         of {}, of which shading {} instead of {}; device memory is {all_bytes} MB instead of {bytes}.",
        edit[1], edit[0], shading[1], shading[0]
    )
}

pub(super) fn percent(share: f64) -> String {
    format!("{} %", significant(100.0 * share))
}

fn capitalized(text: &str) -> String {
    let mut letters = text.chars();
    letters.next().map_or_else(String::new, |first| first.to_uppercase().collect::<String>() + letters.as_str())
}

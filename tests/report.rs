//! `relume report`: the page says what was measured, and nothing else.

mod command;

use std::collections::HashMap;
use std::path::Path;

use command::{Run, folder, relume, shipped};
use relume::image::compare::{Pictures, Settings};
use relume::report::conclusions::{exponent, of_scene, path_tracing_seconds};
use relume::report::growth::{Cost, Growth};
use relume::report::stability::Stability;
use relume::report::thesis::{Preview, Thesis};
use relume::report::{
    Ablation, EditTime, Errors, Floors, Method, PassMs, Point, Report, SceneReport, Seconds, Skipped, tables, write,
};

/// Rows of a CSV file without quotes, by the names of its columns.
fn rows(path: &Path) -> Vec<HashMap<String, String>> {
    let text = std::fs::read_to_string(path).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
    let mut lines = text.lines().map(|line| line.split(',').map(str::to_owned).collect::<Vec<_>>());
    let names = lines.next().unwrap();
    lines.map(|cells| names.iter().cloned().zip(cells).collect()).collect()
}

/// A picture whose error is `error` and whose bake and frame take so many CPU seconds.
fn point(method: Method, setting: &str, [bake, frame]: [f64; 2], error: f64) -> Point {
    let seconds = |cpu| Seconds { cpu, wall: cpu / 2.0 };
    Point {
        method,
        setting: setting.into(),
        precompute: seconds(bake),
        frame: seconds(frame),
        bytes: 1000,
        multiply_adds: 500,
        held_out: method.is_ours().then_some(0.001),
        spectral_radius: None,
        load: 1.0,
        errors: Errors {
            indirect: error,
            indirect_4x4: error / 4.0,
            indirect_trimmed: error,
            indirect_bias: 0.0,
            whole: error / 2.0,
            flip: error / 3.0,
            non_finite: 0,
        },
        file: format!("pictures/{setting}.exr"),
    }
}

fn scene(points: Vec<Point>) -> SceneReport {
    SceneReport {
        name: "a <scene> & more".into(),
        triangles: 12_345,
        lights: 2,
        size: [8, 8],
        truth_samples: 64,
        floors: Floors::default(),
        points,
        skipped: Vec::new(),
        pictures: Vec::new(),
        edit_size: [8, 8],
        edits: Vec::new(),
        left_out: Vec::new(),
        ablation: None,
    }
}

fn report(scenes: Vec<SceneReport>) -> Report {
    let machine = vec![["processor".into(), "one, \"fast\"".into()]];
    Report {
        when: "2026-01-01".into(),
        command: "relume report".into(),
        quick: false,
        machine,
        scenes,
        thesis: Thesis::default(),
        glossy_alone: None,
        growth: Vec::new(),
        stability: Default::default(),
        extreme: String::new(),
        known_limits: "- none\n  at all".into(),
    }
}

/// Four pictures by path tracing at 1/sqrt(n), and two of ours.
fn measured() -> Vec<Point> {
    let traced = [1.0, 4.0, 16.0, 64.0].map(|s: f64| point(Method::PathTracing, "--spp", [0.1, s], 0.4 / s.sqrt()));
    let ours = [(576, 0.1), (2304, 0.02)]
        .map(|(n, e)| point(Method::GatherSamples, &format!("--gather {n}"), [f64::from(n) / 100.0, 0.01], e));
    traced.into_iter().chain(ours).collect()
}

#[test]
fn sentences_follow_the_numbers() {
    let said = of_scene(&scene(measured())).join("\n");
    assert!(said.contains("to the power -0.50"), "{said}");
    // 0.02 is 0.4 / sqrt(400), beyond the 64 that were run.
    assert!(said.contains("takes 400 CPU seconds (extrapolated as 1/√n"), "{said}");
    assert!(said.contains("Ours, more gather samples: still improving at the last setting"), "{said}");
    assert!(!said.contains("thesis") && !said.contains("Haar"), "{said}");

    let mut worse = measured();
    worse.last_mut().unwrap().errors.indirect = 0.095;
    let said = of_scene(&scene(worse)).join("\n");
    assert!(said.contains("Ours, more gather samples: stops improving at `--gather 576` (10.0 %)"), "{said}");
    assert!(said.contains("it is per-pixel noise"), "{said}");
    // 0.4 / sqrt(17.7) = 0.095: between pictures that were made.
    assert!(said.contains("takes 17.7 CPU seconds for the same error"), "{said}");

    let mut diverging = measured();
    for (gather, error, radius) in [(144, 0.5, 1.1), (576, 0.6, 1.5)] {
        let theirs = point(Method::ThesisDiffuse, &format!("--gather {gather}"), [3.0, 0.1], error);
        diverging.push(Point { spectral_radius: Some(radius), ..theirs });
    }
    let said = of_scene(&scene(diverging.clone())).join("\n");
    let no_sum = "stops improving at `--gather 144` (50.0 %), since with `--gather 576` its series diverges: the \
                  spectral radius of G is 1.50 there, 1.10 here";
    assert!(said.contains(no_sum), "{said}");
    let beside =
        "has an error of 50.0 %, 25.0 times that of our best (`--gather 2304`), whose bake takes 7.68 times as long";
    assert!(said.contains(beside), "{said}");
    diverging.last_mut().unwrap().spectral_radius = Some(1.1);
    let said = of_scene(&scene(diverging)).join("\n");
    assert!(!said.contains("diverges"), "it diverged before: {said}");
    assert_eq!(of_scene(&scene(Vec::new())), Vec::<String>::new());
}

/// Where a curve ends, and why: each reason from numbers that give no other.
#[test]
fn reasons_follow_the_numbers() {
    let ours = |method, setting: &str, error| point(method, setting, [10.0, 0.01], error);
    let curve = |errors: [f64; 2]| {
        let settings = ["--gather 1", "--gather 2"];
        settings.iter().zip(errors).map(|(s, e)| ours(Method::GatherSamples, s, e)).collect::<Vec<_>>()
    };
    let said = |points: Vec<Point>, floors: Floors| of_scene(&SceneReport { floors, ..scene(points) }).join("\n");
    let none = Floors::default();

    let floors = Floors { indirect: 0.06, ..none };
    assert!(said(curve([0.1, 0.1]), floors).contains("below 12.0 % the noise of the ground truth hides the error"));
    assert!(said(curve([0.1, 0.0]), none).contains("still improving at the last setting (`--gather 2`, 0 %)"));
    assert!(said(curve([0.0, 0.0]), none).contains("the ground truth measures no remaining error"));

    let biased = |bias: f64, mean: f64| {
        let mut points = curve([0.1, 0.1]);
        points[0].errors.indirect_bias = bias;
        said(points, Floors { mean, ..none })
    };
    assert!(biased(0.09, 0.9).contains("the mean of the indirect light is off by 9.00 %"));
    assert!(
        !biased(0.09, 0.5).contains("the mean of the indirect light"),
        "in units of the error it is less than half of it"
    );

    let with = |method, error| said([curve([0.1, 0.1]), vec![ours(method, "--rays 9", error)]].concat(), none);
    let other = "the remaining error has another cause: with more rays it is 5.00 % (`--rays 9`)";
    assert!(with(Method::Rays, 0.05).contains(other));
    assert!(with(Method::Compressed, 0.05).contains("with less compression it is 5.00 %"));
    assert!(!with(Method::Rays, 0.095).contains("another cause"), "that is as good as the same");

    let spread = |share: f64| {
        let mut points = curve([0.1, 0.1]);
        points[0].errors.indirect_4x4 = share * 0.1;
        said(points, none)
    };
    assert!(spread(0.8).contains("it lies in larger patches"));
    assert!(spread(0.5).contains("it is partly noise"));

    let mut broken = curve([0.1, 0.05]);
    broken[1].errors.non_finite = 7;
    assert!(said(broken, none).contains("7 pixels of `--gather 2` are infinite or not a number"));
}

/// Errors that the truth cannot tell from none.
#[test]
fn no_sentence_divides_by_nothing() {
    let mut points = measured();
    points.last_mut().unwrap().errors.indirect = 0.0;
    let without_floor = of_scene(&scene(points.clone())).join("\n");
    assert!(!without_floor.contains("inf") && !without_floor.contains("NaN"), "{without_floor}");
    let floors = Floors { indirect: 0.02, ..Floors::default() };
    let said = of_scene(&SceneReport { floors, ..scene(points.clone()) }).join("\n");
    assert!(
        said.contains("has an error of 2.00 % (below this the noise of the ground truth hides errors) in"),
        "{said}"
    );
    assert!(said.contains("takes 400 CPU seconds"), "{said}");
    points.iter_mut().for_each(|p| p.frame.cpu = 0.0);
    let said = of_scene(&SceneReport { floors, ..scene(points) }).join("\n");
    assert!(!said.contains("inf") && !said.contains("NaN"), "{said}");
}

#[test]
fn edits_wavelets_and_what_is_left_out_are_told_by_their_numbers() {
    let edit = |name: &str, shadows: &str, median_ms, passes: Vec<PassMs>| EditTime {
        edit: name.into(),
        light: "point".into(),
        lights: 2,
        shadows: shadows.into(),
        median_ms,
        p95_ms: median_ms,
        best_ms: median_ms,
        passes,
    };
    let pass = PassMs { name: "trace".into(), on: "CPU".into(), median_ms: 3.0, yardstick_ms: None };
    let mut scene = scene(vec![
        point(Method::Compressed, "--error 0.1", [1.0, 0.01], 0.1),
        point(Method::Haar, "--error 0.1 --transfer haar", [1.0, 0.05], 0.2),
    ]);
    scene.points[1].bytes = 4000;
    scene.edits = vec![edit("color", "traced", 1.0, vec![]), edit("move_direct", "traced", 4.0, vec![pass])];
    scene.ablation =
        Some(Ablation { difference: 0.0, edit_ms: [4.0, 9.0], shading_ms: [1.0, 3.0], bytes: [5_000_000, 20_000_000] });
    let said = of_scene(&scene).join("\n");
    for sentence in [
        "Haar wavelets take 4.00 times the memory of nested blocks and 5.00 times the CPU time per picture; their \
         error is 20.0 %, that of nested blocks 10.0 %",
        "the slowest is `move_direct` of a point light (4.00 ms, traced shadows), where the pass \"trace\" takes 3.00 \
         ms.",
        "the picture is the same, bit for bit; moving a light takes 9.00 ms instead of 4.00, of which shading 3.00 \
         instead of 1.00; device memory is 20.0 MB instead of 5.00.",
    ] {
        assert!(said.contains(sentence), "{sentence}\nis not in\n{said}");
    }
    // Times of passes are not told where the driver's are wrong.
    scene.edits.push(edit("move_direct", "map", 8.0, vec![]));
    scene.ablation.as_mut().unwrap().difference = 0.01;
    let said = of_scene(&scene).join("\n");
    for sentence in [
        "the slowest is `move_direct` of a point light (8.00 ms, map shadows).",
        "moving a point light is 2.00 times as fast with traced shadows as with a map",
        "the same within 1.00 % of its mean",
    ] {
        assert!(said.contains(sentence), "{sentence}\nis not in\n{said}");
    }
}

#[test]
fn time_to_an_error_is_between_pictures_or_beyond_them() {
    let scene = scene(measured());
    let (seconds, extrapolated) = path_tracing_seconds(&scene, 0.1).unwrap();
    assert!((seconds - 16.0).abs() < 1e-9 && !extrapolated, "{seconds}");
    let (seconds, extrapolated) = path_tracing_seconds(&scene, 0.8).unwrap();
    assert!((seconds - 0.25).abs() < 1e-9 && extrapolated, "{seconds}");
    let squares = [1.0, 2.0, 3.0].map(|x: f64| [x, 5.0 * x * x]);
    assert!((exponent(squares).unwrap() - 2.0).abs() < 1e-12);
    assert_eq!(exponent([[1.0, 1.0]]), None);
}

#[test]
fn a_page_has_no_chart_without_data_and_takes_names_literally() {
    let dir = folder();
    let mut empty = scene(Vec::new());
    empty.skipped.push(Skipped { what: "`--gather 9`".into(), why: "it takes 3 < 4 GB".into() });
    write(dir.path(), &report(vec![empty])).unwrap();
    let page = std::fs::read_to_string(dir.path().join("index.html")).unwrap();
    assert!(!page.contains("<svg") && !page.contains("<h3>Error against"), "{page}");
    assert!(page.contains("a &lt;scene&gt; &amp; more") && !page.contains("<scene>"));
    assert!(page.contains("<code>--gather 9</code>: it takes 3 &lt; 4 GB"));
    assert!(page.contains("12,345 triangles") && page.contains("<li>none\nat all</li>"));
    let machine = std::fs::read_to_string(dir.path().join("machine.csv")).unwrap();
    let how = "measured,2026-01-01\ncommand,relume report\n";
    assert_eq!(machine, format!("what,value\n{how}processor,\"one, \"\"fast\"\"\"\n"));

    // A picture without error has no place on a logarithmic axis, but one in the table.
    let mut points = measured();
    points[0].errors.indirect = 0.0;
    let report = report(vec![SceneReport { name: "s".into(), ..scene(points) }]);
    write(dir.path(), &report).unwrap();
    let page = std::fs::read_to_string(dir.path().join("index.html")).unwrap();
    assert_eq!(page.matches("<svg").count(), 4);
    assert_charts_hold_their_text(&page);
    assert!(!page.contains("NaN") && !page.contains("inf "), "{page}");
    assert_eq!(rows(&dir.path().join("s.errors.csv")).len(), 6);
    assert_eq!(tables(&report).len(), 3, "machine, scenes, errors; no edits, nothing left out, all measured");
}

/// Letters of 0.6 em, wider than those of most text in wide fonts, reach neither the end of a chart nor what is written
/// along its left side.
fn assert_charts_hold_their_text(page: &str) {
    let after = |text: &str, mark: &str| text.split_once(mark).map(|(_, rest)| rest.to_owned());
    let number = |text: &str| text.split([' ', '"', '>']).next().unwrap().parse::<f64>().unwrap();
    for svg in page.split("<svg").skip(1).map(|svg| svg.split("</svg>").next().unwrap()) {
        let width = number(&after(svg, "viewBox=\"0 0 ").unwrap());
        for text in svg.split("<text").skip(1).filter(|text| !text.contains("rotate")) {
            let (attributes, said) = text.split("</text>").next().unwrap().split_once('>').unwrap();
            let x = number(&after(attributes, " x=").unwrap());
            let long = 14.0 * 0.6 * said.chars().count() as f64;
            let [left, right] = match after(attributes, "text-anchor=") {
                None => [0.0, x + long],
                Some(anchor) if anchor.starts_with("end") => [x - long - 20.0, x],
                Some(_) => [x - long / 2.0, x + long / 2.0],
            };
            assert!(left >= 0.0 && right <= width, "{said:?} takes {left} to {right} of {width}");
        }
    }
}

#[test]
fn growth_and_stability_are_told_by_their_numbers() {
    let dir = folder();
    let cost = |name: &str, expected, power: f64| {
        let points = [1.0, 10.0, 100.0].map(|n: f64| [n, 3.0 * n.powf(power)]).into();
        Cost { name: name.into(), expected, points }
    };
    let curves = vec![cost("even", 1.0, 1.0), cost("steep", 1.0, 1.4)];
    let scene =
        "a box whose name is as long as its maker's breath & as wide as two charts beside each other".to_string();
    let growth = Growth { of: "gather samples".into(), scene: scene.clone(), curves };
    let stability = |albedo, thesis_radius| Stability {
        albedo,
        radius: 0.9 * albedo,
        thesis_radius,
        residual: 1e-9,
        bounces: Some((10.0 * albedo) as u32),
        left_after_five: albedo / 2.0,
        single: 1e-7,
        half: 1e-4 * albedo,
    };
    let mut report = report(Vec::new());
    report.growth = vec![growth];
    report.stability = ("box".into(), vec![stability(0.1, 0.4), stability(0.8, 1.25)]);
    write(dir.path(), &report).unwrap();
    let page = std::fs::read_to_string(dir.path().join("index.html")).unwrap();
    for said in [
        "even: grows with the number of gather samples to the power 1.00 (expected at most 1), from 3.00 ms at 1 to \
         300 ms at 100.",
        "steep: grows with the number of gather samples to the power 1.40 (expected at most 1; exceeded)",
        "never exceeds the albedo, up to 0.8",
        "diverges from an albedo of 0.8 on, where its spectral radius is 1.25",
        "after 1 bounces at albedo 0.1 and after 8 at 0.8; five bounces omit 40.0 % there",
        "have an error of at most 1e-7; with factors in half precision, as on the device, at most 8e-5",
    ] {
        assert!(page.contains(said), "{said}\nis not in\n{page}");
    }
    assert!(page.contains(&format!("<figcaption>{}</figcaption>", scene.replace('&', "&amp;"))));
    assert_eq!(page.matches("<svg").count(), 1);
    assert_charts_hold_their_text(&page);
    assert_eq!(rows(&dir.path().join("scaling.csv")).len(), 6);
    assert_eq!(rows(&dir.path().join("stability.csv"))[1]["thesis_spectral_radius"], "1.25");
}

#[test]
fn the_thesis_stands_beside_what_was_measured() {
    let dir = folder();
    let preview = |lights: usize, preview_ms, wall| Preview {
        scene: format!("balls-{lights}"),
        triangles: 9922,
        lights,
        size: [720, 480],
        preview_ms,
        final_picture: Seconds { cpu: 2.0 * wall, wall },
    };
    let traced = point(Method::PathTracing, "--spp 256", [0.5, 8.0], 0.1);
    let cornell = SceneReport { name: "cornell-glossy".into(), size: [256, 256], ..scene(vec![traced]) };
    let mut report = report(vec![cornell]);
    report.thesis.previews = vec![preview(2, 4.0, 1.0), preview(16, 5.0, 3.0)];
    write(dir.path(), &report).unwrap();
    let page = std::fs::read_to_string(dir.path().join("index.html")).unwrap();
    for said in [
        "balls-2: the preview after an edit takes 4.00 ms; a final picture takes 1.00 s on the same machine, 250 times",
        "balls: with 16 lights a preview takes 1.25 times as long as with 2, a final picture 3.00 times",
    ] {
        assert!(page.contains(said), "{said}\nis not in\n{page}");
    }
    let previews = rows(&dir.path().join("table-5.1.csv"));
    assert_eq!([&previews[0]["thesis_final_s"], &previews[1]["thesis_preview_ms"]], ["18.39", "2 to 3"]);
    // Four times the pixels, four times the samples, after the same BVH.
    let transfers = rows(&dir.path().join("table-5.2.csv"));
    assert_eq!([&transfers[0]["thesis_s"], &transfers[0]["with_1024_samples_at_512x512_cpu_s"]], ["5321.0", "128.5"]);
}

#[test]
fn a_quick_report_holds_what_was_measured_and_goes_on_where_it_was() {
    let folder = folder();
    let dir = folder.path().join("report");
    // Each option differs from its default, and its effect is looked for below.
    let (rig, cache) = (folder.path().join("two.toml"), folder.path().join("cache"));
    let light =
        |name: &str| format!("[[light]]\nname = \"{name}\"\nkind = \"point\"\nposition = [0, 1, 0]\nintensity = 2\n");
    std::fs::write(&rig, light("one") + &light("two")).unwrap();
    let run = || {
        let mut command = relume();
        command.args(["report", "--quick", "--size", "24x24", "--visibility", "map", "--budget", "1", "--layers", "2"]);
        command.args(["--seed", "3", "--threads", "3", "-o"]).arg(&dir).arg("--rig").arg(&rig);
        Run::of(command.arg("--cache").arg(&cache).arg(shipped("cornell-diffuse.glb"))).done()
    };
    let first = run();
    assert_eq!(first.stdout.trim(), dir.join("index.html").display().to_string());
    assert!(first.stderr.contains("the budget holds 0 light images"), "{}", first.stderr);
    let page = std::fs::read_to_string(dir.join("index.html")).unwrap();
    assert_charts_hold_their_text(&page);
    assert!(!page.contains("<script") && !page.contains("http"), "needs something else");
    assert!(!page.contains("NaN") && !page.contains("src=\"pictures"));
    assert!(page.contains("prefers-color-scheme: dark") && page.contains("Known limits"));

    let points = rows(&dir.join("cornell-diffuse.errors.csv"));
    let count = |method: Method| points.iter().filter(|row| row["method"] == method.id()).count();
    for method in Method::ALL {
        // Nothing in this box is glossy.
        assert_eq!(count(method) > 1, method != Method::ThesisGlossy, "{}", method.id());
    }
    let drawn = points.iter().filter(|row| row["flip"] != "0.0").count();
    let chart =
        page.split("Perceptual difference, after the bake</text>").nth(1).unwrap().split("</svg>").next().unwrap();
    assert_eq!(chart.matches("</title></path>").count(), drawn);

    // Pictures are those whose errors are told.
    let mut halves: Vec<_> = std::fs::read_dir(dir.join("truth")).unwrap().map(|f| f.unwrap().path()).collect();
    halves.sort();
    for row in &points {
        let picture = dir.join(&row["picture"]);
        let pictures = Pictures::read(&picture, &halves[0], Some(&halves[1]), "indirect", None).unwrap();
        let error = pictures.figures(Settings::default()).rel_rmse.unwrap();
        let told: f64 = row["indirect_rel_rmse"].parse().unwrap();
        assert!((error - told).abs() <= 1e-4 * error, "{}: {error} in {}, {told} told", row["setting"], row["picture"]);
    }
    let ablation = &rows(&dir.join("ablation.csv"))[0];
    assert_eq!(ablation["largest_difference_over_mean"], "0.0", "{ablation:?}");
    let bytes = ["bytes", "bytes_nothing_left_out"].map(|name| ablation[name].parse::<u64>().unwrap());
    assert!(bytes[1] > bytes[0], "{bytes:?}");
    let edits = rows(&dir.join("cornell-diffuse.edits.csv"));
    for edit in ["color", "toggle", "move", "move_direct", "none"] {
        assert!(edits.iter().any(|row| row["edit"] == edit && row["pass"] == "all"), "{edit}");
    }
    assert!(edits.iter().all(|row| row["shadows"] != "map" || row["pass"] == "all"), "lavapipe's are wrong");
    // The shadows that were asked for, and for one edit the others.
    for row in &edits {
        assert!(row["shadows"] == "map" || row["edit"] == "move_direct", "{row:?}");
    }
    assert!(edits.iter().any(|row| row["shadows"] == "map") && edits.iter().any(|row| row["shadows"] == "traced"));
    let read = |name: &str| std::fs::read_to_string(dir.join(name)).unwrap();
    assert_eq!(rows(&dir.join("scenes.csv"))[0]["lights"], "2", "--rig");
    assert!(read("cornell-diffuse.left-out.csv").contains("\"1 layers, "), "--layers");
    assert!(read("machine.csv").contains("\nthreads used,3\nseed,3\n"), "--threads, --seed");
    assert!(std::fs::read_dir(&cache).unwrap().count() >= 2, "--cache keeps a deep framebuffer and a transfer");

    let stability = rows(&dir.join("stability.csv"));
    for row in &stability {
        let [albedo, radius]: [f64; 2] = ["albedo", "spectral_radius"].map(|name| row[name].parse().unwrap());
        assert!(radius <= albedo * (1.0 + 1e-5) && radius > 0.5 * albedo, "{row:?}"); // a closed box but for its front
    }
    assert_eq!(stability.len(), 7);
    assert!(rows(&dir.join("scaling.csv")).iter().any(|row| row["against"] == "pixels"));

    let before = std::fs::read(dir.join("measured.json")).unwrap();
    run();
    assert!(before == std::fs::read(dir.join("measured.json")).unwrap(), "measured again");
    assert_eq!(points, rows(&dir.join("cornell-diffuse.errors.csv")));

    std::fs::write(dir.join("measured.json"), "{\"half").unwrap();
    run!("report", "--quick", "-o", &dir, "--size", "24x24", shipped("cornell-diffuse.glb")).failed(&["measured.json"]);
}

#[test]
fn what_cannot_be_reported_is_one_error() {
    let folder = folder();
    let box_ = shipped("cornell-diffuse.glb");
    run!("report", "-o", folder.path(), &box_, &box_).failed(&["cornell-diffuse.glb", "overwrite"]);
    run!("report", "-o", folder.path(), folder.path().join("none.glb")).failed(&["none.glb"]);
    run!("report", "-o", folder.path(), "--camera", "behind", &box_).failed(&["behind"]);
    let file = folder.path().join("file");
    std::fs::write(&file, "").unwrap();
    run!("report", "--quick", "-o", &file, &box_).failed(&["file"]);
    run!("report", &box_).refused("--output");
}

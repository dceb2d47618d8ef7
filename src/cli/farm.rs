//! `relume farm`: a job for render farms, as an Open Job Description template [OpenJD 2023].

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use clap::{CommandFactory, Parser};
use relume::bake::compression::MAX_PARTS;
use relume::scene::{Rig, Scene};
use relume::session::Survey;
use relume::{Error, Result};
use serde_json::{Value, json};

use super::options::{SceneOptions, ViewOptions};
use super::output_file::{as_file_name, write_json};
use super::progress::Terminal;
use super::stdout::out;

#[derive(clap::Args)]
pub struct Args {
    /// Scenes: .glb or .gltf files.
    #[arg(required = true, value_name = "SCENE")]
    scenes: Vec<PathBuf>,
    /// Cameras, each of which is a shot: their names, or all of each scene [default: the first of each scene].
    #[arg(long, value_name = "all|NAME", num_args = 1..)]
    cameras: Vec<String>,
    /// Rig files, or USD files; each shot gets a picture under the lights of each. Without: under those of the scene.
    #[arg(long, value_name = "RIG", num_args = 1..)]
    lights: Vec<PathBuf>,
    /// Parts of each bake.
    #[arg(long, value_name = "N", default_value_t = 8, value_parser = clap::value_parser!(u16).range(1..=MAX_PARTS as i64))]
    parts: u16,
    /// Adds a step that compares settings for each shot with `relume report`, under the first rig. quick: small
    /// pictures, minutes a shot; full: hours.
    #[arg(long, value_enum, value_name = "quick|full", hide_possible_values = true)]
    report: Option<Report>,
    /// Processors that each task asks the farm for, and uses.
    #[arg(long, value_name = "N", default_value_t = 4, value_parser = clap::value_parser!(u16).range(1..=1024))]
    threads: u16,
    /// Folder of the job, which gets a file template.json.
    #[arg(short, long, value_name = "JOB")]
    output: PathBuf,
    /// After --: options of `relume bake` for all shots, like --size or --error.
    #[arg(last = true, value_name = "OPTION")]
    options: Vec<String>,
}

#[derive(Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum Report {
    Quick,
    Full,
}

pub const AFTER_HELP: &str = "\
The job has the steps Plan, Shared, Parts, Join and Pictures, and Report with --report. All machines need relume, the scenes and the rigs at the \
same paths, or path mapping rules, and a common cache folder. docs/farm.md tells more.";

/// One picture's scene and camera.
struct Shot {
    scene: String,
    camera: String,
    /// For names of files.
    name: String,
    /// Bytes of memory that a bake takes, and CPU seconds; estimated.
    memory: f64,
    seconds: f64,
}

/// Parses options as `relume bake` would.
#[derive(Parser)]
#[command(name = "relume farm ... --", no_binary_name = true, disable_help_flag = true)]
struct BakeOptions {
    #[command(flatten)]
    options: SceneOptions,
}

pub fn run(args: &Args) -> Result<()> {
    let options = bake_options(&args.options);
    check_options(args, &options)?;
    let rigs = args.lights.iter().map(|path| Ok((absolute(path)?, Rig::load(path)?))).collect::<Result<Vec<_>>>()?;
    check_names(rigs.iter().map(|(path, _)| stem(Path::new(path))), "--lights", "rigs")?;
    // Only a dome among the lights makes a difference to a bake.
    let bake_rig_path = rigs.iter().find(|(_, rig)| rig.has_domes()).map(|(path, _)| path.as_str());
    let mut shots = Vec::new();
    for path in &args.scenes {
        shots.extend(shots_of(path, &args.cameras, bake_rig_path, &options)?);
    }
    check_names(shots.iter().map(|shot| shot.name.clone()), "scenes and cameras", "shots")?;
    for (what, count, most) in [("shots", shots.len(), MAX_SHOTS), ("rigs", rigs.len(), MAX_RIGS)] {
        if count > most {
            let reason = format!("a job can have {most} {what}, not {count}: write several jobs");
            return Err(Error::invalid("farm", reason));
        }
    }
    let template = template(args, &options.view, &shots, &rigs);
    std::fs::create_dir_all(&args.output).map_err(Error::io("create", &args.output))?;
    let path = args.output.join("template.json");
    write_json(&path, &template)?;
    let seconds: f64 = shots.iter().map(|shot| shot.seconds).sum();
    out!(
        "{}: {} shots, {} tasks, about {:.0} CPU seconds",
        path.display(),
        shots.len(),
        task_count(args, &shots),
        seconds
    )?;
    out!("openjd check {}", path.display())?;
    out!("openjd run {} --step Pictures --run-dependencies", path.display())?;
    match args.report {
        Some(_) => out!("openjd run {} --step Report --run-dependencies", path.display()),
        None => Ok(()),
    }
}

/// Ends the program where they are no options of a bake, as the command line does with its own.
fn bake_options(options: &[String]) -> SceneOptions {
    BakeOptions::try_parse_from(options)
        .unwrap_or_else(|error| error.format(&mut BakeOptions::command()).exit())
        .options
}

/// Refuses options that the job sets itself or that its steps cannot have.
fn check_options(args: &Args, options: &SceneOptions) -> Result<()> {
    let refuse = |reason: &str| Err(Error::invalid("options of the bake", reason));
    let SceneOptions { view, cache, .. } = options;
    if view.camera.is_some() || view.threads.is_some() || cache.cache.is_some() || cache.no_cache {
        return refuse(
            "the job sets --camera, --threads and --cache itself: use --cameras and --threads before the --",
        );
    }
    if !options.settings()?.indirect.is_some_and(|indirect| indirect.plan([1, 1], 1, 1).is_divisible()) {
        return refuse("only nested blocks can be baked in parts: leave out --gi off, --method and --transfer");
    }
    if args.options.iter().any(|option| option.contains("{{")) {
        return refuse("a job cannot hold {{");
    }
    Ok(())
}

/// The shots of a scene.
fn shots_of(path: &Path, cameras: &[String], rig: Option<&str>, options: &SceneOptions) -> Result<Vec<Shot>> {
    let scene = Scene::load(path)?;
    let names: Vec<&str> = scene.cameras.iter().map(|camera| camera.name.as_str()).collect();
    let refuse = |reason: String| Err(Error::import(path, reason));
    let wanted: Vec<&str> = match cameras {
        [] => names.iter().copied().take(1).collect(),
        [all] if all == "all" => names.clone(),
        some => some.iter().map(String::as_str).collect(),
    };
    if wanted.is_empty() {
        return refuse("has no camera; `relume rig SCENE --rig RIG -o OUT.glb` gives it one".into());
    }
    let mut shots = Vec::new();
    for camera in wanted {
        if names.iter().filter(|name| **name == camera).count() > 1 {
            return refuse(format!("has several cameras called \"{camera}\""));
        }
        if camera == "all" || camera.contains("{{") {
            return refuse(format!("a job cannot hold a camera called \"{camera}\""));
        }
        let mut settings = options.settings()?;
        settings.open.camera = Some(camera.to_owned());
        let survey = Survey::new(path, rig.map(Path::new), &settings, &Terminal::default())?;
        let (memory, seconds) = survey.bake_cost();
        let name = format!("{}.{}", stem(path), as_file_name(camera));
        shots.push(Shot { scene: absolute(path)?, camera: camera.to_owned(), name, memory, seconds });
    }
    Ok(shots)
}

fn task_count(args: &Args, shots: &[Shot]) -> usize {
    shots.len() * (4 + usize::from(args.report.is_some()) + usize::from(args.parts))
}

fn template(args: &Args, view: &ViewOptions, shots: &[Shot], rigs: &[(String, Rig)]) -> Value {
    // Farms map parameters that are paths to where workers have them.
    let references: Vec<String> = (1..=rigs.len()).map(rig_reference).collect();
    let bake_rig = rigs.iter().position(|(_, rig)| rig.has_domes());
    let bake_rig: Vec<&str> = bake_rig.iter().flat_map(|&index| ["--rig", &references[index]]).collect();
    let part = format!("{{{{Task.Param.Part}}}}/{}", args.parts);
    let bake = |own: &[&str]| -> Vec<String> {
        let own = bake_rig.iter().chain(own).map(|text| (*text).to_owned());
        args.options.iter().cloned().chain(own).collect()
    };
    let picture = match rigs {
        [] => "{{Param.Pictures}}/{{Task.Param.Shot}}.exr",
        // relume itself puts the rig's name there.
        _ => "{{Param.Pictures}}/{{Task.Param.Shot}}.{rig}.exr",
    };
    let picture_rigs = references.iter().flat_map(|rig| ["--rig", rig]);
    let render = picture_rigs.chain(["-o", picture]).map(str::to_owned);
    let render = args.options.iter().cloned().chain(render).collect();
    let seconds = shots.iter().map(|shot| shot.seconds).fold(0.0, f64::max);
    let shared = SHARED_SHARE * seconds;
    let each = PARTS_SHARE * seconds / f64::from(args.parts);
    let mut steps = vec![
        Step::new("Plan", "plan", bake(&[]), "Opens each scene and tells what its bake needs."),
        Step::new("Shared", "bake", bake(&["--shared"]), "Makes what parts share.").after("Plan").takes(shared),
        Step::new("Parts", "bake", bake(&["--part", &part]), "Bakes a part.").after("Shared").takes(each),
        Step::new("Join", "bake", bake(&["--join"]), "Makes the bake from its parts.")
            .after("Parts")
            .takes(JOIN_SHARE * seconds),
        Step::new("Pictures", "render", render, "Renders a shot under all lights.").after("Join"),
    ];
    if let Some(report) = args.report {
        let first = references.first().map(|rig| ["--rig", rig]);
        let output = ["-o", "{{Param.Reports}}/{{Task.Param.Shot}}"];
        let quick = (report == Report::Quick).then_some("--quick");
        let own = quick.into_iter().chain(first.into_iter().flatten()).chain(output).map(str::to_owned);
        let arguments = view.arguments().into_iter().chain(own).collect();
        steps.push(Step::new("Report", "report", arguments, "Compares settings for a shot.").after("Plan"));
    }
    let steps: Vec<Value> = steps.iter().map(|step| step.template(args, shots, rigs)).collect();
    let mut template = json!({
        "specificationVersion": "jobtemplate-2023-09",
        "name": format!("relume {}", shots[0].name).chars().take(128).collect::<String>(),
        "description": "Bakes scenes in parts, then makes pictures of them.",
        "parameterDefinitions": [
            { "name": "Relume", "type": "STRING", "default": "relume", "description": "The program on the workers." },
            { "name": "Cache", "type": "PATH", "objectType": "DIRECTORY", "dataFlow": "INOUT", "default": "cache",
              "description": "Folder for baked data, the same for all workers." },
            { "name": "Pictures", "type": "PATH", "objectType": "DIRECTORY", "dataFlow": "OUT", "default": "pictures",
              "description": "Folder for pictures." },
        ],
        "jobEnvironments": [{
            "name": "relume",
            "description": "Ends a session where relume cannot be started; tells its version.",
            "script": { "actions": { "onEnter": { "command": "{{Param.Relume}}", "args": ["--version"] } } },
        }],
        "steps": steps,
    });
    if args.report.is_some() {
        let parameters = template["parameterDefinitions"].as_array_mut().expect("it was made as an array");
        parameters.push(json!({
            "name": "Reports", "type": "PATH", "objectType": "DIRECTORY", "dataFlow": "OUT", "default": "reports",
            "description": "Folder for reports.",
        }));
    }
    template
}

/// One step of the job: a command for each shot, or for each part of its bake.
struct Step {
    name: &'static str,
    command: &'static str,
    /// Beside those that all steps have.
    arguments: Vec<String>,
    description: &'static str,
    /// The step that must have ended.
    after: Option<&'static str>,
    /// CPU seconds of a task at most, estimated.
    seconds: Option<f64>,
}

impl Step {
    fn new(name: &'static str, command: &'static str, arguments: Vec<String>, description: &'static str) -> Self {
        Self { name, command, arguments, description, after: None, seconds: None }
    }

    fn after(self, step: &'static str) -> Self {
        Self { after: Some(step), ..self }
    }

    fn takes(self, seconds: f64) -> Self {
        Self { seconds: Some(seconds), ..self }
    }

    fn template(&self, args: &Args, shots: &[Shot], rigs: &[(String, Rig)]) -> Value {
        let mut parameters = vec![
            json!({ "name": "Scene", "type": "PATH", "range": list(shots, |shot| &shot.scene) }),
            json!({ "name": "Camera", "type": "STRING", "range": list(shots, |shot| &shot.camera) }),
            json!({ "name": "Shot", "type": "STRING", "range": list(shots, |shot| &shot.name) }),
        ];
        let mut combination = "(Scene, Camera, Shot)".to_owned();
        if self.arguments.iter().any(|argument| argument.contains("Task.Param.Part")) {
            parameters.push(json!({ "name": "Part", "type": "INT", "range": format!("1-{}", args.parts) }));
            combination += " * Part";
        }
        for (number, (path, _)) in
            (1..).zip(rigs).filter(|(number, _)| self.arguments.contains(&rig_reference(*number)))
        {
            parameters.push(json!({ "name": format!("Rig{number}"), "type": "PATH", "range": [path] }));
            combination += &format!(" * Rig{number}");
        }
        let threads = args.threads.to_string();
        let place = ["--camera={{Task.Param.Camera}}", "--cache", "{{Param.Cache}}", "--threads", &threads];
        let own = self.arguments.iter().map(String::as_str);
        let arguments: Vec<&str> = [self.command, "{{Task.Param.Scene}}"].into_iter().chain(place).chain(own).collect();
        let mut run = json!({ "command": "{{Param.Relume}}", "args": arguments });
        let mut description = self.description.to_owned();
        if let Some(seconds) = self.seconds {
            run["timeout"] = json!((SLOWEST * seconds).max(SHORTEST_TIMEOUT).ceil() as u64);
            description += &format!(" Up to about {seconds:.0} CPU seconds.");
        }
        let memory = shots.iter().map(|shot| shot.memory).fold(0.0, f64::max);
        let mut step = json!({
            "name": self.name,
            "description": description,
            "hostRequirements": { "amounts": [
                { "name": "amount.worker.vcpu", "min": args.threads },
                { "name": "amount.worker.memory", "min": (memory / f64::from(1 << 20)).ceil() },
            ] },
            "parameterSpace": { "taskParameterDefinitions": parameters, "combination": combination },
            "script": { "actions": { "onRun": run } },
        });
        if let Some(after) = self.after {
            step["dependencies"] = json!([{ "dependsOn": after }]);
        }
        step
    }
}

/// The path of a rig in arguments, counted from 1.
fn rig_reference(number: usize) -> String {
    format!("{{{{Task.Param.Rig{number}}}}}")
}

/// Values of a task's parameter. A task has at most 16 parameters, of which four are others
/// (Open Job Description 2023-09, TaskParameterDefinition).
const MAX_SHOTS: usize = 1024;
const MAX_RIGS: usize = 12;
/// What the steps take of a whole bake at most, in the measured scenes (docs/farm.md).
const SHARED_SHARE: f64 = 0.25;
const PARTS_SHARE: f64 = 1.2;
const JOIN_SHARE: f64 = 0.2;
/// A task that takes longer than its estimate times this hangs; estimates are rough, and machines differ.
const SLOWEST: f64 = 20.0;
/// Seconds.
const SHORTEST_TIMEOUT: f64 = 3600.0;

fn list(shots: &[Shot], of: fn(&Shot) -> &String) -> Vec<&str> {
    shots.iter().map(|shot| of(shot).as_str()).collect()
}

/// An absolute path that templates can hold: braces in pairs are theirs.
fn absolute(path: &Path) -> Result<String> {
    let absolute = std::path::absolute(path).map_err(Error::io("find", path))?;
    match absolute.to_str().filter(|text| !text.contains("{{")) {
        Some(text) => Ok(text.to_owned()),
        None => Err(Error::import(path, "a job cannot hold this name: rename the file or its folder")),
    }
}

fn stem(path: &Path) -> String {
    as_file_name(&path.file_stem().unwrap_or_default().to_string_lossy())
}

/// Refuses names that would be the same for two pictures.
fn check_names(names: impl Iterator<Item = String>, option: &str, what: &str) -> Result<()> {
    let mut seen = BTreeSet::new();
    for name in names {
        if !seen.insert(name.clone()) {
            return Err(Error::invalid(option, format!("two {what} would have pictures called {name}")));
        }
    }
    Ok(())
}

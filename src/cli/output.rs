//! Where pictures go: which passes, as EXR layers or one PNG each.

use std::collections::HashSet;
use std::path::PathBuf;

use glam::Vec3;
use relume::gpu::PassTime;
use relume::image::{Image, exr, png};
use relume::relight::{Layers, Picture, Relighter, Request, ToneMap, exposure};
use relume::scene::{LightKind, Rig};
use relume::{Error, Result};

use super::final_gather::Refinement;
use super::options::{Exposure, check_extension};
use super::output_file::make_parent;

/// One picture that a render can give.
#[derive(Clone, Debug, PartialEq)]
pub enum PassKind {
    Beauty,
    Direct,
    Reflection,
    Indirect,
    /// What the pixels' specular lobes make of indirect light.
    IndirectGlossy,
    Emission,
    /// Everything that one light does, by its name.
    Light(String),
    /// Expected error of each pixel after final gathering: root mean square over its channels.
    ExpectedError,
}

/// What `--passes` asks for.
#[derive(Clone, Debug)]
pub enum Passes {
    All,
    List(Vec<PassKind>),
}

pub fn parse_passes(text: &str) -> Result<Passes, String> {
    if text == "all" {
        return Ok(Passes::All);
    }
    let parse = |name: &str| match name {
        "beauty" => Ok(PassKind::Beauty),
        "direct" => Ok(PassKind::Direct),
        "reflection" => Ok(PassKind::Reflection),
        "emission" => Ok(PassKind::Emission),
        "indirect" => Ok(PassKind::Indirect),
        "indirect_glossy" => Ok(PassKind::IndirectGlossy),
        "expected_error" => Ok(PassKind::ExpectedError),
        _ => match name.strip_prefix("light:") {
            Some(light) => Ok(PassKind::Light(light.to_owned())),
            None => Err(format!(
                "{name}: expected beauty, direct, reflection, indirect, indirect_glossy, emission, expected_error, \
                 light:NAME or all"
            )),
        },
    };
    let list = text.split(',').map(|name| parse(name.trim())).collect::<Result<Vec<_>, _>>()?;
    match list.iter().enumerate().find(|(i, pass)| list[..*i].contains(pass)) {
        Some((_, twice)) => Err(format!("{} is listed twice", twice.name())),
        None => Ok(Passes::List(list)),
    }
}

/// What of a picture there is.
#[derive(Clone, Copy)]
pub struct Has {
    pub emission: bool,
    pub indirect: bool,
    pub expected_error: bool,
}

impl Passes {
    /// The passes of a rig, whose lights may be asked for by name.
    fn of(&self, rig: &Rig, has: Has) -> Result<Vec<PassKind>> {
        use PassKind::*;
        let lights = &rig.lights;
        match self {
            Self::All => {
                // All emitters are one layer.
                let each = lights.iter().filter(|light| light.kind != LightKind::Emitter);
                let each = each.map(|light| Light(light.name.clone()));
                let emission = has.emission.then_some(Emission);
                let indirect = if has.indirect { &[Indirect, IndirectGlossy][..] } else { &[] };
                let always = [Beauty, Direct, Reflection].iter().chain(indirect).cloned();
                let error = has.expected_error.then_some(ExpectedError);
                Ok(always.chain(emission).chain(error).chain(each).collect())
            }
            Self::List(list) => {
                for pass in list {
                    if !has.indirect && matches!(pass, Indirect | IndirectGlossy) {
                        let reason = "with --gi off there is no indirect light to write";
                        return Err(Error::invalid(format!("--passes {}", pass.name()), reason));
                    }
                    if *pass == ExpectedError && !has.expected_error {
                        let reason = "comes from final gathering: add --final or --seconds";
                        return Err(Error::invalid(format!("--passes {}", pass.name()), reason));
                    }
                    if let Light(name) = pass {
                        find_light(rig, name)?;
                    }
                }
                let mut list = list.clone();
                list.sort_by_key(|pass| *pass != Beauty); // first, so that its parts add up to it
                Ok(list)
            }
        }
    }
}

/// Index of the light that `--passes light:NAME` asks for.
pub fn find_light(rig: &Rig, name: &str) -> Result<usize> {
    let found = rig.lights.iter().position(|light| light.name == name);
    found.ok_or_else(|| {
        let names: Vec<_> = rig.lights.iter().map(|light| light.name.as_str()).collect();
        let reason = match names.is_empty() {
            true => "there are no lights".into(),
            false => format!("there is no such light; the lights are: {}", names.join(", ")),
        };
        Error::invalid(format!("--passes light:{name}"), reason)
    })
}

impl PassKind {
    fn name(&self) -> String {
        match self {
            Self::Beauty => "beauty".into(),
            Self::Direct => "direct".into(),
            Self::Reflection => "reflection".into(),
            Self::Indirect => "indirect".into(),
            Self::IndirectGlossy => "indirect_glossy".into(),
            Self::Emission => "emission".into(),
            Self::ExpectedError => "expected_error".into(),
            Self::Light(name) => format!("light.{name}"),
        }
    }

    /// What EXR calls its layer; the beauty is the unnamed one.
    fn layer_name(&self) -> String {
        if *self == Self::Beauty { String::new() } else { self.name() }
    }

    /// What `{pass}` stands for in the name of a file. A light called `../key` stays in the folder.
    fn file_name(&self) -> String {
        self.name().replace(['/', '\\', '\0'], "_")
    }

    /// What this pass asks of the relighter.
    fn request(&self, rig: &Rig) -> Request {
        match self {
            Self::Beauty | Self::ExpectedError => Request::default(),
            Self::Direct => Layers::Direct.into(),
            Self::Reflection => Layers::Reflection.into(),
            Self::Indirect | Self::IndirectGlossy => Layers::Indirect.into(),
            Self::Emission => Picture::Emission.into(),
            Self::Light(name) => Picture::Light(find_light(rig, name).expect("names were checked")).into(),
        }
    }
}

/// A file name that may hold `{rig}` and `{pass}`.
#[derive(Clone, Debug)]
pub struct Template(pub PathBuf);

impl Template {
    /// Refuses, before any work is done, what cannot hold the pictures asked for.
    pub fn check(&self, rig_count: usize, passes: &Passes) -> Result<()> {
        check_extension(&self.0, &["exr", "png"])?;
        let needs = |reason: &str| Err(Error::invalid(self.0.display().to_string(), reason));
        if rig_count > 1 && !self.holds("{rig}") {
            return needs("with several rigs, the output name needs {rig}");
        }
        let several = match passes {
            Passes::All => true,
            Passes::List(list) => list.len() > 1,
        };
        if several && !self.is_exr() && !self.holds("{pass}") {
            return needs("a PNG file has one pass; put {pass} into the name, or write an EXR file");
        }
        Ok(())
    }

    /// Names that are not UTF-8 hold no placeholders and stay as they are.
    fn fill(&self, rig: &str, pass: &str) -> PathBuf {
        let fill = |text: &str| PathBuf::from(text.replace("{rig}", rig).replace("{pass}", pass));
        self.0.to_str().map_or_else(|| self.0.clone(), fill)
    }

    fn holds(&self, placeholder: &str) -> bool {
        self.0.to_str().is_some_and(|text| text.contains(placeholder))
    }

    fn is_exr(&self) -> bool {
        check_extension(&self.0, &["exr"]).is_ok()
    }
}

/// One file to write.
struct Target {
    path: PathBuf,
    passes: Vec<PassKind>,
    /// Whether the file's name tells its one pass: the layer needs no name then.
    named: bool,
}

impl Job<'_> {
    pub fn shows(&self, pass: &PassKind) -> bool {
        self.targets.iter().any(|target| target.passes.contains(pass))
    }
}

/// All pictures of one rig.
pub struct Job<'a> {
    pub rig: &'a Rig,
    targets: Vec<Target>,
}

/// What to write for each rig and its name. Two pictures for one file are an error.
pub fn plan<'a>(passes: &Passes, template: &Template, rigs: &[(String, &'a Rig)], has: Has) -> Result<Vec<Job<'a>>> {
    let mut paths = HashSet::new();
    let mut jobs = Vec::new();
    for (name, rig) in rigs {
        let passes = passes.of(rig, has)?;
        let named = template.holds("{pass}");
        let target = |passes: &[PassKind], pass: &str| {
            let path = template.fill(name, pass);
            Target { path, passes: passes.into(), named }
        };
        let targets: Vec<_> = match named {
            true => passes.chunks(1).map(|pass| target(pass, &pass[0].file_name())).collect(),
            false => vec![target(&passes, "")],
        };
        if let Some(twice) = targets.iter().find(|target| !paths.insert(target.path.clone())) {
            let reason = "two rigs or two lights give this file name; rename one of them";
            return Err(Error::invalid(twice.path.display().to_string(), reason));
        }
        jobs.push(Job { rig, targets });
    }
    Ok(jobs)
}

/// Written pictures, and figures of them for `--stats`.
#[derive(Default)]
pub struct Written {
    pub files: Vec<PathBuf>,
    /// Values of the beauty below 0.
    pub negative: usize,
    /// When passes ran: one list for each picture.
    pub frames: Vec<Vec<PassTime>>,
}

/// Who makes pictures: with all indirect light, and with glossy one where it is asked for.
pub struct Relighters {
    pub whole: Relighter,
    pub glossy: Option<Relighter>,
}

impl Relighters {
    /// By pass, how many of the values that it left were infinite or not a number, in all pictures.
    pub fn non_finite(&self) -> Vec<(&'static str, u32)> {
        let mut counts = self.whole.non_finite();
        if let Some(glossy) = &self.glossy {
            counts.iter_mut().zip(glossy.non_finite()).for_each(|(sum, (_, count))| sum.1 += count);
        }
        counts
    }

    fn of(&mut self, pass: &PassKind) -> &mut Relighter {
        match (pass, &mut self.glossy) {
            (PassKind::IndirectGlossy, Some(glossy)) => glossy,
            _ => &mut self.whole,
        }
    }
}

/// How pictures become 8 bits.
pub struct Display {
    /// Fixed by the first picture that needs it.
    pub exposure: Exposure,
    pub tone_map: ToneMap,
}

/// Renders a rig and writes its files. `refine` may improve its indirect light.
pub fn write(
    relighters: &mut Relighters,
    job: &Job,
    size: (usize, usize),
    display: &mut Display,
    refine: &mut dyn FnMut(&mut Relighter) -> Result<Option<Refinement>>,
    written: &mut Written,
) -> Result<()> {
    relighters.whole.set_rig(job.rig)?;
    relighters.glossy.as_mut().map_or(Ok(()), |glossy| glossy.set_rig(job.rig))?;
    let refinement = refine(&mut relighters.whole)?;
    let errors = refinement.as_ref().map_or(&[][..], |refinement| &refinement.errors);
    let beauty = linear(relighters, &PassKind::Beauty, written)?;
    written.negative += beauty.iter().flatten().filter(|v| **v < 0.0).count();
    let stops = match display.exposure {
        Exposure::Stops(stops) => stops,
        Exposure::Auto => {
            let stops = exposure::automatic(&beauty);
            tracing::info!("exposure: {stops:.2} stops");
            stops
        }
    };
    display.exposure = Exposure::Stops(stops);

    for Target { path, passes, named } in &job.targets {
        make_parent(path)?;
        if check_extension(path, &["exr"]).is_ok() {
            let mut image = Image { width: size.0, height: size.1, layers: Vec::new() };
            for pass in passes {
                let pixels = match pass {
                    PassKind::Beauty => beauty.clone(),
                    PassKind::ExpectedError => errors.iter().map(|error| [*error; 3]).collect(),
                    _ => linear(relighters, pass, written)?,
                };
                image.push_layer(if *named { String::new() } else { pass.layer_name() }, pixels);
            }
            exr::write(path, &image)?;
        } else {
            match &passes[0] {
                PassKind::ExpectedError => {
                    let shown = |error: &f32| {
                        let [r, g, b] = display.tone_map.display(Vec3::splat(stops.exp2() * error));
                        [r, g, b, 255]
                    };
                    png::write(path, size.0, size.1, &errors.iter().map(shown).collect::<Vec<_>>())?;
                }
                _ => {
                    let relighter = relighters.of(&passes[0]);
                    let request = Request { exposure: stops, tone_map: display.tone_map, ..passes[0].request(job.rig) };
                    png::write(path, size.0, size.1, relighter.display(request)?)?;
                    written.frames.push(relighter.times().to_vec());
                }
            }
        }
        written.files.push(path.clone());
    }
    Ok(())
}

fn linear(relighters: &mut Relighters, pass: &PassKind, written: &mut Written) -> Result<Vec<[f32; 3]>> {
    let relighter = relighters.of(pass);
    let request = pass.request(relighter.rig());
    let pixels = relighter.linear(request)?.to_vec();
    written.frames.push(relighter.times().to_vec());
    Ok(pixels)
}

//! Where pictures go: which passes, as EXR layers or one PNG each.

use std::collections::HashSet;
use std::path::{Path, PathBuf};

use relume::gpu::PassTime;
use relume::image::cryptomatte::Cryptomatte;
use relume::image::exr::{self, ExrMetadata};
use relume::image::{Image, png};
use relume::relight::output::exposure;
use relume::relight::{Layers, Picture, Relighter, Request, ToneMap};
use relume::scene::rig::without_dots;
use relume::scene::{LightKind, Rig};
use relume::session::Refinement;
use relume::{Error, Result};

use super::data_passes::{Data, Surfaces};
use super::options::{Exposure, check_extension};
use super::output_file::{as_file_name, make_parent};

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
    /// A part of it.
    Part(String, LightPart),
    /// The parts of all lights, and emission.
    Parts,
    /// Of the surface at the centre of a pixel.
    Data(Data),
    /// Its base colour.
    Albedo,
    /// Cryptomattes of objects and of materials.
    Cryptomatte,
    /// Expected error of each pixel after final gathering: root mean square over its channels.
    ExpectedError,
}

/// A part of a light; all of them add up to what the light does.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LightPart {
    /// Direct light that surfaces reflect diffusely.
    DirectDiffuse,
    DirectSpecular,
    /// Direct light in mirrors.
    Reflection,
    IndirectDiffuse,
    IndirectSpecular,
}

impl LightPart {
    const ALL: [Self; 5] =
        [Self::DirectDiffuse, Self::DirectSpecular, Self::Reflection, Self::IndirectDiffuse, Self::IndirectSpecular];

    fn name(self) -> &'static str {
        match self {
            Self::DirectDiffuse => "direct.diffuse",
            Self::DirectSpecular => "direct.specular",
            Self::Reflection => "reflection",
            Self::IndirectDiffuse => "indirect.diffuse",
            Self::IndirectSpecular => "indirect.specular",
        }
    }

    fn is_indirect(self) -> bool {
        matches!(self, Self::IndirectDiffuse | Self::IndirectSpecular)
    }

    /// The layers that it is part of.
    fn layers(self) -> Layers {
        match self {
            Self::DirectDiffuse | Self::DirectSpecular => Layers::Direct,
            Self::Reflection => Layers::Reflection,
            Self::IndirectDiffuse | Self::IndirectSpecular => Layers::Indirect,
        }
    }
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
        "parts" => Ok(PassKind::Parts),
        "depth" => Ok(PassKind::Data(Data::Depth)),
        "normal" => Ok(PassKind::Data(Data::Normal)),
        "position" => Ok(PassKind::Data(Data::Position)),
        "albedo" => Ok(PassKind::Albedo),
        "cryptomatte" => Ok(PassKind::Cryptomatte),
        _ => match name.strip_prefix("light:") {
            Some(light) => Ok(PassKind::Light(light.to_owned())),
            None => Err(format!(
                "{name}: expected beauty, direct, reflection, indirect, indirect_glossy, emission, expected_error, \
                 light:NAME, parts, depth, normal, position, albedo, cryptomatte or all"
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
                let parts = || {
                    let shine = lights.iter().filter(|light| light.kind != LightKind::Emitter);
                    let of = LightPart::ALL.into_iter().filter(|part| has.indirect || !part.is_indirect());
                    let parts = shine.flat_map(|light| of.clone().map(|part| Part(light.name.clone(), part)));
                    let emission = (has.emission && !list.contains(&Emission)).then_some(Emission);
                    parts.chain(emission).collect::<Vec<_>>()
                };
                let expand = |pass: &PassKind| if *pass == Parts { parts() } else { vec![pass.clone()] };
                let mut list: Vec<PassKind> = list.iter().flat_map(expand).collect();
                list.sort_by_key(|pass| *pass != Beauty); // first, so that its parts add up to it
                Ok(list)
            }
        }
    }
}

/// Index of the light that `--passes light:NAME` asks for.
pub fn find_light(rig: &Rig, name: &str) -> Result<usize> {
    let found = rig.lights.iter().position(|light| light.name == without_dots(name));
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
            Self::Part(name, part) => format!("light.{name}.{}", part.name()),
            Self::Parts => "parts".into(),
            Self::Data(data) => data.name().into(),
            Self::Albedo => "albedo".into(),
            Self::Cryptomatte => "cryptomatte".into(),
        }
    }

    /// Whether it needs indirect light of the specular lobes alone.
    pub fn is_glossy(&self) -> bool {
        match self {
            Self::IndirectGlossy => true,
            Self::Part(_, part) => part.is_indirect(),
            _ => false,
        }
    }

    /// Whether it needs direct light without specular lobes.
    pub fn is_split(&self) -> bool {
        matches!(self, Self::Part(_, LightPart::DirectDiffuse | LightPart::DirectSpecular))
    }

    /// Whether it shows a light alone.
    pub fn is_of_one_light(&self) -> bool {
        matches!(self, Self::Light(_) | Self::Part(..))
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
            Self::Beauty | Self::ExpectedError | Self::Parts => Request::default(),
            Self::Data(_) | Self::Albedo | Self::Cryptomatte => Request::default(),
            Self::Part(name, part) => Request { layers: part.layers(), ..Self::Light(name.clone()).request(rig) },
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
            Passes::List(list) => list.len() > 1 || list.contains(&PassKind::Parts),
        };
        if several && !self.is_exr() && !self.holds("{pass}") {
            return needs("a PNG file has one pass; put {pass} into the name, or write an EXR file");
        }
        let is_exr_only = |pass: &PassKind| {
            matches!(pass, PassKind::Parts | PassKind::Data(_) | PassKind::Albedo | PassKind::Cryptomatte)
        };
        if let Passes::List(list) = passes
            && let Some(pass) = list.iter().find(|pass| is_exr_only(pass))
            && !self.is_exr()
        {
            return needs(&format!("the pass {} is for EXR files", pass.name()));
        }
        Ok(())
    }

    /// The name for the pictures of one of several cameras.
    pub fn of_camera(&self, camera: &str) -> Result<PathBuf> {
        match self.0.to_str().filter(|_| self.holds("{camera}")) {
            Some(text) => Ok(PathBuf::from(text.replace("{camera}", &as_file_name(camera)))),
            None => {
                let reason = "with several cameras, the output name needs {camera}";
                Err(Error::invalid(self.0.display().to_string(), reason))
            }
        }
    }

    /// Names that are not UTF-8 hold no placeholders and stay as they are.
    fn fill(&self, rig: &str, pass: &str) -> PathBuf {
        let fill = |text: &str| PathBuf::from(text.replace("{rig}", rig).replace("{pass}", pass));
        self.0.to_str().map_or_else(|| self.0.clone(), fill)
    }

    fn holds(&self, placeholder: &str) -> bool {
        self.0.to_str().is_some_and(|text| text.contains(placeholder))
    }

    pub fn is_exr(&self) -> bool {
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
    pub fn files(&self) -> impl Iterator<Item = &Path> {
        self.targets.iter().map(|target| target.path.as_path())
    }

    pub fn shows(&self, is: &dyn Fn(&PassKind) -> bool) -> bool {
        self.targets.iter().any(|target| target.passes.iter().any(is))
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

/// Who makes pictures: with all light, and where it is asked for with glossy indirect light, and with diffuse direct
/// light.
pub struct Relighters {
    pub whole: Relighter,
    pub glossy: Option<Relighter>,
    pub diffuse: Option<Relighter>,
}

impl Relighters {
    /// By pass, how many of the values that it left were infinite or not a number, in all pictures.
    pub fn non_finite(&self) -> Vec<(&'static str, u32)> {
        let mut counts = self.whole.non_finite();
        for other in self.glossy.iter().chain(&self.diffuse) {
            counts.iter_mut().zip(other.non_finite()).for_each(|(sum, (_, count))| sum.1 += count);
        }
        counts
    }

    fn of(&mut self, pass: &PassKind) -> &mut Relighter {
        match (pass, &mut self.glossy) {
            (PassKind::IndirectGlossy, Some(glossy)) => glossy,
            _ => &mut self.whole,
        }
    }

    fn set_rig(&mut self, rig: &Rig) -> Result<()> {
        let Self { whole, glossy, diffuse } = self;
        [Some(whole), glossy.as_mut(), diffuse.as_mut()].into_iter().flatten().try_for_each(|one| one.set_rig(rig))
    }
}

/// How pictures become PNG files.
pub struct Display {
    /// Fixed by the first picture that needs it.
    pub exposure: Exposure,
    pub tone_map: ToneMap,
    pub png_depth: png::Depth,
}

/// Renders a rig and writes its files. `refine` may improve its indirect light.
pub fn write(
    relighters: &mut Relighters,
    job: &Job,
    display: &mut Display,
    surfaces: &Surfaces,
    exr_metadata: &ExrMetadata,
    refine: &mut dyn FnMut(&mut Relighter) -> Result<Option<Refinement>>,
    written: &mut Written,
) -> Result<()> {
    let size = surfaces.size();
    relighters.set_rig(job.rig)?;
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
            let mut image = Image { width: size.0, height: size.1, ..Image::default() };
            let mut metadata = exr_metadata.clone();
            for pass in passes {
                let pixels = match pass {
                    PassKind::Data(data) => {
                        image.data.extend(surfaces.channels(*data));
                        continue;
                    }
                    PassKind::Cryptomatte => {
                        for Cryptomatte { channels, texts } in surfaces.cryptomattes() {
                            image.data.extend(channels);
                            metadata.texts.extend(texts);
                        }
                        continue;
                    }
                    PassKind::Beauty => beauty.clone(),
                    PassKind::Albedo => surfaces.albedo(),
                    PassKind::ExpectedError => errors.iter().map(|error| [*error; 3]).collect(),
                    PassKind::Part(_, part) => light_part(relighters, pass, *part, written)?,
                    _ => linear(relighters, pass, written)?,
                };
                image.push_layer(if *named { String::new() } else { pass.layer_name() }, pixels);
            }
            exr::write_with_metadata(path, &image, &metadata)?;
        } else {
            let Display { tone_map, png_depth, .. } = &*display;
            let mut pixels = match &passes[0] {
                PassKind::ExpectedError => errors.iter().map(|error| [*error; 3]).collect(),
                pass if *png_depth == png::Depth::Eight && !matches!(tone_map, ToneMap::View(_)) => {
                    // The window's pixels to the last bit: the device makes them.
                    let relighter = relighters.of(pass);
                    let request = Request { exposure: stops, tone_map: tone_map.clone(), ..pass.request(job.rig) };
                    png::write(path, size.0, size.1, relighter.display(request)?)?;
                    written.frames.push(relighter.times().to_vec());
                    written.files.push(path.clone());
                    continue;
                }
                PassKind::Beauty => beauty.clone(),
                pass => linear(relighters, pass, written)?,
            };
            pixels.as_flattened_mut().iter_mut().for_each(|value| *value *= stops.exp2());
            tone_map.display(&mut pixels);
            png::write_display(path, size, &pixels, *png_depth, tone_map.is_srgb())?;
        }
        written.files.push(path.clone());
    }
    Ok(())
}

/// A part of a light. Diffuse and specular parts add up to the whole, as one of them is what the other leaves.
fn light_part(
    relighters: &mut Relighters,
    pass: &PassKind,
    part: LightPart,
    written: &mut Written,
) -> Result<Vec<[f32; 3]>> {
    let request = pass.request(relighters.whole.rig());
    let (other, is_rest) = match part {
        LightPart::Reflection => return linear(relighters, pass, written),
        LightPart::DirectDiffuse => (&mut relighters.diffuse, false),
        LightPart::DirectSpecular => (&mut relighters.diffuse, true),
        LightPart::IndirectSpecular => (&mut relighters.glossy, false),
        LightPart::IndirectDiffuse => (&mut relighters.glossy, true),
    };
    let other = other.as_mut().expect("it was made for such passes").linear(request)?.to_vec();
    if !is_rest {
        return Ok(other);
    }
    let rest = |(whole, other): ([f32; 3], [f32; 3])| [0, 1, 2].map(|c| whole[c] - other[c]);
    Ok(linear(relighters, pass, written)?.into_iter().zip(other).map(rest).collect())
}

fn linear(relighters: &mut Relighters, pass: &PassKind, written: &mut Written) -> Result<Vec<[f32; 3]>> {
    let relighter = relighters.of(pass);
    let request = pass.request(relighter.rig());
    let pixels = relighter.linear(request)?.to_vec();
    written.frames.push(relighter.times().to_vec());
    Ok(pixels)
}

//! Where pictures go: which passes, as EXR layers or one PNG each.

use std::path::{Path, PathBuf};

use relume::image::{Image, Layer, exr, png};
use relume::relight::{Layers, Picture, Relighter, exposure};
use relume::{Error, Result};

use super::options::{Exposure, check_extension};

/// One picture that a render can give.
#[derive(Clone, Debug, PartialEq)]
pub enum PassKind {
    Beauty,
    Direct,
    Reflection,
    Emission,
    /// Everything that one light does, by its name.
    Light(String),
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
        "indirect" | "indirect_glossy" => Err(format!("{name}: this version has no indirect light")),
        _ => match name.strip_prefix("light:") {
            Some(light) => Ok(PassKind::Light(light.to_owned())),
            None => Err(format!("{name}: expected beauty, direct, reflection, emission, light:NAME or all")),
        },
    };
    text.split(',').map(|name| parse(name.trim())).collect::<Result<_, _>>().map(Passes::List)
}

impl Passes {
    fn resolve(&self, relighter: &Relighter) -> Result<Vec<PassKind>> {
        use PassKind::*;
        let lights = &relighter.rig().lights;
        match self {
            Self::All => {
                let each = lights.iter().map(|light| Light(light.name.clone()));
                let emission = relighter.has_emission().then_some(Emission);
                Ok([Beauty, Direct, Reflection].into_iter().chain(emission).chain(each).collect())
            }
            Self::List(list) => {
                for pass in list {
                    if let Light(name) = pass
                        && !lights.iter().any(|light| light.name == *name)
                    {
                        let names: Vec<_> = lights.iter().map(|light| light.name.as_str()).collect();
                        let reason = format!("no such light; there are: {}", names.join(", "));
                        return Err(Error::invalid(format!("--passes light:{name}"), reason));
                    }
                }
                Ok(list.clone())
            }
        }
    }
}

impl PassKind {
    /// What EXR calls its layer; the beauty is the unnamed one.
    fn layer_name(&self) -> String {
        match self {
            Self::Beauty => String::new(),
            Self::Direct => "direct".into(),
            Self::Reflection => "reflection".into(),
            Self::Emission => "emission".into(),
            Self::Light(name) => format!("light.{name}"),
        }
    }

    /// What `{pass}` stands for in the name of a file.
    fn file_name(&self) -> String {
        match self {
            Self::Beauty => "beauty".into(),
            _ => self.layer_name(),
        }
    }

    /// Tells the relighter which layers this pass shows, and which picture of them.
    fn choose(&self, relighter: &mut Relighter) -> Picture {
        relighter.set_layers(match self {
            Self::Direct => Layers::Direct,
            Self::Reflection => Layers::Reflection,
            _ => Layers::All,
        });
        match self {
            Self::Emission => Picture::Emission,
            Self::Light(name) => {
                let light = relighter.rig().lights.iter().position(|light| light.name == *name);
                Picture::Light(light.expect("names were checked"))
            }
            _ => Picture::Whole,
        }
    }
}

/// A file name that may hold `{rig}` and `{pass}`.
#[derive(Clone, Debug)]
pub struct Template(pub PathBuf);

impl Template {
    pub fn check(&self, rig_count: usize) -> Result<()> {
        check_extension(&self.0, &["exr", "png"])?;
        let text = self.0.to_string_lossy();
        if rig_count > 1 && !text.contains("{rig}") {
            return Err(Error::invalid(text, "several rigs need an output name with {rig} in it"));
        }
        Ok(())
    }

    fn fill(&self, rig: &str, pass: &str) -> PathBuf {
        PathBuf::from(self.0.to_string_lossy().replace("{rig}", rig).replace("{pass}", pass))
    }

    fn has_pass(&self) -> bool {
        self.0.to_string_lossy().contains("{pass}")
    }
}

/// A written picture's figures for `--stats`.
#[derive(Default)]
pub struct Written {
    pub files: Vec<PathBuf>,
    /// Values in the beauty that are NaN or infinite.
    pub non_finite: usize,
    pub negative: usize,
}

/// Renders `passes` of one rig into `template`. `exposure` is fixed by the first picture that needs it.
pub fn write(
    relighter: &mut Relighter,
    passes: &Passes,
    template: &Template,
    rig: &str,
    size: (usize, usize),
    exposure: &mut Exposure,
) -> Result<Written> {
    let passes = passes.resolve(relighter)?;
    let is_exr = check_extension(&template.0, &["exr"]).is_ok();
    if !is_exr && !template.has_pass() && passes.len() > 1 {
        return Err(Error::invalid(
            template.0.display().to_string(),
            "a PNG holds one pass; put {pass} into the name, or write an EXR",
        ));
    }
    let mut written = Written::default();
    let picture = PassKind::Beauty.choose(relighter);
    let beauty = relighter.linear(picture)?;
    written.non_finite = beauty.iter().flatten().filter(|v| !v.is_finite()).count();
    written.negative = beauty.iter().flatten().filter(|v| **v < 0.0).count();
    let stops = match *exposure {
        Exposure::Stops(stops) => stops,
        Exposure::Auto => exposure::automatic(beauty),
    };
    *exposure = Exposure::Stops(stops);

    let mut image = Image { width: size.0, height: size.1, layers: Vec::new() };
    for pass in &passes {
        let picture = pass.choose(relighter);
        let path = template.fill(rig, &pass.file_name());
        make_parent(&path)?;
        if !is_exr {
            png::write(&path, size.0, size.1, relighter.display(picture, stops)?)?;
            written.files.push(path);
        } else if template.has_pass() {
            exr::write(&path, &Image::single(size.0, size.1, relighter.linear(picture)?.to_vec()))?;
            written.files.push(path);
        } else {
            image.layers.push(Layer { name: pass.layer_name(), pixels: relighter.linear(picture)?.to_vec() });
        }
    }
    if !image.layers.is_empty() {
        let path = template.fill(rig, "");
        make_parent(&path)?;
        exr::write(&path, &image)?;
        written.files.push(path);
    }
    Ok(written)
}

/// Makes the folder that a file goes to.
fn make_parent(path: &Path) -> Result<()> {
    match path.parent() {
        Some(parent) if !parent.as_os_str().is_empty() => {
            std::fs::create_dir_all(parent).map_err(Error::io("create", parent))
        }
        _ => Ok(()),
    }
}

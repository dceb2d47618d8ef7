//! Options of indirect light.

use clap::ValueEnum;
use relume::bake::transport::Outgoing;
use relume::session::{ERROR, Form, IndirectSettings, THESIS_BOUNCES};
use relume::{Error, Result};

/// How indirect light is computed.
#[derive(clap::Args, Clone)]
#[command(next_help_heading = "Indirect light")]
pub struct TransferOptions {
    /// Indirect light. off: none. diffuse: gather samples send light equally in all directions. glossy: they send it
    /// with the gloss of their materials.
    #[arg(long, value_enum, default_value = "glossy", hide_possible_values = true)]
    pub gi: Gi,
    /// How indirect light is calculated. robust: relume's own method. thesis: the method as printed in the thesis of
    /// Yang, 2007.
    #[arg(long, value_enum, default_value = "robust", hide_possible_values = true)]
    pub method: MethodName,
    /// Number of gather samples: the surface points from which light bounces to the surfaces in the picture [default:
    /// 2304 to 16384, from the number of pixels and --error; 2304 in dense form. `relume plan` gives the reason].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=1_000_000))]
    pub gather: Option<u32>,
    /// Rays for each row of the transfer matrix, with --method robust. More rays give less noise [default: 128 to 4096,
    /// from the number of pixels and --error; 1024 in dense form].
    #[arg(long, value_name = "K", value_parser = clap::value_parser!(u32).range(1..=65_536))]
    pub rays: Option<u32>,
    /// Basis of the light that leaves a gather sample. sh1, sh4, sh9, sh16, sh25, sh36, sh49: this number of spherical
    /// harmonics. svdN: N terms of a singular value decomposition, with --method thesis [default: what each material
    /// needs].
    #[arg(long, value_name = "BASIS", value_parser = parse_basis)]
    pub basis: Option<Basis>,
    /// How relume stores and applies the transfer matrix. This matrix carries light from gather samples to pixels.
    #[arg(long, value_enum, default_value = "auto")]
    pub transfer: FormName,
    /// Target for the relative error of the compressed transfer. The error is the mean over point lights to which the
    /// compression was not fitted.
    #[arg(long, value_name = "E", default_value_t = ERROR, value_parser = parse_error)]
    pub error: f64,
    /// Number of indirect bounces, counted at the pixel. 1: from the light to a surface, then to the pixel. inf: all
    /// bounces [default: inf; 5 with --method thesis].
    #[arg(long, value_name = "N|inf", value_parser = parse_bounces)]
    pub bounces: Option<Bounces>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Gi {
    Off,
    Diffuse,
    Glossy,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum MethodName {
    Thesis,
    Robust,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum FormName {
    /// The same as nested.
    Auto,
    /// All elements (dense form): for few gather samples and small pictures.
    Dense,
    /// Nested blocks of low rank.
    Nested,
    /// The largest wavelets of each row, as many as --error needs. This is the published form, for comparison.
    Haar,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Basis {
    Harmonics(u8),
    SingularValues(usize),
}

/// Indirect bounces counted at the pixel; all of them without a number.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Bounces(pub Option<u32>);

impl TransferOptions {
    /// `None` without indirect light, an error where options exclude each other.
    pub fn settings(&self) -> Result<Option<IndirectSettings>> {
        let refuse = |option: &str, reason: &str| Err(Error::invalid(option, reason));
        let diffuse = match self.gi {
            Gi::Off => return Ok(None),
            Gi::Diffuse => true,
            Gi::Glossy => false,
        };
        if diffuse && self.basis.is_some() {
            return refuse("--basis", "--gi diffuse always has one function; leave --basis out");
        }
        let outgoing = |functions| if diffuse { Outgoing::Diffuse } else { Outgoing::Glossy { functions } };
        let gather = self.gather;
        Ok(Some(match self.method {
            MethodName::Robust => IndirectSettings::Robust {
                outgoing: match self.basis {
                    None => outgoing(None),
                    Some(Basis::Harmonics(count)) => outgoing(Some(count)),
                    Some(Basis::SingularValues(_)) => return refuse("--basis", "svdN works only with --method thesis"),
                },
                form: match self.transfer {
                    FormName::Dense => Form::Dense,
                    FormName::Auto | FormName::Nested => Form::Nested(self.error),
                    FormName::Haar => Form::Haar(self.error),
                },
                gather,
                rays: self.rays,
                bounces: self.bounces.and_then(|bounces| bounces.0),
            },
            MethodName::Thesis => {
                let compressed = match self.transfer {
                    FormName::Nested => Some("--transfer nested"),
                    FormName::Haar => Some("--transfer haar"),
                    FormName::Auto | FormName::Dense => None,
                };
                if let Some(option) = compressed {
                    return refuse(option, "--method thesis is always dense; leave --transfer out");
                }
                IndirectSettings::Thesis {
                    outgoing: outgoing(None),
                    terms: match self.basis {
                        None => None,
                        Some(Basis::SingularValues(count)) => Some(count),
                        Some(Basis::Harmonics(_)) => return refuse("--basis", "shN works only with --method robust"),
                    },
                    gather,
                    bounces: match self.bounces {
                        None => THESIS_BOUNCES,
                        Some(Bounces(Some(count))) => count,
                        Some(Bounces(None)) => {
                            return refuse(
                                "--bounces inf",
                                "--method thesis has a fixed number of bounces; give a number",
                            );
                        }
                    },
                }
            }
        }))
    }
}

fn parse_error(text: &str) -> std::result::Result<f64, String> {
    let error = text.parse().ok().filter(|error| (1e-6..=1.0).contains(error));
    error.ok_or_else(|| "expected a number from 0.000001 to 1, like 0.01".into())
}

pub fn parse_bounces(text: &str) -> Result<Bounces, String> {
    match text {
        "inf" => Ok(Bounces(None)),
        _ => text.parse().map(|bounces| Bounces(Some(bounces))).map_err(|_| "expected a whole number, or inf".into()),
    }
}

fn parse_basis(text: &str) -> Result<Basis, String> {
    let count = |prefix: &str| text.strip_prefix(prefix).and_then(|count| count.parse::<usize>().ok());
    if let Some(count) = count("sh").filter(|count| [1, 4, 9, 16, 25, 36, 49].contains(count)) {
        return Ok(Basis::Harmonics(count as u8));
    }
    if let Some(count) = count("svd").filter(|count| (1..=812).contains(count)) {
        return Ok(Basis::SingularValues(count));
    }
    Err("expected sh1, sh4, sh9, sh16, sh25, sh36, sh49 or svd1 to svd812".into())
}

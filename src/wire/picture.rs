//! Pictures as answers.

use base64::Engine;
use base64::prelude::BASE64_STANDARD;
use serde_json::{Value, json};

use super::message::{Format, PictureRequest};
use crate::error::{Error, Result};
use crate::image::exr::{self, ExrMetadata};
use crate::image::{Image, png};
use crate::relight::{Picture, Relighter, Request, ToneMap};

/// The picture of the relighter's lights, in base64. `shown`: exposure and tone curve of the display.
pub fn picture(
    relighter: &mut Relighter,
    PictureRequest { format, exposure }: PictureRequest,
    shown: (f32, ToneMap),
) -> Result<Value> {
    let tiling = &relighter.framebuffer().tiling;
    let [width, height] = [tiling.width, tiling.height].map(|side| side as usize);
    let exposure = exposure.unwrap_or(shown.0);
    if !exposure.is_finite() {
        return Err(Error::invalid("exposure", "must be a number of stops"));
    }
    let request = Request { exposure, tone_map: shown.1, ..Request::default() };
    let (name, data) = match format {
        Format::Exr => {
            let pixels = relighter.linear(Picture::Whole)?.to_vec();
            ("exr", exr::encode(&Image::single(width, height, pixels), &ExrMetadata::default()).map_err(cannot)?)
        }
        Format::Png => ("png", png::encode(width, height, relighter.display(request)?).map_err(cannot)?),
        Format::Rgba8 => ("rgba8", relighter.display(request)?.as_flattened().to_vec()),
    };
    let data = BASE64_STANDARD.encode(data);
    Ok(json!({ "format": name, "size": [width, height], "exposure": exposure, "data": data }))
}

fn cannot(error: impl std::error::Error) -> Error {
    Error::invalid("the picture", format!("cannot be encoded: {error}"))
}

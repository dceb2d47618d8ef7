//! Messages of clients.

use serde::Deserialize;
use serde_json::Value;

use crate::scene::rig::merge_patch::Object;

/// Version of the protocol: it changes when a client for the old one would misunderstand the new one.
pub const PROTOCOL: u64 = 1;

/// What a client asks for.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(tag = "do", rename_all = "lowercase", deny_unknown_fields)]
pub enum Request {
    /// The first message of a connection.
    Hello {
        protocol: u64,
        #[serde(default)]
        token: String,
        /// Of the client, for messages to the user.
        #[serde(default)]
        name: String,
    },
    /// All lights.
    Rig {},
    /// A JSON Merge Patch of the lights. Edits with one `gesture` that follow each other are undone together.
    Edit {
        rig: Object,
        #[serde(default)]
        gesture: Option<String>,
    },
    Undo {},
    Redo {},
    Picture(PictureRequest),
    /// Loads the scene's file again and bakes what changed.
    Reload {},
}

/// A picture of the lights as they are.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PictureRequest {
    #[serde(default)]
    pub format: Format,
    /// Stops; that of the window if it is missing.
    pub exposure: Option<f32>,
}

/// How a picture is sent, in base64.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Format {
    /// A PNG file, as the window shows it.
    #[default]
    Png,
    /// 8-bit RGBA as the window shows it, row by row from the top.
    Rgba8,
    /// An EXR file, scene-linear.
    Exr,
}

/// Parses one line: its id if it has one, and the request or what is wrong with it.
pub fn parse(line: &[u8]) -> (Option<u64>, Result<Request, String>) {
    let value: Value = match serde_json::from_slice(line) {
        Ok(value) => value,
        Err(error) => return (None, Err(format!("not JSON: {error}"))),
    };
    let Value::Object(mut object) = value else { return (None, Err("expected a JSON object".into())) };
    let id = match object.remove("id") {
        None => None,
        Some(id) => match id.as_u64() {
            Some(id) => Some(id),
            None => return (None, Err("id must be a whole number that is not negative".into())),
        },
    };
    (id, serde_json::from_value(object.into()).map_err(|error| error.to_string()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_are_requests_or_say_what_is_wrong() {
        let edit = parse(br#"{"do": "edit", "id": 7, "rig": {"lights": {"key": {"stops": 1}}}}"#);
        assert!(matches!(edit, (Some(7), Ok(Request::Edit { .. }))), "{edit:?}");
        let picture = PictureRequest { format: Format::Exr, exposure: None };
        assert_eq!(parse(br#"{"do": "picture", "format": "exr"}"#), (None, Ok(Request::Picture(picture))));
        for (line, id, part) in [
            (&b"\xff"[..], None, "not JSON"),
            (b"", None, "not JSON"),
            (b"[1]", None, "expected a JSON object"),
            (b"{}", None, "do"),
            (br#"{"do": "dance", "id": 3}"#, Some(3), "dance"),
            (br#"{"do": "undo", "id": -3}"#, None, "id must be"),
            (br#"{"do": "undo", "id": 4, "x": 1}"#, Some(4), "x"),
            (br#"{"do": "edit", "rig": []}"#, None, "map"),
            (br#"{"do": "picture", "format": "gif"}"#, None, "gif"),
        ] {
            match parse(line) {
                (found, Err(reason)) => assert!(found == id && reason.contains(part), "{found:?} {reason}"),
                other => panic!("{other:?}"),
            }
        }
        let deep = [vec![b'['; 100_000], vec![b']'; 100_000]].concat();
        assert!(parse(&deep).1.unwrap_err().contains("recursion"));
    }
}

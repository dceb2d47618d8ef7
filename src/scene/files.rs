//! The files of a scene, and which paths its URIs may refer to.

use std::io::Read;
use std::path::{Component, Path, PathBuf};

use base64::engine::{DecodePaddingMode, GeneralPurpose, GeneralPurposeConfig};
use base64::{Engine, alphabet};
use percent_encoding::percent_decode_str;

use crate::error::{Error, Result};
use crate::storage::file;

/// Reads a whole regular file; any other kind of file (a pipe might never end) is an error.
pub fn read(path: &Path) -> Result<Vec<u8>> {
    let (mut file, _) = file::open(path)?;
    let mut bytes = Vec::new();
    file.read_to_end(&mut bytes).map_err(Error::io("read", path))?;
    Ok(bytes)
}

/// Reads `uri` of `scene`: a `data:` URI, or a file in the scene's folder or below.
///
/// `what` names the item with the URI in error messages.
pub fn read_uri(scene: &Path, uri: &str, what: &str) -> Result<Vec<u8>> {
    if let Some(data) = uri.strip_prefix("data:") {
        return decode_data(data).map_err(|reason| Error::import(scene, format!("{what}: {reason}")));
    }
    let relative = relative_path(uri)
        .map_err(|reason| Error::import(scene, format!("{what}: URI \"{}\" {reason}", shortened(uri))))?;
    let folder = scene.parent().unwrap_or(Path::new(""));
    let bytes = below(folder, &folder.join(relative)).and_then(|path| read(&path));
    bytes.map_err(|e| Error::import_from(scene, format!("{what}: cannot read \"{}\"", shortened(uri)), e))
}

/// Returns `path`, or an error if symbolic links lead it out of `folder`: a scene must not expose other files of the
/// machine.
pub fn below(folder: &Path, path: &Path) -> Result<PathBuf> {
    let folder = if folder.as_os_str().is_empty() { Path::new(".") } else { folder };
    match (folder.canonicalize(), path.canonicalize()) {
        (Ok(folder), Ok(real)) if !real.starts_with(&folder) => {
            Err(Error::import(path, "is a link that leads out of the scene's folder"))
        }
        // A missing file is reported by the function that reads it.
        _ => Ok(path.to_owned()),
    }
}

/// A percent-encoded URI as a path below the scene's folder. Scenes are untrusted, so they may not refer to files
/// outside it.
pub fn relative_path(uri: &str) -> Result<PathBuf, &'static str> {
    inside(&percent_decode_str(uri).decode_utf8().map_err(|_| "is not UTF-8")?)
}

/// `decoded` as a relative path that does not leave its folder.
pub fn inside(decoded: &str) -> Result<PathBuf, &'static str> {
    if decoded.contains('\0') {
        return Err("holds a zero byte");
    }
    let colon = decoded.find(':').unwrap_or(usize::MAX);
    if colon < decoded.find('/').unwrap_or(usize::MAX) {
        return Err("has a scheme other than data:");
    }
    let mut path = PathBuf::new();
    for part in Path::new(decoded).components() {
        match part {
            Component::Normal(name) => path.push(name),
            Component::CurDir => {}
            Component::ParentDir if path.pop() => {}
            _ => return Err("leads out of the scene's folder"),
        }
    }
    if path.as_os_str().is_empty() { Err("is empty") } else { Ok(path) }
}

/// Decodes what follows `data:`: `[mediatype][;base64],data`.
fn decode_data(data: &str) -> Result<Vec<u8>, String> {
    let (head, body) = data.split_once(',').ok_or("data URI without a comma")?;
    if !head.ends_with(";base64") {
        return Ok(percent_decode_str(body).collect());
    }
    let lenient = GeneralPurposeConfig::new().with_decode_padding_mode(DecodePaddingMode::Indifferent);
    let engine = GeneralPurpose::new(&alphabet::STANDARD, lenient);
    engine.decode(body).map_err(|e| format!("base64: {e}"))
}

/// A URI, shortened for messages.
pub fn shortened(uri: &str) -> String {
    let mut short: String = uri.chars().take(80).collect();
    if short.len() < uri.len() {
        short.push_str("...");
    }
    short
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn paths_stay_inside() {
        assert_eq!(relative_path("a%20b/../c.png").unwrap(), Path::new("c.png"));
        assert_eq!(relative_path("./tex/%C3%A9.png").unwrap(), Path::new("tex/é.png"));
        for uri in ["../x", "a/../../x", "%2e%2e/x", "/etc/passwd", "file:///x", "http://x/y", "", ".", "a%00", "%ff"] {
            assert!(relative_path(uri).is_err(), "{uri}");
        }
    }

    #[test]
    fn data_uris() {
        assert_eq!(decode_data("application/octet-stream;base64,AAEC").unwrap(), [0, 1, 2]);
        assert_eq!(decode_data(";base64,AAE").unwrap(), [0, 1]);
        assert_eq!(decode_data("text/plain,a%20b").unwrap(), b"a b");
        assert!(decode_data(";base64,!").is_err());
        assert!(decode_data("nothing").is_err());
    }
}

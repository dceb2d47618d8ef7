//! Embeds buffers and images in the file.

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use serde_json::{Value, json};

use super::json::{Object, array, element, remove_inner};
use crate::error::Result;
use crate::scene::files;
use crate::scene::gltf::document::{Document, MESHOPT};

/// Merges all buffers and all images that have URIs into one buffer, which is returned.
pub fn into_one_buffer(root: &mut Object, document: &Document) -> Result<Vec<u8>> {
    let mut bin = Vec::new();
    let mut begins = Vec::new();
    for buffer in &document.buffers {
        begins.push(pad(&mut bin));
        bin.extend_from_slice(buffer);
    }
    for (index, view) in array_if_there(root, "bufferViews").enumerate() {
        let Some(view) = view.as_object_mut() else { continue };
        if let Some(&unpacked) = document.unpacked.views.get(&index) {
            let bytes = &document.unpacked.buffers[unpacked];
            let begin = pad(&mut bin);
            bin.extend_from_slice(bytes);
            plain(view, begin, bytes.len());
            continue;
        }
        let buffer = view.get("buffer").and_then(Value::as_u64).unwrap_or(0) as usize;
        let begin = begins.get(buffer).copied().unwrap_or(0);
        view.insert("buffer".into(), 0.into());
        if begin > 0 {
            let offset = view.get("byteOffset").and_then(Value::as_u64).unwrap_or(0);
            view.insert("byteOffset".into(), (begin as u64 + offset).into());
        }
    }
    for (index, uri) in image_uris(root) {
        let bytes = files::read_uri(&document.path, &uri, &format!("image {index}"))?;
        let begin = pad(&mut bin);
        bin.extend_from_slice(&bytes);
        let views = array(root, "bufferViews");
        views.push(json!({"buffer": 0, "byteOffset": begin, "byteLength": bytes.len()}));
        let view = views.len() - 1;
        let image = element(root, "images", index).expect("the image whose URI it is");
        image.remove("uri");
        image.insert("bufferView".into(), view.into());
        image.insert("mimeType".into(), mime_type(&bytes).into());
    }
    if bin.is_empty() {
        root.remove("buffers");
        return Ok(bin);
    }
    for key in ["extensionsUsed", "extensionsRequired"] {
        if let Some(Value::Array(names)) = root.get_mut(key) {
            names.retain(|name| !MESHOPT.iter().any(|packed| name.as_str() == Some(packed)));
        }
    }
    let buffers = array(root, "buffers");
    buffers.truncate(1);
    match buffers.first_mut().and_then(Value::as_object_mut) {
        Some(buffer) => {
            buffer.remove("uri");
            MESHOPT.iter().for_each(|name| remove_inner(buffer, "extensions", name));
            buffer.insert("byteLength".into(), bin.len().into());
        }
        None => *buffers = vec![json!({"byteLength": bin.len()})],
    }
    Ok(bin)
}

/// Makes a compressed view refer to decompressed bytes in the first buffer.
fn plain(view: &mut Object, begin: usize, length: usize) {
    for (key, value) in [("buffer", 0), ("byteOffset", begin), ("byteLength", length)] {
        view.insert(key.into(), value.into());
    }
    for name in MESHOPT {
        remove_inner(view, "extensions", name);
    }
}

/// Replaces all buffers and images by `data:` URIs.
pub fn into_data_uris(root: &mut Object, document: &Document) -> Result<()> {
    for (index, bytes) in document.buffers.iter().enumerate() {
        let Some(buffer) = element(root, "buffers", index) else { continue };
        // A fallback for programs that cannot decompress views, without data.
        if bytes.is_empty() && !buffer.contains_key("uri") {
            continue;
        }
        if !buffer.get("uri").and_then(Value::as_str).is_some_and(|uri| uri.starts_with("data:")) {
            buffer.insert("uri".into(), data_uri("application/octet-stream", bytes).into());
        }
    }
    for (index, uri) in image_uris(root) {
        if !uri.starts_with("data:") {
            let bytes = files::read_uri(&document.path, &uri, &format!("image {index}"))?;
            let image = element(root, "images", index).expect("the image whose URI it is");
            image.insert("uri".into(), data_uri(mime_type(&bytes), &bytes).into());
        }
    }
    Ok(())
}

fn array_if_there<'a>(root: &'a mut Object, key: &str) -> impl Iterator<Item = &'a mut Value> {
    root.get_mut(key).and_then(Value::as_array_mut).into_iter().flatten()
}

fn image_uris(root: &Object) -> Vec<(usize, String)> {
    let images = root.get("images").and_then(Value::as_array).into_iter().flatten().enumerate();
    let uri = |(i, image): (usize, &Value)| Some((i, image.get("uri")?.as_str()?.to_owned()));
    images.filter_map(uri).collect()
}

/// Pads to the alignment of accessors; returns the new length.
fn pad(bin: &mut Vec<u8>) -> usize {
    bin.resize(bin.len().next_multiple_of(4), 0);
    bin.len()
}

fn mime_type(bytes: &[u8]) -> &'static str {
    image::guess_format(bytes).map_or("application/octet-stream", |format| format.to_mime_type())
}

pub fn data_uri(mime_type: &str, bytes: &[u8]) -> String {
    format!("data:{mime_type};base64,{}", STANDARD.encode(bytes))
}

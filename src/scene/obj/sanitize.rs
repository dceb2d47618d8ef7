//! Rewrites OBJ and MTL text so that tobj parses it correctly.
//!
//! tobj 4.0.5 reads polylines as faces, gives a corner without a texture coordinate or a normal the previous one,
//! shifts vertex colours if only some vertices have them, panics on incomplete colours and on normal indices that
//! overflow when tripled, and rejects comments after statements, continued lines and `d -halo`. So it receives only the
//! statements in use, each checked and complete. Errors begin with the line number, which tobj does not report.

use std::collections::HashMap;
use std::ops::RangeInclusive;

use super::texture_map::TextureMap;
use super::words::{number, split_word};

// Triangulation takes quadratic time at worst; no meaningful polygon has more corners.
const MAX_CORNERS: usize = 1_024;

/// Replaces an empty material name, which tobj rejects and some exporters write.
pub const UNNAMED: &str = "(no name)";

/// A checked OBJ file.
pub struct Obj {
    /// Without groups and materials, so that tobj makes one mesh of it, all faces in order.
    pub text: String,
    pub faces: Vec<Face>,
    /// Material names; the first is empty and means no material.
    pub materials: Vec<String>,
    /// The argument of each `mtllib`.
    pub libraries: Vec<String>,
}

/// Face data that tobj does not report. Arrays of three are position, texture coordinate, normal.
pub struct Face {
    pub material: usize,
    /// At every corner.
    pub has_uvs: bool,
    /// At every corner.
    pub has_normals: bool,
    /// Largest index of each kind, from 1; 0 if there is none.
    greatest: [i64; 3],
    line_number: usize,
}

/// Checks and rewrites an OBJ file.
pub fn obj(text: &str) -> Result<Obj, String> {
    let mut obj = Obj { text: String::new(), faces: Vec::new(), materials: vec![String::new()], libraries: Vec::new() };
    let mut material_indices = HashMap::from([(String::new(), 0)]);
    let mut material = 0;
    let mut counts = [0; 3];
    for (line_number, line) in logical_lines(text) {
        let (key, rest) = split_word(&line);
        let wrong = |reason: String| format!("line {line_number}: {reason}");
        match key {
            "v" => {
                obj.text.extend(["v ", &vertex(rest).map_err(wrong)?, "\n"]);
                counts[0] += 1;
            }
            "vt" => {
                let rest = if has_nan(rest) { "0 0" } else { rest };
                numbers(rest, 1..=2).map_err(wrong)?;
                // A single u gets v = 0; values after the second are ignored.
                obj.text.extend(["vt ", rest, " 0\n"]);
                counts[1] += 1;
            }
            "vn" => {
                // Normals that are no numbers become those of the faces.
                let rest = if has_nan(rest) { "0 0 0" } else { rest };
                numbers(rest, 3..=3).map_err(wrong)?;
                obj.text.extend(["vn ", rest, "\n"]);
                counts[2] += 1;
            }
            "f" => {
                let (has, greatest) = face(rest, counts).map_err(wrong)?;
                obj.text.extend(["f ", rest, "\n"]);
                obj.faces.push(Face { material, has_uvs: has[1], has_normals: has[2], greatest, line_number });
            }
            "usemtl" => {
                material = *material_indices.entry(rest.to_owned()).or_insert_with(|| {
                    obj.materials.push(rest.to_owned());
                    obj.materials.len() - 1
                });
            }
            "mtllib" => obj.libraries.push(rest.to_owned()),
            // Groups, smoothing, points, lines and curves are ignored.
            _ => {}
        }
    }
    // Indices may refer to later elements, so their range is checked at the end.
    for face in &obj.faces {
        for (k, what) in ["vertex", "texture coordinate", "normal"].into_iter().enumerate() {
            let (index, there) = (face.greatest[k], counts[k]);
            if index > there {
                return Err(format!("line {}: {what} {index} is out of range, there are {there}", face.line_number));
            }
        }
    }
    Ok(obj)
}

/// `x y z`, `x y z w` or `x y z r g b` as `x y z r g b`; white if there is no colour.
fn vertex(rest: &str) -> Result<String, String> {
    match numbers(rest, 0..=8)?[..] {
        [_, _, _] => Ok(format!("{rest} 1 1 1")),
        [x, y, z, w] if w != 0.0 => vertex(&format!("{:e} {:e} {:e}", x / w, y / w, z / w)),
        [x, y, z, r, g, b] | [x, y, z, r, g, b, _] => Ok(format!("{x:e} {y:e} {z:e} {r:e} {g:e} {b:e}")),
        _ => Err(format!("\"{rest}\" is not a vertex")),
    }
}

/// Whether some are no finite numbers, as programs print them: `nan`, `-nan(ind)`, `inf`.
fn has_nan(rest: &str) -> bool {
    let is_nan = |word: &str| {
        let word = word.trim_start_matches(['-', '+']).to_ascii_lowercase();
        word.starts_with("nan") || word.starts_with("inf")
    };
    rest.split_whitespace().any(is_nan)
}

/// Corners `v`, `v/vt`, `v//vn` or `v/vt/vn`; negative indices count back from the last element so far. Returns which
/// kinds all corners have, and the largest index of each kind.
fn face(rest: &str, counts: [i64; 3]) -> Result<([bool; 3], [i64; 3]), String> {
    let (mut has, mut greatest) = ([true; 3], [0; 3]);
    let mut corner_count = 0;
    for word in rest.split_whitespace() {
        let wrong = || format!("\"{word}\" is not a face corner");
        let mut indices = [0; 3];
        for (k, part) in word.split('/').enumerate().filter(|(_, part)| !part.is_empty()) {
            let index = part.parse().ok().filter(|&index| index != 0).ok_or_else(wrong)?;
            *indices.get_mut(k).ok_or_else(wrong)? = index;
            if index < -counts[k] {
                return Err(format!("\"{word}\" counts back past the first"));
            }
        }
        if indices[0] == 0 {
            return Err(wrong());
        }
        for k in 0..3 {
            has[k] &= indices[k] != 0;
            greatest[k] = indices[k].max(greatest[k]);
        }
        corner_count += 1;
    }
    match corner_count {
        3..=MAX_CORNERS => Ok((has, greatest)),
        n => Err(format!("a face of {n} corners")),
    }
}

/// Checks and rewrites an MTL file.
pub fn mtl(text: &str) -> Result<String, String> {
    let mut checked = String::new();
    for (line_number, line) in logical_lines(text) {
        let (key, rest) = split_word(&line);
        let value = match key {
            "newmtl" if rest.is_empty() => Ok(UNNAMED.to_owned()),
            "newmtl" => Ok(rest.to_owned()),
            // Missing channels repeat the first.
            "Kd" | "Ks" | "Ke" => numbers(rest, 1..=3).map(|c| {
                let [green, blue] = [1, 2].map(|i| c.get(i).unwrap_or(&c[0]));
                format!("{:e} {green:e} {blue:e}", c[0])
            }),
            "Ns" | "Ni" | "Pr" | "Pm" => numbers(rest, 1..=1).map(|x| format!("{:e}", x[0])),
            "d" => numbers(rest.strip_prefix("-halo").unwrap_or(rest), 1..=1).map(|x| format!("{:e}", x[0])),
            "Tr" => numbers(rest, 1..=1).map(|x| format!("{:e}", x[0])),
            "illum" => numbers(rest, 1..=1).map(|x| (x[0] as u8).to_string()),
            "map_Kd" | "map_Ke" | "map_Ks" | "map_Ns" | "map_Pr" | "map_Pm" | "map_d" | "norm" | "bump"
            | "map_bump" | "map_Bump" => TextureMap::parse(rest).map(|_| rest.to_owned()),
            _ => continue,
        };
        let value = value.map_err(|reason| format!("line {line_number}: {key}: {reason}"))?;
        checked.extend([key, " ", &value, "\n"]);
    }
    Ok(checked)
}

/// Logical lines: comments removed, backslash continuations joined; with the number of their first physical line.
fn logical_lines(text: &str) -> impl Iterator<Item = (usize, String)> {
    let mut lines = text.lines().enumerate();
    std::iter::from_fn(move || {
        loop {
            let (index, mut part) = lines.next()?;
            let mut line = String::new();
            // Visits each physical line once, however many are joined.
            while let Some(begin) = part.trim_end().strip_suffix('\\') {
                line.push_str(begin);
                line.push(' ');
                part = lines.next().map_or("", |(_, next)| next);
            }
            line.push_str(part);
            // Names may hold the sign: 3ds Max writes "Material #25".
            let has_name =
                |key: &str| matches!(key, "newmtl" | "usemtl" | "mtllib" | "norm" | "bump") || key.contains("map");
            let content = match has_name(split_word(line.trim()).0) {
                true => line.trim(),
                false => line.split('#').next().unwrap_or_default().trim(),
            };
            if !content.is_empty() {
                return Some((index + 1, content.to_owned()));
            }
        }
    })
}

/// Parses numbers up to the largest count; further words are ignored.
fn numbers(rest: &str, count: RangeInclusive<usize>) -> Result<Vec<f64>, String> {
    let values = rest.split_whitespace().take(*count.end()).map(number).collect::<Result<Vec<f64>, _>>()?;
    if values.len() >= *count.start() { Ok(values) } else { Err("numbers are missing".into()) }
}

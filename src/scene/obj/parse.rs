//! The text of an OBJ file: vertices, faces by material, names of material libraries.

use glam::{DVec3, Vec2, Vec3};

// A polygon is triangulated in quadratic time at worst; none that means anything has more corners.
const MAX_CORNERS: usize = 1_024;

#[derive(Default)]
pub struct Obj {
    pub positions: Vec<DVec3>,
    /// By position; empty if no vertex has a colour. Linear RGB.
    pub colors: Vec<Option<Vec3>>,
    pub uvs: Vec<Vec2>,
    pub normals: Vec<Vec3>,
    /// Material names in the order of their first use, and their faces: three corners or more, indices in range.
    pub faces: Vec<(String, Vec<Vec<Corner>>)>,
    /// What stands behind each `mtllib`.
    pub libraries: Vec<String>,
}

/// Indices from 0.
#[derive(Clone, Copy)]
pub struct Corner {
    pub position: usize,
    pub uv: Option<usize>,
    pub normal: Option<usize>,
}

impl Obj {
    /// Errors begin with the line's number.
    pub fn parse(text: &str) -> Result<Self, String> {
        let mut obj = Self::default();
        let mut material = None;
        let mut names = std::collections::HashMap::new();
        // Indices may point forward, so their range is checked at the end.
        let mut lines_of_faces = Vec::new();
        for (number, line) in logical_lines(text) {
            let (key, rest) = line.split_once(char::is_whitespace).unwrap_or((&line, ""));
            let rest = rest.trim();
            let wrong = |reason: String| format!("line {number}: {reason}");
            match key {
                "v" => obj.vertex(rest).map_err(wrong)?,
                "vt" => {
                    let [u, v] = some_numbers(rest, [0.0, 0.0]).map_err(wrong)?;
                    obj.uvs.push(Vec2::new(u as f32, v as f32));
                }
                "vn" => obj.normals.push(DVec3::from_array(numbers(rest).map_err(wrong)?).as_vec3()),
                "f" => {
                    let face = obj.face(rest).map_err(wrong)?;
                    let index = *material.get_or_insert_with(|| obj.material("", &mut names));
                    lines_of_faces.push((number, index, obj.faces[index].1.len()));
                    obj.faces[index].1.push(face);
                }
                "usemtl" => material = Some(obj.material(rest, &mut names)),
                "mtllib" => obj.libraries.push(rest.to_owned()),
                // Groups, smoothing, points, lines, curves: not needed.
                _ => {}
            }
        }
        for (number, material, face) in lines_of_faces {
            let face = &obj.faces[material].1[face];
            obj.check(face).map_err(|reason| format!("line {number}: {reason}"))?;
        }
        obj.faces.retain(|(_, faces)| !faces.is_empty());
        Ok(obj)
    }

    fn material(&mut self, name: &str, names: &mut std::collections::HashMap<String, usize>) -> usize {
        *names.entry(name.to_owned()).or_insert_with(|| {
            self.faces.push((name.to_owned(), Vec::new()));
            self.faces.len() - 1
        })
    }

    /// `x y z`, `x y z w` or `x y z r g b`.
    fn vertex(&mut self, rest: &str) -> Result<(), String> {
        let words: Vec<&str> = rest.split_whitespace().collect();
        let values = words.iter().map(|w| number(w)).collect::<Result<Vec<f64>, _>>()?;
        let (position, color) = match values[..] {
            [x, y, z] => (DVec3::new(x, y, z), None),
            [x, y, z, w] if w != 0.0 => (DVec3::new(x, y, z) / w, None),
            [x, y, z, r, g, b] | [x, y, z, r, g, b, _] => (DVec3::new(x, y, z), Some(DVec3::new(r, g, b).as_vec3())),
            _ => return Err(format!("\"{rest}\" is no vertex")),
        };
        if !position.is_finite() || color.is_some_and(|c| !c.is_finite()) {
            return Err(format!("\"{rest}\" is not finite"));
        }
        if color.is_some() {
            self.colors.resize(self.positions.len(), None);
            self.colors.push(color);
        }
        self.positions.push(position);
        Ok(())
    }

    fn face(&self, rest: &str) -> Result<Vec<Corner>, String> {
        let corners = rest.split_whitespace().map(|w| self.corner(w)).collect::<Result<Vec<_>, _>>()?;
        match corners.len() {
            3..=MAX_CORNERS => Ok(corners),
            n => Err(format!("a face of {n} corners")),
        }
    }

    /// `v`, `v/vt`, `v//vn` or `v/vt/vn`; negative counts back from the last one so far.
    fn corner(&self, word: &str) -> Result<Corner, String> {
        let wrong = || format!("\"{word}\" is no corner of a face");
        let index = |part: Option<&str>, there: usize| match part {
            None | Some("") => Ok(None),
            Some(part) => match part.parse::<i64>() {
                Ok(i) if i > 0 => Ok(Some(i as usize - 1)),
                Ok(i) if i < 0 => usize::try_from(i.unsigned_abs())
                    .ok()
                    .and_then(|back| there.checked_sub(back))
                    .map(Some)
                    .ok_or_else(|| format!("\"{word}\" counts back past the first")),
                _ => Err(wrong()),
            },
        };
        let mut parts = word.split('/');
        let position = index(parts.next(), self.positions.len())?.ok_or_else(wrong)?;
        let uv = index(parts.next(), self.uvs.len())?;
        let normal = index(parts.next(), self.normals.len())?;
        if parts.next().is_some() { Err(wrong()) } else { Ok(Corner { position, uv, normal }) }
    }

    fn check(&self, face: &[Corner]) -> Result<(), String> {
        let check = |index: Option<usize>, there: usize, what: &str| match index {
            Some(i) if i >= there => Err(format!("{what} {} is out of range, there are {there}", i + 1)),
            _ => Ok(()),
        };
        for corner in face {
            check(Some(corner.position), self.positions.len(), "vertex")?;
            check(corner.uv, self.uvs.len(), "texture coordinate")?;
            check(corner.normal, self.normals.len(), "normal")?;
        }
        Ok(())
    }
}

/// Lines without comments, with what a backslash continues, and the number of their first line.
pub fn logical_lines(text: &str) -> impl Iterator<Item = (usize, String)> {
    let mut lines = text.lines().enumerate();
    std::iter::from_fn(move || {
        loop {
            let (index, mut part) = lines.next()?;
            let mut line = String::new();
            // Looks at each physical line once, however many are joined.
            while let Some(begin) = part.trim_end().strip_suffix('\\') {
                line.push_str(begin);
                line.push(' ');
                part = lines.next().map_or("", |(_, next)| next);
            }
            line.push_str(part);
            let content = line.split('#').next().unwrap_or_default().trim();
            if !content.is_empty() {
                return Some((index + 1, content.to_owned()));
            }
        }
    })
}

pub fn number(word: &str) -> Result<f64, String> {
    let value: f64 = word.parse().map_err(|_| format!("\"{word}\" is no number"))?;
    // Single precision is what most of them become.
    if (value as f32).is_finite() { Ok(value) } else { Err(format!("{word} is not finite")) }
}

/// Exactly `N` numbers; more are ignored.
pub fn numbers<const N: usize>(rest: &str) -> Result<[f64; N], String> {
    let values = rest.split_whitespace().take(N).map(number).collect::<Result<Vec<f64>, _>>()?;
    values.try_into().map_err(|_| format!("\"{rest}\" are not {N} numbers"))
}

/// At least one number, at most `N`; `default` stands for the rest.
pub fn some_numbers<const N: usize>(rest: &str, mut default: [f64; N]) -> Result<[f64; N], String> {
    let values = rest.split_whitespace().take(N).map(number).collect::<Result<Vec<f64>, _>>()?;
    if values.is_empty() {
        return Err("numbers are missing".into());
    }
    default[..values.len()].copy_from_slice(&values);
    Ok(default)
}

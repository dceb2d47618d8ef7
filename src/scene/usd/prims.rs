//! Values of prims, composed: places, visibility, attributes at the time of their default or first sample.

use glam::{DAffine3, DMat4, Vec3};
use openusd::schemas::geom::{Imageable, Xformable};
use openusd::sdf::{self, Value};
use openusd::usd::{Attribute, Prim, SchemaBase, SchemaKind, Stage, TimeCode};

use crate::error::Cause;

/// The errors of the library, and ours.
pub type Fallible<T> = std::result::Result<T, Cause>;

/// The children of a prim that are there: active, loaded, defined and not abstract; none below instances.
pub fn children(prim: &Prim) -> Fallible<Vec<Prim>> {
    let mut there = Vec::new();
    if is_instance(prim)? {
        return Ok(there);
    }
    for name in prim.child_names()? {
        // openusd 0.6 does not end for prims with names that cannot be.
        ensure(is_name(name.as_ref()), "a prim has a malformed name")?;
        let child = prim.stage().prim(prim.path().append_path(name.as_str())?);
        if child.is_active()? && child.is_loaded()? && child.is_defined()? && !child.is_abstract()? {
            there.push(child);
        }
    }
    Ok(there)
}

pub fn is_instance(prim: &Prim) -> Fallible<bool> {
    Ok(prim.path().name().is_some() && prim.is_instance()?)
}

fn is_name(text: &str) -> bool {
    !text.is_empty() && text.chars().all(|c| c.is_alphanumeric() || c == '_')
}

/// Any prim, as one with a place: prims of all types can have one.
struct Placed(Prim);

impl SchemaBase for Placed {
    const KIND: SchemaKind = SchemaKind::AbstractTyped;

    fn prim(&self) -> &Prim {
        &self.0
    }
}

impl Imageable for Placed {}

impl Xformable for Placed {}

/// The stage's space from a prim's.
pub fn world_from_prim(prim: &Prim) -> Fallible<DAffine3> {
    let mut world_from_prim = DAffine3::IDENTITY;
    let mut at = Some(prim.path().clone());
    while let Some(path) = at.filter(|path| path.name().is_some()) {
        let placed = Placed(prim.stage().prim(&path));
        // openusd 0.6 does not end for names that cannot be those of attributes.
        let order = placed.xform_op_order()?.unwrap_or_default();
        let is_op = |op: &String| op.trim_matches('!').split(':').all(|part| is_name(part.trim_matches('!')));
        ensure(order.iter().all(is_op), "its xformOpOrder is malformed")?;
        // USD multiplies rows from the left: the same numbers, read by columns.
        let parent_from_prim = DMat4::from_cols_array(&placed.local_to_parent_transform(TimeCode::EARLIEST)?.0);
        world_from_prim = DAffine3::from_mat4(parent_from_prim) * world_from_prim;
        if placed.resets_xform_stack()? {
            break;
        }
        at = path.parent();
    }
    Ok(world_from_prim)
}

/// Name for people, if a layer has one.
pub fn display_name(stage: &Stage, prim: &Prim) -> Fallible<Option<String>> {
    for (layer, path) in prim.prim_stack()? {
        let Some(layer) = stage.layer(&layer) else { continue };
        if let Ok(Some(name)) = layer.data().try_field(&path, sdf::FieldKey::DisplayName.as_str())
            && let Value::String(name) = name.as_ref()
            && !name.is_empty()
        {
            return Ok(Some(unescaped(name)));
        }
    }
    Ok(None)
}

pub fn is_visible(prim: &Prim) -> Fallible<bool> {
    let mut at = Some(prim.path().clone());
    while let Some(path) = at.filter(|path| path.name().is_some()) {
        let visibility = value(&prim.stage().prim(&path).attribute("visibility"))?;
        if visibility.is_some_and(|value| value.cast::<String>().is_ok_and(|value| value == "invisible")) {
            return Ok(false);
        }
        at = path.parent();
    }
    Ok(true)
}

/// A string of a text layer, in which the library leaves `\"`, `\\` and `\n` as they are.
pub fn unescaped(text: &str) -> String {
    let mut unescaped = String::new();
    let mut chars = text.chars();
    while let Some(c) = chars.next() {
        let of_escape = |c| match c {
            'n' => '\n',
            'r' => '\r',
            't' => '\t',
            c => c,
        };
        unescaped.extend(if c == '\\' { chars.next().map(of_escape) } else { Some(c) });
    }
    unescaped
}

pub fn ensure(holds: bool, reason: &'static str) -> Fallible<()> {
    if holds { Ok(()) } else { Err(reason.into()) }
}

/// The default, else the first sample.
fn value(attribute: &Attribute) -> Fallible<Option<Value>> {
    match attribute.get::<Value>()? {
        Some(value) => Ok(Some(value)),
        None => Ok(attribute.get_at::<Value>(TimeCode::EARLIEST)?),
    }
}

pub fn number(prim: &Prim, name: &str) -> Fallible<Option<f64>> {
    Ok(value(&prim.attribute(name))?.map(|value| value.cast::<f64>()).transpose()?)
}

pub fn flag(prim: &Prim, name: &str) -> Fallible<Option<bool>> {
    Ok(value(&prim.attribute(name))?.map(|value| value.cast::<bool>()).transpose()?)
}

pub fn color(prim: &Prim, name: &str) -> Fallible<Option<Vec3>> {
    let color = value(&prim.attribute(name))?.map(|value| value.cast::<openusd::gf::Vec3f>()).transpose()?;
    Ok(color.map(|color| Vec3::new(color.x, color.y, color.z)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn escapes_of_text_layers_are_characters() {
        assert_eq!(unescaped(r#"a \"b\" \\ \n\r\t é\q\"#), "a \"b\" \\ \n\r\t éq");
    }
}

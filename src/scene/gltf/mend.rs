//! Repairs JSON that strict readers reject although its meaning is clear.
//!
//! Only files that could not be parsed come here, so valid files are read unchanged.

use serde_json::{Map, Number, Value};

/// The text with integers without a fraction, with required lists, and without animations, which are never read; `None`
/// if nothing had to be repaired.
pub fn mended(json: &[u8]) -> Option<Vec<u8>> {
    let mut root: Value = serde_json::from_slice(json).ok()?;
    let mut is_changed = integers(&mut root);
    let object = root.as_object_mut()?;
    is_changed |= object.remove("animations").is_some();
    is_changed |= lists(object);
    is_changed.then(|| serde_json::to_vec(&root).ok()).flatten()
}

/// `1.0` becomes `1`, which is also a valid floating-point number. -0.0 is unchanged.
fn integers(value: &mut Value) -> bool {
    match value {
        Value::Number(number) => {
            let whole = number.as_f64().filter(|x| number.is_f64() && x.fract() == 0.0 && x.is_sign_positive());
            // 2^53: up to there, double precision represents every integer.
            let Some(whole) = whole.filter(|&x| x <= 9_007_199_254_740_992.0) else { return false };
            *number = Number::from(whole as u64);
            true
        }
        Value::Array(items) => items.iter_mut().fold(false, |changed, item| integers(item) | changed),
        Value::Object(items) => items.values_mut().fold(false, |changed, item| integers(item) | changed),
        _ => false,
    }
}

/// Adds lists that are optional in the specification but required by the gltf crate.
fn lists(root: &mut Map<String, Value>) -> bool {
    let mut is_changed = false;
    for (of, key) in [("scenes", "nodes"), ("meshes", "primitives")] {
        let Some(Value::Array(items)) = root.get_mut(of) else { continue };
        for item in items.iter_mut().filter_map(Value::as_object_mut).filter(|item| !item.contains_key(key)) {
            item.insert(key.into(), Value::Array(Vec::new()));
            is_changed = true;
        }
    }
    is_changed
}

//! JSON Merge Patches [RFC 7396].

use serde_json::{Map, Value};

/// A JSON object.
pub type Object = Map<String, Value>;

/// Applies `patch` to an object [RFC 7396, Section 2].
pub fn merge(object: &mut Object, patch: Object) {
    for (key, change) in patch {
        match change {
            Value::Null => drop(object.remove(&key)),
            Value::Object(change) => {
                let mut value = match object.remove(&key) {
                    Some(Value::Object(value)) => value,
                    _ => Object::new(),
                };
                merge(&mut value, change);
                object.insert(key, value.into());
            }
            change => drop(object.insert(key, change)),
        }
    }
}

/// The patch that turns `before` into `after`.
pub fn difference(before: &Object, after: &Object) -> Object {
    let removed = before.keys().filter(|key| !after.contains_key(*key)).map(|key| (key.clone(), Value::Null));
    let changed = after.iter().filter(|(key, value)| before.get(*key) != Some(*value));
    let changed = changed.map(|(key, value)| match (before.get(key), value) {
        (Some(Value::Object(before)), Value::Object(after)) => (key.clone(), difference(before, after).into()),
        _ => (key.clone(), value.clone()),
    });
    removed.chain(changed).collect()
}

/// The members of `patch` that `other` does not set to the same values.
pub fn without(patch: Object, other: &Object) -> Object {
    let rest = patch.into_iter().filter_map(|(key, change)| match (change, other.get(&key)) {
        (change, None) => Some((key, change)),
        (Value::Object(change), Some(Value::Object(other))) => {
            let rest = without(change, other);
            (!rest.is_empty()).then(|| (key, rest.into()))
        }
        (change, Some(other)) => (!is_same(&change, other)).then_some((key, change)),
    });
    rest.collect()
}

/// Relative difference of numbers that count as the same: programs count with single precision.
const PRECISION: f64 = 1e-6;

fn is_same(a: &Value, b: &Value) -> bool {
    match (a, b) {
        (Value::Number(a), Value::Number(b)) => {
            let [a, b] = [a, b].map(|number| number.as_f64().unwrap_or(f64::NAN));
            (a - b).abs() <= PRECISION * a.abs().max(b.abs()).max(PRECISION)
        }
        (Value::Array(a), Value::Array(b)) => a.len() == b.len() && a.iter().zip(b).all(|(a, b)| is_same(a, b)),
        (a, b) => a == b,
    }
}

/// The object that a value is known to be.
pub(crate) fn object(value: Value) -> Object {
    match value {
        Value::Object(object) => object,
        _ => unreachable!("it was written as an object"),
    }
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    /// Examples of [RFC 7396, Appendix A] that are objects.
    #[test]
    fn patches_apply_as_the_rfc_says() {
        for (original, patch, result) in [
            (json!({"a": "b"}), json!({"a": "c"}), json!({"a": "c"})),
            (json!({"a": "b"}), json!({"b": "c"}), json!({"a": "b", "b": "c"})),
            (json!({"a": "b"}), json!({"a": null}), json!({})),
            (json!({"a": "b", "b": "c"}), json!({"a": null}), json!({"b": "c"})),
            (json!({"a": ["b"]}), json!({"a": "c"}), json!({"a": "c"})),
            (json!({"a": "c"}), json!({"a": ["b"]}), json!({"a": ["b"]})),
            (json!({"a": {"b": "c"}}), json!({"a": {"b": "d", "c": null}}), json!({"a": {"b": "d"}})),
            (json!({"a": [{"b": "c"}]}), json!({"a": [1]}), json!({"a": [1]})),
            (json!({"e": null}), json!({"a": 1}), json!({"e": null, "a": 1})),
            (json!({}), json!({"a": {"bb": {"ccc": null}}}), json!({"a": {"bb": {}}})),
        ] {
            let mut patched = object(original);
            merge(&mut patched, object(patch));
            assert_eq!(Value::Object(patched), result);
        }
    }

    #[test]
    fn a_difference_is_the_patch_between_two_objects() {
        let before = object(json!({"a": 1, "b": {"c": 2, "d": 3}, "e": [1, 2]}));
        let after = object(json!({"a": 1, "b": {"c": 5}, "e": [1], "f": {"g": 1}}));
        let patch = difference(&before, &after);
        assert_eq!(Value::Object(patch.clone()), json!({"b": {"c": 5, "d": null}, "e": [1], "f": {"g": 1}}));
        let mut patched = before;
        merge(&mut patched, patch.clone());
        assert_eq!(patched, after);
        let rest = without(patch, &object(json!({"b": {"c": 5.000001}, "e": null})));
        assert_eq!(Value::Object(rest), json!({"b": {"d": null}, "e": [1], "f": {"g": 1}}));
    }
}

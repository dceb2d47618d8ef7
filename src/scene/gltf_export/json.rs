//! Access to JSON whose members may be missing.

use serde_json::Value;

pub type Object = serde_json::Map<String, Value>;

/// The object at `key`, created if it is missing.
pub fn object<'a>(parent: &'a mut Object, key: &str) -> &'a mut Object {
    let value = parent.entry(key).or_insert_with(|| Value::Object(Object::new()));
    if !value.is_object() {
        *value = Value::Object(Object::new());
    }
    value.as_object_mut().expect("it has just been made one")
}

/// The array at `key`, created if it is missing.
pub fn array<'a>(parent: &'a mut Object, key: &str) -> &'a mut Vec<Value> {
    let value = parent.entry(key).or_insert_with(|| Value::Array(Vec::new()));
    if !value.is_array() {
        *value = Value::Array(Vec::new());
    }
    value.as_array_mut().expect("it has just been made one")
}

/// Removes `parent.outer.inner`, and `outer` if it becomes empty.
pub fn remove_inner(parent: &mut Object, outer: &str, inner: &str) {
    if let Some(Value::Object(object)) = parent.get_mut(outer) {
        object.remove(inner);
        if object.is_empty() {
            parent.remove(outer);
        }
    }
}

/// Object `index` of the array at `key`.
pub fn element<'a>(root: &'a mut Object, key: &str, index: usize) -> Option<&'a mut Object> {
    root.get_mut(key)?.get_mut(index)?.as_object_mut()
}

/// A single-precision number with its shortest digits: 0.95, not 0.949999988079071.
pub fn short(x: f32) -> Value {
    let digits: f64 = x.to_string().parse().expect("numbers are written as numbers");
    digits.into()
}

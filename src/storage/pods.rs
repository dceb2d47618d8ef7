//! `#[serde(with = "pods")]`: plain data as its bytes, which are copied at once. Lengths are validated; what the values
//! mean is not.

use bytemuck::{Pod, cast_slice, pod_collect_to_vec};
use serde::de::{Deserializer, Error};
use serde::ser::Serializer;

pub fn serialize<T: Pod, S: Serializer>(values: &[T], serializer: S) -> Result<S::Ok, S::Error> {
    serde_bytes::serialize(cast_slice::<T, u8>(values), serializer)
}

pub fn deserialize<'de, T: Pod, D: Deserializer<'de>>(deserializer: D) -> Result<Vec<T>, D::Error> {
    let bytes: &[u8] = serde_bytes::deserialize(deserializer)?;
    match bytes.len().is_multiple_of(size_of::<T>()) {
        true => Ok(pod_collect_to_vec(bytes)),
        false => Err(D::Error::invalid_length(bytes.len(), &"whole values")),
    }
}

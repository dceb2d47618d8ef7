//! What was measured on a device. It is kept in the cache folder, beside the device's compiled pipelines, so that each
//! device is measured once, and a choice that depends on it stays the same.

use std::path::{Path, PathBuf};
use std::sync::Mutex;

use serde::Serialize;
use serde::de::DeserializeOwned;
use serde_json::{Map, Value};

use super::UNPOISONED;
use super::device::DeviceInfo;
use crate::error::{Error, Result};
use crate::storage::file::write_bytes;

/// Measurements of one device with one version of its driver, by name.
pub struct Measurements {
    file: Option<PathBuf>,
    values: Mutex<Map<String, Value>>,
}

impl Measurements {
    /// Those of `info` that `cache_dir` has; without a folder, none, and new ones end with this value.
    pub fn of(info: &DeviceInfo, cache_dir: Option<&Path>) -> Self {
        let file = cache_dir.map(|dir| dir.join(info.file_name("measurements", "json")));
        let values = Mutex::new(file.as_deref().map_or_else(Map::new, read));
        Self { file, values }
    }

    /// The measurement called `name`, if it is kept.
    pub fn kept<T: DeserializeOwned>(&self, name: &str) -> Option<T> {
        T::deserialize(self.values.lock().expect(UNPOISONED).get(name)?).ok()
    }

    /// The measurement called `name`: if it is not kept, `measure` makes it.
    pub fn get<T: Serialize + DeserializeOwned>(&self, name: &str, measure: impl FnOnce() -> Result<T>) -> Result<T> {
        if let Some(kept) = self.kept(name) {
            return Ok(kept);
        }
        let measured = measure()?;
        let value = serde_json::to_value(&measured).expect("measurements are plain data");
        if let Err(error) = self.keep(name, value) {
            tracing::debug!("measurements are not kept: {error}"); // the cache folder may be read-only
        }
        Ok(measured)
    }

    fn keep(&self, name: &str, value: Value) -> Result<()> {
        let mut values = self.values.lock().expect(UNPOISONED);
        // Another process may have added some.
        values.extend(self.file.as_deref().map_or_else(Map::new, read));
        values.insert(name.into(), value);
        let Some((file, folder)) = self.file.as_ref().and_then(|file| Some((file, file.parent()?))) else {
            return Ok(());
        };
        std::fs::create_dir_all(folder).map_err(Error::io("create", folder))?;
        write_bytes(file, format!("{:#}\n", Value::Object(values.clone())).as_bytes())
    }
}

/// Empty if there is no such file or it is damaged: then everything is measured again.
fn read(file: &Path) -> Map<String, Value> {
    std::fs::read(file).ok().and_then(|bytes| serde_json::from_slice(&bytes).ok()).unwrap_or_default()
}

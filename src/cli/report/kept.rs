//! What was measured before, so that a report that was interrupted goes on where it was.

use std::path::{Path, PathBuf};

use relume::{Error, Result};
use serde::Serialize;
use serde::de::DeserializeOwned;
use serde_json::{Map, Value};

use crate::cli::output::write_json;

/// Figures by what they were measured of, in a file of the report's folder.
pub struct Kept {
    path: PathBuf,
    figures: Map<String, Value>,
    /// Of this program: another one measures anew.
    program: String,
}

impl Kept {
    /// What there is in `dir`.
    pub fn open(dir: &Path) -> Result<Self> {
        let path = dir.join("measured.json");
        let program =
            std::env::current_exe().and_then(std::fs::read).map_err(Error::io("read", Path::new("relume")))?;
        let program = blake3::hash(&program).to_hex().to_string();
        let figures = match std::fs::read(&path) {
            Ok(bytes) => serde_json::from_slice(&bytes)
                .map_err(|e| Error::import_from(&path, "not what relume wrote; remove it to measure anew", e))?,
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => Map::new(),
            Err(error) => return Err(Error::io("read", &path)(error)),
        };
        Ok(Self { path, figures, program })
    }

    /// What was measured of `what`, by this very program.
    pub fn get<T: DeserializeOwned>(&self, what: &str) -> Option<T> {
        T::deserialize(self.figures.get(&self.key(what))?).ok()
    }

    pub fn keep<T: Serialize>(&mut self, what: &str, figures: &T) -> Result<()> {
        let value =
            serde_json::to_value(figures).map_err(|e| Error::Export { path: self.path.clone(), source: e.into() })?;
        self.figures.insert(self.key(what), value);
        write_json(&self.path, &Value::Object(self.figures.clone()))
    }

    fn key(&self, what: &str) -> String {
        blake3::hash(format!("{} {what}", self.program).as_bytes()).to_hex()[..32].to_owned()
    }
}

//! What was measured before, so that a report that was interrupted goes on where it was.

use std::path::{Path, PathBuf};

use relume::{Error, Result};
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};

use super::machine;
use crate::cli::output_file::write_json;

/// Figures by what they were measured of, in a file of the report's folder. Those of another program are not looked at.
pub struct MeasurementStore {
    path: PathBuf,
    file: File,
}

#[derive(Default, Serialize, Deserialize)]
struct File {
    schema: u32,
    /// Hash of the program that measured, and of its processor.
    program: String,
    /// When it began, UTC.
    since: String,
    figures: Map<String, Value>,
}

impl MeasurementStore {
    /// What there is in `dir`.
    pub fn open(dir: &Path) -> Result<Self> {
        let path = dir.join("measured.json");
        let program =
            std::env::current_exe().and_then(std::fs::read).map_err(Error::io("read", Path::new("relume")))?;
        let program = blake3::hash(&[program, machine::processor().into_bytes()].concat()).to_hex().to_string();
        let file = match std::fs::read(&path) {
            Ok(bytes) => serde_json::from_slice(&bytes)
                .map_err(|e| Error::import_from(&path, "not what relume wrote; remove it to measure anew", e))?,
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => File::default(),
            Err(error) => return Err(Error::io("read", &path)(error)),
        };
        let file = if file.program == program {
            file
        } else {
            File { schema: 1, program, since: machine::now(), figures: Map::new() }
        };
        Ok(Self { path, file })
    }

    /// Names the program and its machine.
    pub fn program(&self) -> &str {
        &self.file.program[..8]
    }

    pub fn since(&self) -> &str {
        &self.file.since
    }

    /// What was measured of `what`.
    pub fn get<T: DeserializeOwned>(&self, what: &str) -> Option<T> {
        T::deserialize(self.file.figures.get(&key(what))?).ok()
    }

    pub fn keep<T: Serialize>(&mut self, what: &str, figures: &T) -> Result<()> {
        let json = |e: serde_json::Error| Error::Export { path: self.path.clone(), source: e.into() };
        let value = serde_json::to_value(figures).map_err(json)?;
        self.file.figures.insert(key(what), value);
        write_json(&self.path, &serde_json::to_value(&self.file).map_err(json)?)
    }
}

fn key(what: &str) -> String {
    blake3::hash(what.as_bytes()).to_hex()[..32].to_owned()
}

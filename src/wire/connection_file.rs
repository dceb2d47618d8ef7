//! The file that tells other programs of this user where a server listens, and its token.

use std::fs;
use std::path::{Path, PathBuf};

use serde_json::json;

use super::message::PROTOCOL;
use crate::error::{Error, Result};
use crate::storage::file;

/// The file, as long as the server listens. Only its user can read it.
pub struct ConnectionFile {
    path: PathBuf,
    content: String,
}

impl ConnectionFile {
    pub fn write(path: &Path, port: u16, token: &str) -> Result<Self> {
        let content = json!({
            "protocol": PROTOCOL, "host": "127.0.0.1", "port": port, "token": token, "pid": std::process::id(),
        });
        let content = format!("{content}\n");
        file::write_private(path, content.as_bytes())?;
        Ok(Self { path: path.to_owned(), content })
    }
}

impl Drop for ConnectionFile {
    fn drop(&mut self) {
        // Another server may have written its own there.
        if fs::read_to_string(&self.path).is_ok_and(|content| content == self.content)
            && let Err(error) = fs::remove_file(&self.path).map_err(Error::io("remove", &self.path))
        {
            tracing::warn!("{}", error.chain());
        }
    }
}

use std::path::Path;

use super::Scene;
use crate::error::Result;

pub fn load(path: &Path) -> Result<Scene> {
    let _ = path;
    todo!()
}

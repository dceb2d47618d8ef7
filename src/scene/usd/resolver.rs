//! Files of a stage, refused where openusd's parser would overflow the stack.

use std::io::{self, Cursor};

use openusd::ar::{Asset, DefaultResolver, ResolvedPath, Resolver};

/// Finds files as openusd does by default.
#[derive(Default)]
pub struct ShallowFiles(DefaultResolver);

/// Of brackets in text; stages of films have some twenty levels. openusd 0.6 overflows 2 MiB of stack after some
/// hundreds.
const MAX_DEPTH: usize = 128;

impl Resolver for ShallowFiles {
    fn create_identifier(&self, asset_path: &str, anchor: Option<&ResolvedPath>) -> String {
        self.0.create_identifier(asset_path, anchor)
    }

    fn resolve(&self, asset_path: &str) -> Option<ResolvedPath> {
        self.0.resolve(asset_path)
    }

    fn resolve_for_new_asset(&self, asset_path: &str) -> Option<ResolvedPath> {
        self.0.resolve_for_new_asset(asset_path)
    }

    fn open_asset(&self, resolved_path: &ResolvedPath) -> io::Result<Box<dyn Asset>> {
        let bytes = self.0.open_asset(resolved_path)?.read_all()?;
        if bytes.starts_with(b"#usda") && depth(&bytes) > MAX_DEPTH {
            let reason = format!("its brackets are nested more than {MAX_DEPTH} times");
            return Err(io::Error::new(io::ErrorKind::InvalidData, reason));
        }
        Ok(Box::new(Cursor::new(bytes)))
    }
}

/// How deep brackets are nested, those in strings and comments included.
fn depth(text: &[u8]) -> usize {
    let (mut depth, mut most) = (0usize, 0);
    for byte in text {
        match byte {
            b'(' | b'[' | b'{' => depth += 1,
            b')' | b']' | b'}' => depth = depth.saturating_sub(1),
            _ => {}
        }
        most = most.max(depth);
    }
    most
}

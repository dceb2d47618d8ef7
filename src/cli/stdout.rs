//! What was asked for, on standard output. `println!` panics where a pipe's reader has gone or a disk is full.

use std::fmt::Arguments;
use std::io::{ErrorKind, Write};
use std::path::Path;

use relume::{Error, Result};

const NAME: &str = "standard output";

/// Prints a line on standard output: the arguments are those of `println!`.
macro_rules! out {
    ($($argument:tt)*) => {
        $crate::cli::stdout::line(format_args!($($argument)*))
    };
}
pub(super) use out;

pub fn line(text: Arguments) -> Result<()> {
    // In one piece: lines that hold line breaks reach a pipe whole.
    let text = format!("{text}\n");
    std::io::stdout().write_all(text.as_bytes()).map_err(Error::io("write", Path::new(NAME)))
}

/// Whether the reader of standard output has seen enough, as `head` does.
pub fn reader_has_gone(error: &Error) -> bool {
    matches!(error, Error::Io { path, source, .. }
        if path == Path::new(NAME) && source.kind() == ErrorKind::BrokenPipe)
}

//! The command line: one module per subcommand.

mod cli;

use std::process::ExitCode;

/// Gives back to the system what bakes free, which glibc keeps in pieces.
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

fn main() -> ExitCode {
    cli::main()
}

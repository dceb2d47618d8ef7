//! The command line: one module per subcommand.

fn main() {}

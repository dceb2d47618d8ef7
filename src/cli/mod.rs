//! Subcommands, and what they share: logging, progress, exit status.

mod bake;
mod bench;
mod bench_rays;
mod bench_rig;
mod compare;
mod devices;
mod options;
mod output;
mod percentile;
mod plan;
mod progress;
mod reference;
mod render;
mod report;
mod rig;
mod stats;
mod stdout;
mod transfer;
mod view;

use std::io::Write;
use std::process::ExitCode;

use clap::Parser;
use relume::Error;

/// Interactive relighting: precomputes what the lights do not change, then shows any edit of a light at once.
#[derive(Parser)]
#[command(version, propagate_version = true, max_term_width = 120)]
#[command(after_help = "Exit status: 0 done; 1 the work failed, and one line on stderr says why; 2 bad usage.")]
struct Cli {
    #[command(subcommand)]
    command: Command,
    /// No progress and no warnings.
    #[arg(long, short, global = true, display_order = 900)]
    quiet: bool,
    /// Says what is decided and how long it takes; twice, more of it.
    #[arg(long, short, global = true, display_order = 901, action = clap::ArgAction::Count)]
    verbose: u8,
}

#[derive(clap::Subcommand)]
enum Command {
    /// Bakes what is missing and writes the relit image.
    Render(render::Args),
    /// Opens the lighting desk: a window in which lights follow keyboard and mouse.
    View(view::Args),
    /// Precomputes a scene and stores it in the cache.
    Bake(bake::Args),
    /// Times edits of lights.
    Bench(bench::Args),
    /// Writes a page of errors against run time, with its numbers as CSV and its pictures as EXR.
    Report(report::Args),
    /// Tells what a scene needs, what is left out and what that saves.
    Plan(plan::Args),
    /// Writes a scene's lights and camera as a rig, or the scene with a rig's lights.
    Rig(rig::Args),
    /// Traces the truth: an unbiased image in two independent halves.
    #[command(after_long_help = reference::AFTER_HELP)]
    Reference(reference::Args),
    /// Measures how an image differs from a reference; prints JSON.
    Compare(compare::Args),
    /// Lists Vulkan devices, their drivers, and what each lacks.
    Devices(devices::Args),
}

/// Runs the command line; exit status 0: done, 1: the work failed, 2: bad usage.
pub fn main() -> ExitCode {
    let cli = Cli::parse();
    log_to_stderr(cli.quiet, cli.verbose);
    progress::set_quiet(cli.quiet);
    let result = match &cli.command {
        Command::Render(args) => render::run(args),
        Command::View(args) => view::run(args),
        Command::Bake(args) => bake::run(args),
        Command::Bench(args) => bench::run(args),
        Command::Report(args) => report::run(args),
        Command::Plan(args) => plan::run(args),
        Command::Rig(args) => rig::run(args),
        Command::Reference(args) => reference::run(args, cli.quiet),
        Command::Compare(args) => compare::run(args),
        Command::Devices(args) => devices::run(args),
    };
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) if stdout::reader_has_gone(&error) => ExitCode::SUCCESS,
        Err(error) => {
            // Where stderr is full or closed nobody can be told; the exit status still tells.
            let _ = writeln!(std::io::stderr(), "relume: {}", chain(&error));
            ExitCode::FAILURE
        }
    }
}

/// An error and its causes on one line.
fn chain(error: &Error) -> String {
    let causes = std::iter::successors(std::error::Error::source(error), |cause| cause.source());
    let text = causes.fold(error.to_string(), |text, cause| format!("{text}: {cause}"));
    text.split_whitespace().collect::<Vec<_>>().join(" ")
}

fn log_to_stderr(quiet: bool, verbose: u8) {
    use tracing_subscriber::filter::{LevelFilter, Targets};
    use tracing_subscriber::layer::SubscriberExt;
    use tracing_subscriber::util::SubscriberInitExt;
    let level = match (quiet, verbose) {
        (true, _) => LevelFilter::ERROR,
        (false, 0) => LevelFilter::WARN,
        (false, 1) => LevelFilter::INFO,
        (false, _) => LevelFilter::DEBUG,
    };
    let lines = tracing_subscriber::fmt::layer()
        .with_writer(std::io::stderr)
        .log_internal_errors(false) // it would report a full stderr on stderr, and panic
        .with_target(false)
        .without_time()
        .with_ansi(std::io::IsTerminal::is_terminal(&std::io::stderr()));
    // Libraries have their own idea of what deserves a warning.
    let ours = Targets::new().with_target("relume", level).with_default(LevelFilter::ERROR);
    tracing_subscriber::registry().with(lines).with(ours).init();
}

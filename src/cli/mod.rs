//! Subcommands, and what they share: logging, progress, exit status.

mod bake;
mod bench;
mod bench_rays;
mod bench_rig;
mod compare;
mod data_passes;
mod devices;
mod farm;
mod final_gather;
mod options;
mod output;
mod output_file;
mod percentile;
mod plan;
mod progress;
mod reference;
mod render;
mod report;
mod rig;
mod serve;
mod stats;
mod stdout;
mod transfer;
mod unneeded;
mod view;

use std::io::Write;
use std::process::ExitCode;

use clap::Parser;

/// Relights a scene while you edit its lights. relume bakes once what does not depend on the lights; then every edit
/// shows at once.
#[derive(Parser)]
#[command(version, propagate_version = true, max_term_width = 120)]
#[command(after_help = AFTER_HELP)]
struct Cli {
    #[command(subcommand)]
    command: Command,
    /// Shows no progress and no warnings.
    #[arg(long, short, global = true, display_order = 900)]
    quiet: bool,
    /// Prints each decision and the time of each step. -vv prints more.
    #[arg(long, short, global = true, display_order = 901, action = clap::ArgAction::Count)]
    verbose: u8,
}

const AFTER_HELP: &str = "\
A bake is the calculation that relume does once for a scene and camera. A rig is a file with lights.

Exit status: 0: done. 1: the work failed; one line on standard error gives the reason. 2: wrong usage.";

#[derive(clap::Subcommand)]
enum Command {
    /// Writes a picture of the scene under its lights; bakes first if needed.
    Render(render::Args),
    /// Opens the lighting desk: a window in which you edit lights with keyboard and mouse.
    View(view::Args),
    /// Lets other programs edit the lights of a scene, and answers with pictures; opens no window.
    #[command(after_long_help = serve::AFTER_HELP)]
    Serve(serve::Args),
    /// Bakes a scene and stores the result in the cache.
    Bake(bake::Args),
    /// Writes a job for a render farm, which bakes shots in parts and renders them.
    #[command(after_long_help = farm::AFTER_HELP)]
    Farm(farm::Args),
    /// Measures how long edits of lights take.
    #[command(after_long_help = bench::AFTER_HELP)]
    Bench(bench::Args),
    /// Measures errors and times, and writes them as an HTML page, with its figures as CSV and its pictures as EXR.
    #[command(after_long_help = report::AFTER_HELP)]
    Report(report::Args),
    /// Tells what the bake of a scene needs, what it leaves out, and whether it fits in memory. Bakes nothing.
    #[command(after_long_help = plan::AFTER_HELP)]
    Plan(plan::Args),
    /// Writes the lights and the camera of a scene to a rig file. With --rig: writes the scene with the lights of that
    /// rig.
    Rig(rig::Args),
    /// Renders an unbiased reference with the path tracer, as two independent halves.
    #[command(after_long_help = reference::AFTER_HELP)]
    Reference(reference::Args),
    /// Measures how an image differs from a reference; prints JSON.
    Compare(compare::Args),
    /// Lists the Vulkan devices, their drivers, what each one lacks, and what was measured on it.
    #[command(after_long_help = devices::AFTER_HELP)]
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
        Command::Serve(args) => serve::run(args),
        Command::Bake(args) => bake::run(args),
        Command::Farm(args) => farm::run(args),
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
            let _ = writeln!(std::io::stderr(), "relume: {}", error.chain());
            ExitCode::FAILURE
        }
    }
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

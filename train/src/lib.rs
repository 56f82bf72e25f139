//! The program `splat`: trains, evaluates and renders Gaussian-splatting scenes. One file per subcommand.
//!
//! Results go to standard output, progress and errors to standard error.
//!
//! The library takes the program's options and writes its files; `train` also returns
//! [`Metrics`](report::metrics::Metrics). An example makes a small capture, a scene, and pictures of it:
//!
//! ```
//! use clap::Parser;
//! use splat_train::options::{Cli, Command};
//!
//! let folder = tempfile::tempdir()?;
//! let path = |name: &str| folder.path().join(name).display().to_string();
//! let (capture, out, pictures) = (path("capture"), path("out"), path("pictures"));
//! let parse = |arguments: &[&str]| Cli::try_parse_from(["splat"].iter().chain(arguments));
//!
//! let demo = ["demo", "--out", &capture, "--views", "9", "--width", "32", "--height", "32", "--points", "60"];
//! splat_train::run(&parse(&demo)?.command)?;
//!
//! let train = ["train", &capture, "--out", &out, "--steps", "20", "--effects", "none", "--sh-degree", "0", "--device", "cpu"];
//! let Command::Train(options) = parse(&train)?.command else { unreachable!("asked for `train`") };
//! let metrics = splat_train::train::run(&options)?;
//! // The first and the last of the nine photographs are held out.
//! assert_eq!(metrics.test.map(|scores| scores.views.len()), Some(2));
//!
//! let scene = format!("{out}/scene.ply");
//! let render =
//!     ["render", "--scene", &scene, "--capture", &capture, "--view", "all", "--out", &pictures, "--device", "cpu"];
//! splat_train::run(&parse(&render)?.command)?;
//! assert_eq!(std::fs::read_dir(&pictures)?.count(), 9);
//! # Ok::<(), anyhow::Error>(())
//! ```
//!
//! `splat --help` describes the options, and `splat-model` implements them. [`describe`] formats an error for people.

pub mod options;

pub mod background;
pub mod blocks;
pub mod clean;
pub mod completions;
pub mod convert;
pub mod demo;
pub mod devices;
pub mod eval;
pub mod export;
pub mod hard_cases;
pub mod inspect;
pub mod mesh;
pub mod pareto;
pub mod reconstruct;
pub mod render;
pub mod train;
pub mod view;

pub mod accuracy;
pub mod device;
pub mod effects;
pub mod input;
pub mod inputs;
mod live;
pub mod lpips;
pub mod memory;
pub mod output;
pub mod parts;
pub mod progress;
pub mod ranks;
pub mod registry;
pub mod report;
mod stop;

use anyhow::Result;

use crate::options::Command;

/// Runs one subcommand. An error if the subcommand fails; the message names the file or option to blame and the remedy.
pub fn run(command: &Command) -> Result<()> {
    match command {
        Command::Train(args) => {
            args.voice.apply();
            train::run_together(args)
        }
        Command::Resume(args) => {
            args.voice.apply();
            train::resume_together(args)
        }
        Command::Reconstruct(args) => {
            args.voice.apply();
            reconstruct::run(args)
        }
        Command::Eval(args) => eval::run(args).map(drop),
        Command::Render(args) => render::run(args).map(drop),
        Command::Blocks(args) => blocks::run(args),
        Command::Demo(args) => demo::run(args),
        Command::View(args) => view::run(args),
        Command::Convert(args) => convert::run(args),
        Command::Export(args) => export::run(args),
        Command::Clean(args) => clean::run(args),
        Command::Mesh(args) => mesh::run(args),
        Command::Inspect(args) => inspect::run(args),
        Command::HardCases(args) => hard_cases::run(args),
        Command::Pareto(args) => pareto::run(args),
        Command::Devices => devices::run(),
        Command::Completions(args) => completions::run(args, options::command()),
    }
}

/// Formats an error for people: the failure, then its causes, one line each.
pub fn describe(error: &anyhow::Error) -> String {
    let mut text = format!("error: {error}");
    for cause in error.chain().skip(1).map(ToString::to_string) {
        // Some libraries include their cause in the message and also return it as their source.
        if !text.contains(&cause) {
            text.push_str("\n  because: ");
            text.push_str(&cause);
        }
    }
    text
}

#[cfg(test)]
mod tests;

//! The command line: options shared by several subcommands; the others are beside their subcommands. Defaults come from
//! the typed configurations that the options are converted to, so that each default has one place.

use clap::{Parser, Subcommand, value_parser};
use serde::{Deserialize, Serialize};
use splat_model::capture::{Capture, Split};

use crate::blocks::BlocksArgs;
use crate::clean::CleanArgs;
use crate::convert::ConvertArgs;
use crate::demo::DemoArgs;
use crate::eval::EvalArgs;
use crate::export::ExportArgs;
use crate::hard_cases::HardCasesArgs;
use crate::inspect::InspectArgs;
use crate::manual::{CompletionsArgs, ManArgs};
use crate::pareto::ParetoArgs;
use crate::reconstruct::ReconstructArgs;
use crate::render::RenderArgs;
use crate::train::{ResumeArgs, TrainArgs};
use crate::view::ViewArgs;

/// The exit codes, at the end of `--help`.
pub const EXIT_CODES: &str = "\
Exit codes:
  0    success
  1    error, with a message on standard error
  2    invalid command line
  130  stopped by Ctrl-C
  143  stopped by SIGTERM";

/// Train, evaluate and render Gaussian-splatting scenes.
#[derive(Clone, Debug, Parser)]
#[command(name = "splat", version, after_help = EXIT_CODES)]
pub struct Cli {
    /// The subcommand to run.
    #[command(subcommand)]
    pub command: Command,
}

/// The subcommands.
#[derive(Clone, Debug, Subcommand)]
#[allow(clippy::large_enum_variant, reason = "a process has one")]
pub enum Command {
    /// Train a scene on a capture, then score it on the held-out photographs
    Train(TrainArgs),
    /// Resume a training run that was stopped or killed, with its original options
    Resume(ResumeArgs),
    /// Find the cameras of photographs or a video with the installed COLMAP
    Reconstruct(ReconstructArgs),
    /// Score a scene on the held-out photographs of a capture
    Eval(EvalArgs),
    /// Render a scene from the cameras of a capture
    Render(RenderArgs),
    /// Show a scene in the browser, served to this machine only
    View(ViewArgs),
    /// Convert a scene to another format and report the loss
    Convert(ConvertArgs),
    /// Write a scene as one page with the viewer, which needs no server
    Export(ExportArgs),
    /// Remove splats that float, that no view shows, or that lie outside a region, and report the cost
    Clean(CleanArgs),
    /// Describe a scene or a capture: counts, bounds, what is odd about it, and which effects a capture calls for
    #[command(alias = "info")]
    Inspect(InspectArgs),
    /// Train a capture in blocks, on any number of machines: plan, status, merge
    Blocks(BlocksArgs),
    /// Write the demo capture: a small ray-traced scene as a COLMAP folder
    Demo(DemoArgs),
    /// Run the battery of hard cases and write the table of results
    HardCases(HardCasesArgs),
    /// Measure the time and the error of every accuracy dial on a scene, and plot the Pareto frontier
    Pareto(ParetoArgs),
    /// List the devices to compute on, by the names that `--device` accepts
    Devices,
    /// Write completions of the command line for a shell
    Completions(CompletionsArgs),
    /// Write the manual pages
    Man(ManArgs),
}

/// Selection and size of the photographs.
#[derive(Clone, Debug, clap::Args, Serialize, Deserialize)]
pub struct PhotoArgs {
    /// Hold out every Kth photograph in name order for testing
    #[arg(long, value_name = "K", help = format!(
        "Hold out every Kth photograph in name order for testing, beginning with the first; 0 holds out none [default: the \
         capture's own split if its files have one, otherwise {}]", Split::USUAL
    ))]
    pub test_every: Option<usize>,
    /// The name of `--test-every` until version 0.1, which elsewhere is an interval between evaluations
    #[arg(long, hide = true, value_name = "K", value_parser = renamed)]
    #[serde(skip)]
    pub eval_every: Option<usize>,
    /// Downsize photographs whose longer side exceeds this, px
    #[arg(long, value_name = "PX", value_parser = value_parser!(u32).range(1..))]
    pub max_side: Option<u32>,
}

fn renamed(_: &str) -> Result<usize, String> {
    Err("the split is `--test-every K` now; `--eval-during N` scores the scene every N steps".into())
}

impl PhotoArgs {
    /// Returns the split of a capture, and these options as reported: with the number that was used, or none if the
    /// capture's own split applies.
    pub fn split(&self, capture: &Capture) -> (Split, Self) {
        let counted = self.test_every.or_else(|| capture.split.is_none().then_some(Split::USUAL));
        (Split::of(capture, counted), Self { test_every: counted, ..self.clone() })
    }
}

#[cfg(test)]
mod tests {
    use clap::CommandFactory;

    use super::*;

    #[test]
    fn the_command_line_is_consistent() {
        Cli::command().debug_assert();
    }

    #[test]
    fn a_run_that_goes_on_takes_no_options_of_a_new_one() {
        let resume = |option: &str| Cli::try_parse_from(["splat", "resume", "out", option]);
        for option in ["--steps=7", "--check", "--out=other", "--device=cpu", "capture"] {
            assert!(resume(option).is_err(), "{option}");
        }
        for option in ["--quiet", "--json"] {
            let Command::Resume(args) = resume(option).unwrap().command else { panic!("asked for resume") };
            assert_eq!((args.voice.quiet, args.voice.json), (option == "--quiet", option == "--json"));
        }
        assert!(Cli::try_parse_from(["splat", "resume"]).is_err(), "of which run?");
    }
}

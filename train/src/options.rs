//! The command line. What several subcommands share is here, the rest beside each of them. Defaults come from the typed
//! configurations that the options end up in, so that there is one place to change them.

use clap::{Parser, Subcommand, value_parser};
use serde::{Deserialize, Serialize};
use splat_model::capture::{Capture, Split};

use crate::convert::ConvertArgs;
use crate::demo::DemoArgs;
use crate::eval::EvalArgs;
use crate::gains::GainsArgs;
use crate::hard_cases::HardCasesArgs;
use crate::inspect::InspectArgs;
use crate::manual::{CompletionsArgs, ManArgs};
use crate::pareto::ParetoArgs;
use crate::render::RenderArgs;
use crate::train::{ResumeArgs, TrainArgs};
use crate::view::ViewArgs;

/// What the program's exit codes mean, as `--help` ends.
pub const EXIT_CODES: &str = "\
Exit codes:
  0    all went well
  1    an error, which standard error names
  2    a command line that cannot be understood
  130  stopped by Ctrl-C
  143  stopped by SIGTERM";

/// Train, evaluate and render Gaussian-splatting scenes.
#[derive(Clone, Debug, Parser)]
#[command(name = "splat", version, after_help = EXIT_CODES)]
pub struct Cli {
    /// What to do.
    #[command(subcommand)]
    pub command: Command,
}

/// The subcommands.
#[derive(Clone, Debug, Subcommand)]
pub enum Command {
    /// Train a scene on a capture, then measure it on the photographs that were held out
    Train(TrainArgs),
    /// Go on with a training run that was stopped or killed, with the options that it was started with
    Resume(ResumeArgs),
    /// Measure a scene on the photographs of a capture that were held out
    Eval(EvalArgs),
    /// Render a scene as the cameras of a capture see it
    Render(RenderArgs),
    /// Show a scene in the browser, from a server for this machine alone
    View(ViewArgs),
    /// Write a scene in another format, and say what that loses
    Convert(ConvertArgs),
    /// Say what a capture shows, which effects it calls for, and what they would cost
    Inspect(InspectArgs),
    /// Write the demo capture: a small ray-traced scene as a COLMAP folder
    Demo(DemoArgs),
    /// Measure what each effect gains and costs on demo captures that show it, and write the page
    Effects(GainsArgs),
    /// Run the battery of hard cases and write the table of how it fares
    HardCases(HardCasesArgs),
    /// Measure what every dial costs in time and in error, on a scene of yours, and draw the frontier
    Pareto(ParetoArgs),
    /// List what there is to compute on, by the names that `--device` takes
    Devices,
    /// Write the completions of the command line for a shell
    Completions(CompletionsArgs),
    /// Write the manual's pages
    Man(ManArgs),
}

/// Which photographs are used, and at which size.
#[derive(Clone, Debug, clap::Args, Serialize, Deserialize)]
pub struct PhotoArgs {
    /// Hold out every Kth photograph by name for testing
    #[arg(long, value_name = "K", help = format!(
        "Hold out every Kth photograph by name for testing, beginning with the first; 0 holds out none [default: the \
         capture's own split if its files have one, otherwise {}]", Split::USUAL
    ))]
    pub eval_every: Option<usize>,
    /// Downsize photographs whose longer side exceeds this, px
    #[arg(long, value_name = "PX", value_parser = value_parser!(u32).range(1..))]
    pub max_side: Option<u32>,
}

impl PhotoArgs {
    /// The split of a capture, and these options as they are reported: with the number that was counted by, or none if
    /// the capture's own split was taken.
    pub fn split(&self, capture: &Capture) -> (Split, Self) {
        let counted = self.eval_every.or_else(|| capture.split.is_none().then_some(Split::USUAL));
        (Split::of(capture, counted), Self { eval_every: counted, ..self.clone() })
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

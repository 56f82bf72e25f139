//! The command line. Options are beside their subcommands. Defaults come from the typed configurations that the options are converted to,
//! so that each default has one place.

use std::ffi::OsString;

use anyhow::{Result, anyhow};
use clap::{CommandFactory, FromArgMatches, Parser, Subcommand};

use crate::blocks::BlocksArgs;
use crate::clean::CleanArgs;
use crate::completions::CompletionsArgs;
use crate::convert::ConvertArgs;
use crate::demo::DemoArgs;
use crate::eval::EvalArgs;
use crate::export::ExportArgs;
use crate::hard_cases::HardCasesArgs;
use crate::inspect::InspectArgs;
use crate::mesh::MeshArgs;
use crate::pareto::ParetoArgs;
use crate::reconstruct::ReconstructArgs;
use crate::render::RenderArgs;
use crate::train::{self, ResumeArgs, TrainArgs};
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

/// The subcommands, in the order of a user's day. Those of no group are hidden.
#[derive(Clone, Debug, Subcommand)]
#[allow(clippy::large_enum_variant, reason = "a process has one")]
pub enum Command {
    /// Train a scene on a capture, photographs or a video, then score it
    Train(TrainArgs),
    /// Go on with a run that was stopped or killed, with its own options
    Resume(ResumeArgs),
    /// Show a scene in the browser, served to this machine only
    View(ViewArgs),
    /// Write a scene as one page with the viewer, which needs no server
    Export(ExportArgs),
    /// Convert a scene to another format and report the loss
    Convert(ConvertArgs),
    /// Remove floaters and what no view shows, and report the cost
    Clean(CleanArgs),
    /// Extract the surface of a scene as a triangle mesh with colours
    Mesh(MeshArgs),
    /// Describe a scene or a capture, and the effects that it calls for
    #[command(alias = "info")]
    Inspect(InspectArgs),
    /// Score a scene on the held-out photographs of a capture
    Eval(EvalArgs),
    /// Render a scene from the cameras of a capture, or along a path to a video
    Render(RenderArgs),
    /// Measure the time and the error of every accuracy dial on a scene
    Pareto(ParetoArgs),
    /// Find the cameras of photographs or a video with the installed COLMAP
    Reconstruct(ReconstructArgs),
    /// Train a capture in blocks, on any number of machines
    Blocks(BlocksArgs),
    /// List the devices to compute on, by the names that `--device` accepts
    Devices,
    /// Run the battery of hard cases and write the table of results
    HardCases(HardCasesArgs),
    /// Write the demo capture: a small ray-traced scene as a COLMAP folder
    #[command(hide = true)]
    Demo(DemoArgs),
    /// Write completions of the command line for a shell
    #[command(hide = true)]
    Completions(CompletionsArgs),
}

/// The first subcommand of each group in the help, and the group's title.
const GROUPS: [(&str, &str); 4] =
    [("train", "Scenes"), ("inspect", "Measurements"), ("reconstruct", "Captures"), ("devices", "Machine")];

/// The command line as it is parsed and shown: subcommands in groups, and short help without the options below a heading.
pub fn command() -> clap::Command {
    let mut command = Cli::command();
    let mut groups = String::new();
    for shown in command.get_subcommands().filter(|command| !command.is_hide_set()) {
        let (name, about) = (shown.get_name(), shown.get_about().map(ToString::to_string).unwrap_or_default());
        if let Some((_, title)) = GROUPS.iter().find(|(first, _)| *first == name) {
            groups += &format!("\n{title}:\n");
        }
        groups += &format!("  {name:11}  {about}\n");
    }
    let names: Vec<String> = command.get_subcommands().map(|command| command.get_name().to_owned()).collect();
    for name in names {
        command = command.mut_subcommand(&name, |command| {
            // Options of `--config` come first, and those of the command line replace them.
            let command = command.args_override_self(name == "train");
            command.mut_args(|arg| if arg.get_help_heading().is_some() { arg.hide_short_help(true) } else { arg })
        });
    }
    command.help_template(format!(
        "{{about-with-newline}}\n{{usage-heading}} {{usage}}\n{groups}\nOptions:\n{{options}}{{after-help}}"
    ))
}

/// Parses a command line, the first word of which is the program. `splat train --config FILE` takes the options of the file too. An error:
/// a [`clap::Error`] for an invalid command line, also for a request for help; and if the file cannot be read.
pub fn parse(words: impl IntoIterator<Item = OsString>) -> Result<Cli> {
    let parsed = |words: &[OsString]| Cli::from_arg_matches(&command().try_get_matches_from(words)?);
    let mut words: Vec<OsString> = words.into_iter().collect();
    let cli = parsed(&words)?;
    let Command::Train(given @ TrainArgs { config: Some(path), .. }) = &cli.command else { return Ok(cli) };
    let command = command();
    let train = command.find_subcommand("train").unwrap_or(&command);
    words.splice(2..2, train::config::words(path, train, given)?.into_iter().map(OsString::from));
    parsed(&words).map_err(|error| anyhow!("{}: {}", path.display(), error.render()))
}

#[cfg(test)]
mod tests;

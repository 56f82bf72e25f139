//! `splat completions` and `splat man`: shell completions and manual pages.

use std::io::{self, Write};
use std::path::PathBuf;

use anyhow::{Context, Result};
use clap_complete::Shell;

use crate::inputs::Inputs;
use crate::output::OutputFolder;
use crate::progress;

/// Options of `splat completions`.
#[derive(Clone, Debug, clap::Args)]
pub struct CompletionsArgs {
    /// Shell; for bash: `splat completions bash > ~/.local/share/bash-completion/completions/splat`
    pub shell: Shell,
}

/// Options of `splat man`.
#[derive(Clone, Debug, clap::Args)]
pub struct ManArgs {
    /// Folder for splat.1 and a page for each subcommand
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
}

/// Writes a shell's completion script to standard output.
///
/// # Errors
/// If standard output is closed.
pub fn completions(args: &CompletionsArgs, mut program: clap::Command) -> Result<()> {
    let mut script = Vec::new();
    clap_complete::generate(args.shell, &mut program, "splat", &mut script);
    io::stdout().write_all(&script).context("cannot write the script to standard output")
}

/// Writes the manual pages and prints their location.
///
/// # Errors
/// If a page cannot be written.
pub fn man(args: &ManArgs, mut program: clap::Command) -> Result<()> {
    let out = OutputFolder::prepare(&args.out, Inputs::default(), [""; 0], &[])?;
    // Sets the full names of subcommands.
    program.build();
    let subcommands = program.get_subcommands().filter(|command| command.get_name() != "help").cloned();
    for command in subcommands.chain([program.clone()]) {
        let name = command.get_display_name().unwrap_or(command.get_name()).to_owned();
        let page = out.join(format!("{name}.1"));
        out.write(format!("{name}.1"), |file| Ok(clap_mangen::Man::new(command).title(name).render(file)?))?;
        progress::say(&page.display().to_string());
    }
    Ok(())
}

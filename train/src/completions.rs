//! `splat completions`.

use std::io::{self, Write};

use anyhow::{Context, Result};
use clap_complete::Shell;

/// Options of `splat completions`.
#[derive(Clone, Debug, clap::Args)]
pub struct CompletionsArgs {
    /// Shell; for bash: `splat completions bash > ~/.local/share/bash-completion/completions/splat`
    pub shell: Shell,
}

/// Writes a shell's completion script to standard output. An error if standard output is closed.
pub fn run(args: &CompletionsArgs, mut program: clap::Command) -> Result<()> {
    let mut script = Vec::new();
    clap_complete::generate(args.shell, &mut program, "splat", &mut script);
    io::stdout().write_all(&script).context("cannot write the script to standard output")
}

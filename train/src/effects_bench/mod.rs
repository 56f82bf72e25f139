//! `splat effects`: gains and costs of the effects, measured on demo captures that show one effect each.

mod case;
mod page;

use std::fs;
use std::io::{ErrorKind, Write};
use std::path::PathBuf;

use anyhow::{Context, Result, bail};

use self::case::{CASES, EffectCase, EffectGain, RunSize};
use crate::inputs::Inputs;
use crate::output::OutputFolder;
use crate::progress;

/// Name of the written file.
pub const PAGE: &str = "EFFECTS.md";

/// Options of `splat effects`.
#[derive(Clone, Debug, clap::Args)]
pub struct EffectsBenchArgs {
    /// Folder for EFFECTS.md; in an existing file, only the figures are replaced
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// Measure only this case; may be given several times
    #[arg(long, value_name = "NAME")]
    pub case: Vec<String>,
    /// Small pictures and few steps, to test that effects are detected, not how much they gain
    #[arg(long)]
    pub quick: bool,
}

/// Measures the cases, prints the table and writes the page.
///
/// # Errors
/// If a case does not exist, a run fails, or the page cannot be read or written. If an effect was missed, found where it is
/// absent, or gains less than required, the page is written and the error lists the cases.
pub fn run(args: &EffectsBenchArgs) -> Result<()> {
    for name in &args.case {
        if !CASES.iter().any(|case| case.name == name) {
            let names: Vec<&str> = CASES.iter().map(|case| case.name).collect();
            bail!("there is no case {name:?}: give `--case` one of {}", names.join(", "));
        }
    }
    let out = OutputFolder::prepare(&args.out, Inputs::default(), [PAGE], &[])?;
    let path = out.join(PAGE);
    let earlier = match fs::read_to_string(&path) {
        Err(error) if error.kind() == ErrorKind::NotFound => None,
        read => Some(read.with_context(|| format!("cannot read {}", path.display()))?),
    };
    let around = earlier.as_deref().map_or(Some(page::NEW), page::around).with_context(|| {
        format!("{} has no marks for the measured figures: move it away, or choose another `--out`", path.display())
    })?;
    let work = tempfile::tempdir().context("cannot create a temporary folder for the captures")?;
    let scale = if args.quick { RunSize::QUICK } else { RunSize::FULL };
    let chosen = |case: &&EffectCase| args.case.is_empty() || args.case.iter().any(|name| name == case.name);
    let mut gains = Vec::new();
    for case in CASES.iter().filter(chosen) {
        progress::note(&format!("effects: {}", case.name));
        gains.push((case, case.measure(&scale, work.path())?));
    }
    let table = page::table(&gains);
    progress::say(&table);
    let text = page::page(around, &table, &scale);
    out.write(PAGE, |file| Ok(file.write_all(text.as_bytes())?))?;
    let wrong: Vec<String> = gains.iter().filter_map(|(case, gain)| case.complaint(gain, !args.quick)).collect();
    match wrong.is_empty() {
        true => Ok(()),
        false => bail!("{}\nthe figures are in {}", wrong.join("\n"), path.display()),
    }
}

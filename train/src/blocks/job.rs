//! The lines that train blocks, for a POSIX shell.

use std::path::Path;

use anyhow::{Context, Result, bail, ensure};
use clap::Parser;
use splat_model::effects::background::Backdrop;

use crate::options::{Cli, Command};
use crate::parts::StrategyName;
use crate::train::TrainArgs;

/// Options of `splat train` that a plan replaces by its own.
pub const REPLACED: [&str; 4] = ["--effects", "--sh-degree", "--max-splats", "--test-every"];

/// Reads options of `splat train`, as they follow `--`. An error if `splat train` refuses them, or blocks cannot be trained with them.
pub fn training(capture: &Path, options: &[String]) -> Result<TrainArgs> {
    let capture = utf8(capture)?;
    let line = ["splat", "train", capture].into_iter().chain(options.iter().map(String::as_str));
    let parsed = Cli::try_parse_from(line);
    let args = match parsed.map(|cli| cli.command) {
        Ok(Command::Train(args)) => args,
        Ok(_) => bail!("the options after `--` are not those of `splat train`"),
        Err(error) => bail!("the options after `--` are for `splat train`, which refuses them: {}", error.render()),
    };
    ensure!(
        args.out.is_none() && args.start.is_none() && args.config.is_none(),
        "after `--`: the plan sets `--out` and `--start` itself, and takes no `--config`: leave them out"
    );
    ensure!(
        args.strategy != StrategyName::Mcmc,
        "after `--`: `--strategy mcmc` adds splats by opacity and not by place, so that a block would spend them on its \
         surroundings: choose another strategy"
    );
    ensure!(
        !args.background.is_some_and(|of| matches!(of.backdrop, Backdrop::Learned | Backdrop::Environment { .. })),
        "after `--`: each block would learn a background of its own, and a scene has one: choose a colour or `random`"
    );
    Ok(args)
}

/// The words without some options and their values.
pub fn without(words: &[String], options: &[&str]) -> Vec<String> {
    let mut left = Vec::new();
    let mut words = words.iter();
    while let Some(word) = words.next() {
        if options.contains(&word.as_str()) {
            words.next();
        } else if !options.iter().any(|option| word.strip_prefix(option).is_some_and(|rest| rest.starts_with('='))) {
            left.push(word.clone());
        }
    }
    left
}

/// A line of words, each quoted where the shell would change it. An error if a word has a line feed: a line is a job.
pub fn line(words: &[&str]) -> Result<String> {
    let plain = |c: char| c.is_ascii_alphanumeric() || "_./=,:@%+-".contains(c);
    let quoted = |word: &&str| {
        ensure!(!word.contains(['\n', '\r']), "{word:?} has a line feed, and each job is a line: rename the folder");
        Ok(match !word.is_empty() && word.chars().all(plain) {
            true => (*word).to_owned(),
            false => format!("'{}'", word.replace('\'', r"'\''")),
        })
    };
    Ok(words.iter().map(quoted).collect::<Result<Vec<_>>>()?.join(" "))
}

pub fn utf8(path: &Path) -> Result<&str> {
    path.to_str().with_context(|| format!("the path {} is not UTF-8: rename it", path.display()))
}

#[cfg(test)]
mod tests;

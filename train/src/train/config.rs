//! `run.toml`: the options of a run as its folder keeps them, which `--config` and `splat resume` read.
//!
//! Keys are the names of options; tables only group them. What a run decides by its capture is written as it was decided.

use std::fs;
use std::path::Path;

use anyhow::{Context, Result, anyhow, bail};
use clap::{Args, FromArgMatches};

use super::TrainArgs;

/// File of a run's options, in its output folder.
pub const CONFIG: &str = "run.toml";

/// Formats options for [`CONFIG`]. An error if an option has no place in TOML: a seed above 2⁶³.
pub fn to_toml(args: &TrainArgs) -> Result<String> {
    let options = toml::to_string(args).context("an option cannot be written as TOML")?;
    Ok(format!("# Options of `splat train`: `splat train --config {CONFIG}` trains with them again.\n{options}"))
}

/// Reads options of `splat train` from a file alone. An error if the file cannot be read or is no such file.
pub fn read(path: &Path) -> Result<TrainArgs> {
    let command = TrainArgs::augment_args(clap::Command::new("train").no_binary_name(true));
    let parsed = |words: Vec<String>| TrainArgs::from_arg_matches(&command.clone().try_get_matches_from(words)?);
    let words = words(path, &command, &parsed(Vec::new())?)?;
    parsed(words).map_err(|error| anyhow!("{}: {}", path.display(), error.render()))
}

/// Returns the options of a file as words of a command line for `train`, without those that `given` words replace. An
/// error if the file cannot be read, is no TOML, or names something that is no option.
pub fn words(path: &Path, train: &clap::Command, given: &TrainArgs) -> Result<Vec<String>> {
    let shown = path.display();
    let text = fs::read_to_string(path).with_context(|| format!("cannot read {shown}, which `--config` names"))?;
    let mut tables = vec![text.parse::<toml::Table>().with_context(|| format!("{shown} is not TOML"))?];
    let mut words = Vec::new();
    while let Some(table) = tables.pop() {
        for (key, value) in table {
            let name = key.replace('_', "-");
            let value = match value {
                toml::Value::Table(table) => {
                    tables.push(table);
                    continue;
                }
                toml::Value::String(text) => text,
                value => value.to_string(),
            };
            let option = train.get_arguments().find(|option| option.get_long() == Some(&name) && name != "config");
            match (name.as_str(), option.map(|option| option.get_action().takes_values()), value.as_str()) {
                ("capture", ..) if given.capture.is_some() => {}
                ("capture", ..) => words.push(value),
                ("steps", ..) if given.time.is_some() => {}
                ("for", ..) if given.steps.is_some() => {}
                (_, Some(true), _) => words.push(format!("--{name}={value}")),
                (_, Some(false), "true") => words.push(format!("--{name}")),
                (_, Some(false), "false") => {}
                (_, Some(false), _) => bail!("{shown}: `{key}` is {value}, expected true or false"),
                (_, None, _) => bail!(
                    "{shown}: `{key}` is no option of `splat train`: correct or remove that line (`splat train --help` lists them)"
                ),
            }
        }
    }
    Ok(words)
}

//! `splat blocks status`: how far the blocks are.

use std::path::PathBuf;

use anyhow::Result;
use serde_json::Value;

use super::planned::PlanFolder;
use crate::progress;
use crate::report::{METRICS, metrics};
use crate::train::{RunState, state_of};

/// Options of `splat blocks status`.
#[derive(Clone, Debug, clap::Args)]
pub struct StatusArgs {
    /// Folder of the plan
    #[arg(value_name = "DIR")]
    pub plan: PathBuf,
}

/// Prints a line for each block, from its output folder. An error if the folder holds no plan.
pub fn status(args: &StatusArgs) -> Result<()> {
    let folder = PlanFolder::open(&args.plan)?;
    progress::say(&format!(
        "{:<12}{:<10}{:>8}{:>10}{:>10}{:>12}",
        "block", "state", "step", "splats", "PSNR, dB", "memory, MiB"
    ));
    let mut finished = 0;
    for name in &folder.plan.blocks {
        let run = folder.run(name);
        let state = state_of(&run);
        let (word, step) = match state {
            RunState::New => ("waiting", None),
            RunState::Running(step) => ("training", Some(step)),
            RunState::Stopped(step) => ("stopped", Some(step)),
            RunState::Finished => ("finished", None),
        };
        let metrics = if state == RunState::Finished { metrics::read(&run.join(METRICS)) } else { Value::Null };
        finished += usize::from(state == RunState::Finished);
        let step = step.map(|step| step.to_string()).or_else(|| shown(&metrics["steps"], 0));
        let columns = [(step, 8), (shown(&metrics["splats"], 0), 10), (shown(&metrics["test"]["psnr"], 2), 10)];
        let mut line = format!("{name:<12}{word:<10}");
        for (text, width) in columns.into_iter().chain([(shown(&metrics["peak_rss_mib"], 0), 12)]) {
            line += &format!("{:>width$}", text.as_deref().unwrap_or("-"));
        }
        progress::say(&line);
    }
    progress::say(&format!("finished: {finished} of {}", folder.plan.blocks.len()));
    Ok(())
}

fn shown(value: &Value, digits: usize) -> Option<String> {
    value.as_f64().map(|value| format!("{value:.digits$}"))
}

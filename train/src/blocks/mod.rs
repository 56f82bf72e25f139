//! `splat blocks`: a capture in parts that are trained on their own, by any engine that runs lines of a shell.

mod job;
mod merge;
mod plan;
mod planned;
mod status;

use anyhow::Result;
use clap::{Args, Subcommand};

pub use self::merge::{MergeArgs, merge};
pub use self::plan::{PlanArgs, plan};
pub use self::status::{StatusArgs, status};

/// Options of `splat blocks`.
#[derive(Clone, Debug, Args)]
pub struct BlocksArgs {
    #[command(subcommand)]
    pub verb: BlocksCommand,
}

/// What to do with blocks.
#[derive(Clone, Debug, Subcommand)]
pub enum BlocksCommand {
    /// Cut a capture into blocks, and write a line that trains each to jobs.txt
    Plan(PlanArgs),
    /// Show which blocks wait, train, were stopped, or are finished
    Status(StatusArgs),
    /// Merge the finished blocks to one scene, and compare its renders with those of the blocks
    Merge(MergeArgs),
}

/// Runs a verb.
pub fn run(args: &BlocksArgs) -> Result<()> {
    match &args.verb {
        BlocksCommand::Plan(args) => plan(args),
        BlocksCommand::Status(args) => status(args),
        BlocksCommand::Merge(args) => merge(args),
    }
}

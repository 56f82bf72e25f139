//! One run on several processes: how they find each other, begin and end. `docs/LONG_RUNS.md` describes it for users.
//!
//! [`splat_model::trainer::ranks`] is what a run needs of them. Rank 0 reads the options, decides, writes every file and prints; the
//! others follow its orders.

mod follow;
#[cfg(feature = "mpi")]
mod mpi;

use std::rc::Rc;

use anyhow::Result;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use splat_model::capture::Capture;
use splat_model::trainer::TrainConfig;
use splat_model::trainer::ranks::{Alone, Fact, RankError, Ranks, agree, gather_all};

pub(crate) use self::follow::follow;
#[cfg(feature = "mpi")]
use self::mpi::own_rank;
use crate::train::TrainArgs;

/// What the other ranks need of rank 0 before the first step.
#[derive(Serialize, Deserialize)]
pub(crate) struct RunSetup {
    /// Options of the run, with absolute paths.
    pub args: TrainArgs,
    /// Configuration after all decisions.
    pub config: TrainConfig,
    /// Names of the effects.
    pub effects: Vec<String>,
    /// File of the checkpoint to resume from.
    pub checkpoint: Option<std::path::PathBuf>,
}

/// What the other ranks do next.
#[derive(Serialize, Deserialize)]
pub(crate) enum Order {
    /// A step, with this configuration if it has changed.
    Step(Option<Box<TrainConfig>>),
    /// There is no further step.
    End,
}

/// Returns the ranks of this process: those that `mpirun` or `srun` started together, or the process alone. An error if
/// several were started and this build has no MPI, or they do not find each other.
pub(crate) fn join() -> Result<Rc<dyn Ranks>> {
    match started_together() {
        0 | 1 => Ok(Rc::new(Alone)),
        #[cfg(feature = "mpi")]
        count => Ok(Rc::new(mpi::Mpi::join(count)?)),
        #[cfg(not(feature = "mpi"))]
        count => anyhow::bail!(
            "{count} processes were started together, and this build of `splat` has no MPI, so that each of them would train the whole run: \
             build it with `cargo install --path train --features mpi` (docs/LONG_RUNS.md), or start one process"
        ),
    }
}

/// Returns the number of processes that were started with this one, by the variables of Open MPI, MPICH (and Intel MPI), and PMIx
/// under Slurm. 0 without any.
fn started_together() -> usize {
    let number = |name| std::env::var(name).ok()?.parse().ok();
    let under_slurm = || number("SLURM_STEP_NUM_TASKS").filter(|_| std::env::var_os("PMIX_RANK").is_some());
    number("OMPI_COMM_WORLD_SIZE").or_else(|| number("PMI_SIZE")).or_else(under_slurm).unwrap_or(0)
}

/// Prints an error of this process, which names its rank if it is not the first.
pub fn say(message: &str) {
    match own_rank() {
        0 => crate::progress::error(message),
        rank => crate::progress::error(&format!("rank {rank}: {message}")),
    }
}

/// Ends all ranks after an error of this one, which it has printed. Without other ranks nothing happens.
pub fn abort(_code: u8) {
    #[cfg(feature = "mpi")]
    mpi::abort(_code);
}

/// Leaves the other ranks at the end of a program, once all have come there. Without other ranks nothing happens.
pub fn leave() {
    #[cfg(feature = "mpi")]
    mpi::leave();
}

#[cfg(not(feature = "mpi"))]
fn own_rank() -> usize {
    0
}

/// Checks that all ranks were started with the same version and options. An error on every rank, for the first difference.
pub(crate) fn agree_on_start(ranks: &dyn Ranks, options: &impl Serialize) -> Result<()> {
    if ranks.count() == 1 {
        return Ok(());
    }
    let mut facts: Vec<Fact> = vec![("the version of `splat`".into(), env!("CARGO_PKG_VERSION").into())];
    if let serde_json::Value::Object(options) = serde_json::to_value(options)? {
        facts.extend(options.into_iter().map(|(name, value)| (format!("the option `{name}`"), value.to_string())));
    }
    Ok(agree(ranks, &facts)?)
}

/// Checks that all ranks see the same files of photographs, by their sizes. An error on every rank, for the first difference.
pub(crate) fn agree_on_files(ranks: &dyn Ranks, capture: &Capture, views: &[usize]) -> Result<()> {
    if ranks.count() == 1 {
        return Ok(());
    }
    let fact = |&view: &usize| {
        let view = &capture.views[view];
        let size = std::fs::metadata(&view.image_path).map_or("missing".into(), |file| format!("{} bytes", file.len()));
        (format!("the file of photograph `{}`", view.name), size)
    };
    Ok(agree(ranks, &views.iter().map(fact).collect::<Vec<_>>())?)
}

/// Sends a value from rank 0 to all ranks, which pass none. An error if another rank is gone.
pub(crate) fn tell<T: Serialize + DeserializeOwned>(
    ranks: &dyn Ranks,
    value: Option<T>,
) -> Result<Option<T>, RankError> {
    Ok(gather_all(ranks, &value)?.swap_remove(0))
}

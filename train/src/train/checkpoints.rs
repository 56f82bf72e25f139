//! Checkpoints of a run, in the folder `checkpoints/` of its output: which there are, which are kept, and what they hold.
//!
//! Each is whole (see [`State::write`]), and the one before it is removed only when it is there. A folder belongs to one process
//! at a time.

use std::fs::{self, File, TryLockError};
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail, ensure};
use splat_model::state::State;
use splat_model::trainer::Trainer;

use super::TrainArgs;
use crate::progress;
use crate::report::METRICS;
use crate::report::history::History;

/// Their folder, below the output.
pub const FOLDER: &str = "checkpoints";

/// Where a new run puts those of an unfinished one.
const BEFORE: &str = "checkpoints-before";

/// Beside that folder while a process trains there.
const LOCK: &str = ".splat-lock";

/// How many are kept.
const KEPT: usize = 2;

/// A run as it was.
pub struct Kept {
    /// How it was started.
    pub args: TrainArgs,
    /// What [`Trainer::resume`] takes.
    pub trainer: State,
    /// What else there is to know.
    pub so_far: SoFar,
    /// Where it was read from.
    pub path: PathBuf,
}

/// What a run has come to besides its trainer.
#[derive(Clone, Debug, Default, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SoFar {
    /// Spent on training, in all parts of the run.
    pub seconds: f64,
    /// Whether the dials have been chosen, where a target asks for that.
    pub dials_chosen: bool,
    /// Its curve.
    pub history: History,
}

/// The checkpoints of the run that is on its way.
pub struct Checkpoints {
    folder: PathBuf,
    every: usize,
    /// Held while the run is.
    _lock: File,
    /// Whether the last could not be written.
    failing: bool,
}

impl Checkpoints {
    /// Of a run that writes to `out` every so many steps; 0 for when it is asked to alone.
    ///
    /// # Errors
    /// If the folder cannot be made, or another process trains there.
    pub fn open(out: &Path, every: usize) -> Result<Self> {
        let folder = out.join(FOLDER);
        let cannot =
            || format!("cannot write to {}: mend its permissions, or choose another `--out`", folder.display());
        fs::create_dir_all(&folder).with_context(cannot)?;
        // Beside the checkpoints, whose folder may be renamed.
        let lock = File::create(out.join(LOCK)).with_context(cannot)?;
        match lock.try_lock() {
            Err(TryLockError::WouldBlock) => {
                bail!("another `splat train` is writing to {}: wait for it, or choose another `--out`", out.display())
            }
            // There are file systems without locks.
            Ok(()) | Err(TryLockError::Error(_)) => {}
        }
        Ok(Self { folder, every, _lock: lock, failing: false })
    }

    /// Makes room for a new run; those of an unfinished one are put aside.
    ///
    /// # Errors
    /// If they cannot be moved.
    pub fn begin(&self) -> Result<()> {
        let Some((step, _)) = steps_in(&self.folder).pop() else { return Ok(()) };
        let before = self.folder.with_file_name(BEFORE);
        let shown = self.folder.display();
        let cannot = || format!("cannot move {shown} away: mend its permissions, or choose another `--out`");
        if step > 0 {
            if before.exists() {
                fs::remove_dir_all(&before).with_context(cannot)?;
            }
            fs::rename(&self.folder, &before).with_context(cannot)?;
            progress::note(&format!(
                "an unfinished run was here, at step {step}; its checkpoints are in {} now: to go on with it, put them into \
                 `{FOLDER}` below another folder and `splat resume` that",
                before.display()
            ));
        } else {
            fs::remove_dir_all(&self.folder).with_context(cannot)?;
        }
        fs::create_dir_all(&self.folder).with_context(cannot)
    }

    /// Whether one is to be written after `step`.
    pub fn due_after(&self, step: usize) -> bool {
        self.every > 0 && step.is_multiple_of(self.every)
    }

    /// Writes one, and removes what is older than the one before it.
    ///
    /// # Errors
    /// If it cannot be written; the others are as they were.
    pub fn write(&self, trainer: &mut Trainer, args: &TrainArgs, so_far: &SoFar) -> Result<PathBuf> {
        let mut state = State::default();
        state.tell("version", &env!("CARGO_PKG_VERSION"))?;
        state.tell("args", args)?;
        state.tell("so_far", so_far)?;
        state.put_part("trainer", trainer.save()?);
        let path = self.folder.join(name_of(trainer.steps_done()));
        state.write(&path)?;
        let mut steps = steps_in(&self.folder);
        steps.truncate(steps.len().saturating_sub(KEPT));
        for (_, old) in steps {
            // It takes room, and that is all.
            let _ = fs::remove_file(old);
        }
        Ok(path)
    }

    /// The same on the way: one that cannot be written is said once, and ends no run.
    pub fn try_write(&mut self, trainer: &mut Trainer, args: &TrainArgs, so_far: &SoFar) {
        let written = self.write(trainer, args, so_far);
        if let (Err(error), false) = (&written, self.failing) {
            let older = steps_in(&self.folder).pop().map_or(0, |(step, _)| step);
            progress::note(&format!("no checkpoint could be written, the last is of step {older}: {error:#}"));
        }
        self.failing = written.is_err();
    }

    /// Removes them, after the run has left its results. The last one goes last.
    pub fn finish(self) {
        // Left over, they do no harm.
        let _ = fs::remove_file(self.folder.with_file_name(LOCK));
        for (_, path) in steps_in(&self.folder) {
            let _ = fs::remove_file(path);
        }
        let _ = fs::remove_dir_all(&self.folder);
    }
}

/// The newest checkpoint of the run that wrote to `out`.
///
/// # Errors
/// If there is none, or it cannot be read, is damaged, or of another version.
pub fn newest(out: &Path) -> Result<Kept> {
    let shown = out.display();
    ensure!(out.is_dir(), "{shown} is no folder: give the `--out` of the run to go on with");
    let folder = out.join(FOLDER);
    let mut steps = steps_in(&folder);
    let Some((_, path)) = steps.pop() else {
        if out.join(METRICS).is_file() {
            bail!("the run in {shown} is finished: there is nothing to go on with");
        }
        let before = folder.with_file_name(BEFORE);
        let before = steps_in(&before).pop().map(|_| format!(", or rename {} to `{FOLDER}`", before.display()));
        bail!(
            "there is no checkpoint in {}: start the run with `splat train CAPTURE --out {shown}`{}",
            folder.display(),
            before.unwrap_or_default()
        );
    };
    read(&path).with_context(|| {
        let older =
            steps.pop().map(|(step, _)| format!("; without that file, `splat resume` goes on from step {step}"));
        format!("cannot go on from {}{}", path.display(), older.unwrap_or_default())
    })
}

fn read(path: &Path) -> Result<Kept> {
    let mut state = State::read(path)?;
    let (version, own): (String, _) = (state.told("version")?, env!("CARGO_PKG_VERSION"));
    ensure!(version == own, "it was written by splat {version}, and this is splat {own}: go on with that version");
    let (args, so_far) = (state.told("args")?, state.told("so_far")?);
    let trainer = state.take_part("trainer");
    state.finish()?;
    Ok(Kept { args, trainer, so_far, path: path.to_owned() })
}

fn name_of(step: usize) -> String {
    format!("step-{step:08}.safetensors")
}

/// Steps and files, in ascending order; none where there is no such folder.
fn steps_in(folder: &Path) -> Vec<(usize, PathBuf)> {
    let step = |path: PathBuf| {
        let name = path.file_name()?.to_str()?;
        let step = name.strip_prefix("step-")?.strip_suffix(".safetensors")?.parse().ok()?;
        (name == name_of(step)).then_some((step, path))
    };
    let paths = fs::read_dir(folder).into_iter().flatten().flatten().map(|entry| entry.path());
    let mut steps: Vec<(usize, PathBuf)> = paths.filter_map(step).collect();
    steps.sort_unstable();
    steps
}

//! Checkpoints of a run, in the folder `checkpoints/` of its output.
//!
//! Each is written completely (see [`State::write`]) before an older one is removed. A folder belongs to one process at a time.

use std::fs::{self, File, TryLockError};
use std::path::{Path, PathBuf};
use std::thread;
use std::time::Duration;

use anyhow::{Context, Result, bail, ensure};
use splat_model::replace::name_of_temporary;
use splat_model::state::State;
use splat_model::trainer::Trainer;

use super::TrainArgs;
use crate::progress;
use crate::report::{History, METRICS};

pub const FOLDER: &str = "checkpoints";

/// Lock file, beside that folder while a process trains there.
const LOCK: &str = ".splat-lock";

/// Number of checkpoints that are kept.
const KEPT: usize = 2;

pub struct SavedRun {
    pub args: TrainArgs,
    /// Input of [`Trainer::resume`].
    pub trainer: State,
    /// Progress besides the trainer.
    pub so_far: SoFar,
    pub path: PathBuf,
}

/// Progress of a run besides its trainer.
#[derive(Clone, Debug, Default, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SoFar {
    /// Training time of all parts of the run, s.
    pub seconds: f64,
    /// Number of steps, if a time limit chose it.
    #[serde(default)]
    pub steps: Option<usize>,
    pub history: History,
}

/// How far the run of a folder is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RunState {
    /// There is no run, or none that has a checkpoint.
    New,
    /// A process trains; its last checkpoint is of this step, counted from 1, or 0 before the first.
    Running(usize),
    /// It can be resumed from this step.
    Stopped(usize),
    /// Its results are complete.
    Finished,
}

/// Returns how far the run is that writes to `out`.
pub fn state_of(out: &Path) -> RunState {
    let newest = steps_in(&out.join(FOLDER)).pop().map(|(step, _)| step);
    let locked = || {
        let lock = File::open(out.join(LOCK)).ok()?;
        Some(matches!(lock.try_lock(), Err(TryLockError::WouldBlock)))
    };
    match newest {
        _ if locked() == Some(true) => RunState::Running(newest.unwrap_or(0)),
        Some(step) => RunState::Stopped(step),
        None if out.join(METRICS).is_file() => RunState::Finished,
        None => RunState::New,
    }
}

/// Checkpoints of a run in progress.
pub struct Checkpoints {
    folder: PathBuf,
    /// Held as long as the run lasts.
    _lock: File,
    /// Whether the last checkpoint could not be written.
    failing: bool,
}

impl Checkpoints {
    /// Opens the checkpoints of a run that writes to `out`.
    pub fn open(out: &Path) -> Result<Self> {
        let folder = out.join(FOLDER);
        let cannot = || format!("cannot write to {}: fix its permissions, or choose another `--out`", folder.display());
        fs::create_dir_all(&folder).with_context(cannot)?;
        // Beside the checkpoints, whose folder is removed at the end.
        let lock =
            File::options().create(true).truncate(false).write(true).open(out.join(LOCK)).with_context(cannot)?;
        match locked(&lock) {
            Err(TryLockError::WouldBlock) => {
                bail!("another `splat train` is writing to {}: wait for it, or choose another `--out`", out.display())
            }
            // Some file systems have no locks.
            Ok(()) | Err(TryLockError::Error(_)) => {}
        }
        // A run that has just ended here has removed it.
        fs::create_dir_all(&folder).with_context(cannot)?;
        // What killed processes were writing.
        for entry in fs::read_dir(&folder).into_iter().flatten().flatten() {
            let name = entry.file_name();
            let is_left = |name: &str| name_of_temporary(name).and_then(step_of).is_some() || is_of_safetensors(name);
            if name.to_str().is_some_and(is_left) {
                // A leftover file only takes up space.
                let _ = fs::remove_file(entry.path());
            }
        }
        Ok(Self { folder, _lock: lock, failing: false })
    }

    /// Clears the folder of checkpoints for a new run, whose only one can be that before the first step of a run which was killed then. All
    /// other files stay. An error if an unfinished run is there, or a file of another program with the name of a checkpoint.
    pub fn begin(&self) -> Result<()> {
        let steps = steps_in(&self.folder);
        if let Some((_, path)) = steps.iter().find(|(_, path)| !State::is_in(path)) {
            bail!(
                "{} has the name of a checkpoint and is none of this program: move it away, or choose another `--out`",
                path.display()
            );
        }
        let folder = self.folder.display();
        match steps.last() {
            Some(&(step, _)) if step > 0 => bail!(
                "{folder} holds an unfinished run, at step {step}: continue it with `splat resume`, move the folder away, or choose another \
                 `--out`"
            ),
            _ => {
                let removed = steps.iter().try_for_each(|(_, path)| fs::remove_file(path));
                removed.with_context(|| format!("cannot write to {folder}: choose another `--out`"))
            }
        }
    }

    /// Writes a checkpoint, and removes all that are older than its predecessor. An error if it cannot be written; the
    /// others are unchanged then.
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
        remove(steps);
        Ok(path)
    }

    /// Writes a checkpoint during a run. A failure is noted once and does not end the run.
    pub fn try_write(&mut self, trainer: &mut Trainer, args: &TrainArgs, so_far: &SoFar) {
        let written = self.write(trainer, args, so_far);
        if let (Err(error), false) = (&written, self.failing) {
            let older = steps_in(&self.folder).pop().map_or(0, |(step, _)| step);
            progress::note(&format!("no checkpoint could be written, the last is of step {older}: {error:#}"));
        }
        self.failing = written.is_err();
    }

    /// Removes all checkpoints in step order, after the run has written its results, and the folder unless something else is in it.
    pub fn finish(self) {
        let lock = self.folder.with_file_name(LOCK);
        if fs::metadata(&lock).is_ok_and(|lock| lock.len() == 0) {
            // A leftover file does no harm.
            let _ = fs::remove_file(lock);
        }
        remove(steps_in(&self.folder));
        // Fails where other files are.
        let _ = fs::remove_dir(&self.folder);
    }
}

/// Removes checkpoints; a file of such a name that is none stays.
fn remove(steps: Vec<(usize, PathBuf)>) {
    for (_, path) in steps.into_iter().filter(|(_, path)| State::is_in(path)) {
        // A leftover file only takes up space.
        let _ = fs::remove_file(path);
    }
}

/// Locks a file. [`state_of`] holds the lock for a moment, which is no run.
fn locked(lock: &File) -> Result<(), TryLockError> {
    for _ in 0..10 {
        match lock.try_lock() {
            Err(TryLockError::WouldBlock) => thread::sleep(Duration::from_millis(20)),
            other => return other,
        }
    }
    lock.try_lock()
}

/// Reads the newest checkpoint of the run that wrote to `out`. An error if there is none, or it cannot be read, is
/// damaged, or was written by another version.
pub fn newest(out: &Path) -> Result<SavedRun> {
    let shown = out.display();
    ensure!(out.is_dir(), "{shown} is not a folder: give the `--out` of the run to resume");
    let folder = out.join(FOLDER);
    let mut steps = steps_in(&folder);
    let Some((_, path)) = steps.pop() else {
        if out.join(METRICS).is_file() {
            bail!("the run in {shown} is finished: there is nothing to resume");
        }
        bail!("there is no checkpoint in {}: start the run with `splat train CAPTURE --out {shown}`", folder.display());
    };
    read(&path).with_context(|| {
        let older =
            steps.pop().map(|(step, _)| format!("; without that file, `splat resume` continues from step {step}"));
        format!("cannot resume from {}{}", path.display(), older.unwrap_or_default())
    })
}

pub fn read(path: &Path) -> Result<SavedRun> {
    let mut state = State::read(path)?;
    let (version, own): (String, _) = (state.told("version")?, env!("CARGO_PKG_VERSION"));
    ensure!(version == own, "it was written by splat {version}, and this is splat {own}: resume with that version");
    let (args, so_far) = (state.told("args")?, state.told("so_far")?);
    let trainer = state.take_part("trainer");
    state.finish()?;
    Ok(SavedRun { args, trainer, so_far, path: path.to_owned() })
}

/// Whether the crate `safetensors` gives such a name to a file that it has not completed.
fn is_of_safetensors(name: &str) -> bool {
    let is_random = |random: &str| random.len() == 6 && random.chars().all(|c| c.is_ascii_alphanumeric());
    name.strip_prefix(".tmp").is_some_and(is_random)
}

fn name_of(step: usize) -> String {
    format!("step-{step:08}.safetensors")
}

fn step_of(name: &str) -> Option<usize> {
    let step = name.strip_prefix("step-")?.strip_suffix(".safetensors")?.parse().ok()?;
    (name == name_of(step)).then_some(step)
}

/// Lists steps and files in ascending order; empty if the folder does not exist.
fn steps_in(folder: &Path) -> Vec<(usize, PathBuf)> {
    let step = |path: PathBuf| Some((step_of(path.file_name()?.to_str()?)?, path));
    let paths = fs::read_dir(folder).into_iter().flatten().flatten().map(|entry| entry.path());
    let mut steps: Vec<(usize, PathBuf)> = paths.filter_map(step).collect();
    steps.sort_unstable();
    steps
}

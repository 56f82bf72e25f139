//! A run, from its options or its last checkpoint to its results.

use std::io::Write;
use std::rc::Rc;

use anyhow::{Context, Result};
use splat_model::capture::Photograph;
use splat_model::gaussians::{BASE_GROUPS, Group};
use splat_model::trainer::Trainer;
use splat_model::trainer::ranks::{Alone, Ranks};

use super::budget::{self, MemoryEstimate};
use super::checkpoints::{self, Checkpoints, RunState, SavedRun, SoFar};
use super::config::{self, CONFIG};
use super::setup::Setup;
use super::{ResumeArgs, TrainArgs};
use crate::progress;
use crate::ranks::{self, RunSetup};
use crate::report::{LogLine, Metrics, seconds_since};
use crate::view::Server;

/// Trains, measures, writes all files, and prints their location. An error if the capture cannot be read, the results
/// cannot be written, or an option is out of range; or if a loss or a gradient is not finite: `scene.ply` is the scene
/// before that step then. [`Interrupted`](super::Interrupted) if Ctrl-C or SIGTERM ended it.
pub fn run(args: &TrainArgs) -> Result<Metrics> {
    run_with(args, |trainer| trainer)
}

/// Runs as [`run`] does, with the trainer changed before its first step. For tests, which make the run fail.
#[doc(hidden)]
pub fn run_with(args: &TrainArgs, change: impl FnOnce(Trainer) -> Trainer) -> Result<Metrics> {
    Run::begin(args.clone(), None, Rc::new(Alone), change)?.finish()
}

/// Runs as [`run`] does, on all ranks that were started together. An error as for [`run`], and if the ranks differ in version or options.
pub fn run_together(args: &TrainArgs) -> Result<()> {
    let ranks = ranks::join()?;
    ranks::agree_on_start(&*ranks, args)?;
    if ranks.rank() > 0 {
        return ranks::follow(&ranks);
    }
    Run::begin(args.clone(), None, ranks, |trainer| trainer)?.finish().map(drop)
}

/// Resumes a run from its newest checkpoint, with its original options, on all ranks that were started together. A run of which there is
/// nothing but its options begins, and a finished one is left alone, so that the same line can be run again and again.
/// An error if no checkpoint can be resumed from or the ranks differ in version or options, and as for [`run`].
pub fn resume_together(args: &ResumeArgs) -> Result<()> {
    let ranks = ranks::join()?;
    ranks::agree_on_start(&*ranks, args)?;
    if ranks.rank() > 0 {
        return ranks::follow(&ranks);
    }
    let options = args.out.join(CONFIG);
    let (begun, kept) = match checkpoints::state_of(&args.out) {
        RunState::Finished => {
            progress::note(&format!("the run in {} is finished", args.out.display()));
            ranks::tell::<Option<RunSetup>>(&*ranks, Some(None))?;
            return Ok(());
        }
        RunState::New if options.is_file() => (config::read(&options)?, None),
        // A run that is under way is refused by its lock.
        _ => {
            let kept = checkpoints::newest(&args.out)?;
            (kept.args.clone(), Some(kept))
        }
    };
    let (out, voice, live) = (Some(args.out.clone()), args.voice, args.live.clone());
    Run::begin(TrainArgs { out, voice, live, ..begun }, kept, ranks, |trainer| trainer)?.finish().map(drop)
}

/// A run before its next step.
pub struct Run {
    pub setup: Setup,
    pub trainer: Trainer,
    pub test: Vec<Photograph>,
    pub checkpoints: Checkpoints,
    pub so_far: SoFar,
    /// Server of the view in the browser, if asked for.
    pub server: Option<Server>,
    pub ranks: Rc<dyn Ranks>,
    /// Time that reading took, s.
    pub load_s: f64,
}

impl Run {
    /// Reads everything, decides on everything, and begins the files of the run.
    fn begin(
        args: TrainArgs,
        kept: Option<SavedRun>,
        ranks: Rc<dyn Ranks>,
        change: impl FnOnce(Trainer) -> Trainer,
    ) -> Result<Self> {
        let mut config = args.config()?;
        // An unavailable port is found before the capture is read.
        let bind = |(host, port): &(String, u16)| Server::bind(host, *port, "--live=[HOST:]PORT");
        let server = args.live.live.as_ref().map(bind).transpose()?;
        if let Some(steps) = kept.as_ref().and_then(|kept| kept.so_far.steps) {
            config = args.schedule(config, steps);
        }
        let setup = Setup::new(args, config, kept.is_none())?;
        let (job, out) = (&setup.job, &setup.out);
        if ranks.count() > 1 {
            setup.tell(&*ranks, kept.as_ref().map(|kept| &*kept.path))?;
        }
        let available = budget::available();
        let (train, test) = job.photographs(&setup.train, &setup.test, &*ranks)?;
        let (train_views, test_views) = (train.len(), test.len());
        let (folder, points) = (job.capture.folder.display(), job.capture.points.positions.len());
        progress::note(&format!(
            "{folder}: {train_views} photographs to train on, {test_views} to test on, {points} points"
        ));
        let most = job.config.density.max_splats();
        let estimate = MemoryEstimate::of(&train, &test, &job.config, most);
        let mut trainer = change(job.trainer(train, kept.is_none(), &ranks)?);
        let own = trainer.gaussians().groups()[BASE_GROUPS.len()..].iter().map(Group::width);
        progress::note(&estimate.with_groups(own, &job.config, most).said(most, available));
        let load_s = seconds_since(setup.start);

        // All errors in the capture have been found by now: a run that does not begin leaves no files.
        let checkpoints = Checkpoints::open(out.path())?;
        if kept.is_none() {
            checkpoints.begin()?;
        }
        out.sweep();
        // Without the file a run is as good.
        let kept_options = config::to_toml(&setup.resolved())
            .and_then(|text| out.write(CONFIG, |file| Ok(file.write_all(text.as_bytes())?)));
        if let Err(error) = kept_options {
            progress::note(&format!("{CONFIG} was not written: {error:#}"));
        }
        let so_far = continued(kept, &mut trainer)?;
        progress::line(&LogLine::Start {
            steps: job.config.steps,
            train_views,
            test_views,
            splats: trainer.gaussians().len(),
            device: &setup.device_name,
            version: env!("CARGO_PKG_VERSION"),
        });
        Ok(Self { setup, trainer, test, checkpoints, so_far, server, ranks, load_s })
    }
}

/// Brings the trainer to where the run goes on, and returns its progress.
fn continued(kept: Option<SavedRun>, trainer: &mut Trainer) -> Result<SoFar> {
    let Some(kept) = kept else { return Ok(SoFar::default()) };
    trainer.resume(kept.trainer).with_context(|| format!("cannot resume from {}", kept.path.display()))?;
    progress::note(&format!("resuming from step {} of {}", trainer.steps_done(), trainer.config().steps));
    Ok(kept.so_far)
}

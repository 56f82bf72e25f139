//! A run before its first step: where it reads, what it decides, and where it writes.

use std::ffi::OsStr;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Instant;

use anyhow::{Result, ensure};
use splat_demo::DemoOptions;
use splat_model::capture::Capture;
use splat_model::density::Focus;
use splat_model::metrics::lpips::Lpips;
use splat_model::trainer::TrainConfig;
use splat_model::trainer::ranks::Ranks;

use super::config::CONFIG;
use super::job::Job;
use super::{TrainArgs, checkpoints};
use crate::background::BACKGROUND;
use crate::input::PhotoArgs;
use crate::inputs::Inputs;
use crate::output::{self, OUT, OutputFolder};
use crate::ranks::{self, RunSetup};
use crate::report::{self, METRICS, POSES, REPORT, SCENE, VIEWS};
use crate::{demo, input, progress, reconstruct};

/// Folder of the demo capture, below the output folder.
const DEMO_CAPTURE: &str = "demo-capture";

/// A run that is decided on, of the rank that writes.
pub struct Setup {
    pub job: Job,
    /// Views to train on, and views to test on.
    pub train: Vec<usize>,
    pub test: Vec<usize>,
    /// The options on photographs, as they are reported.
    pub photos: PhotoArgs,
    pub out: OutputFolder,
    pub device_name: String,
    pub lpips: Option<Lpips>,
    /// Begin of reading the capture.
    pub start: Instant,
}

impl Setup {
    /// Reads the capture, prepares the output folder and decides on everything else.
    pub fn new(mut args: TrainArgs, mut config: TrainConfig, is_new: bool) -> Result<Self> {
        let (device, device_name) = args.device.resolve()?;
        let lpips = args.lpips.read(&device)?;
        let (out, mut capture, start) = open(&args)?;
        let mut inputs = Inputs::of(&args.capture).and_capture(&capture).and(&args.config).and(&args.lpips.lpips);
        // A resumed run has its own scene and does not read that of `--start`.
        if let Some(scene) = args.start.as_ref().filter(|_| is_new) {
            inputs = inputs.and([scene]);
        }
        // A run may be resumed from any working directory, and a video does not tell which folder its frames are in.
        if let Some(source) = args.capture.take() {
            args.cameras = args.cameras.from_anywhere();
            let found = if input::lacks_cameras(&source) { &capture.folder } else { &source };
            args.capture = Some(std::path::absolute(found)?);
        }
        args.lpips.lpips = args.lpips.lpips.map(std::path::absolute).transpose()?;
        args.start = args.start.map(std::path::absolute).transpose()?;
        let (split, photos) = args.photos.split(&capture);
        let train = split.require_train()?.to_vec();
        // `--test-every 0` asks for no test; any other number that holds out no photograph is a mistake.
        let test = if photos.test_every == Some(0) { Vec::new() } else { split.require_test()?.to_vec() };
        ensure!(
            args.eval_during.unwrap_or(0) == 0 || !test.is_empty(),
            "`--eval-during` scores test views, and `--test-every 0` holds out none: leave out one of them"
        );
        ensure!(
            lpips.is_none() || !test.is_empty(),
            "`--lpips` is measured on test views, and `--test-every 0` holds out none: leave out one of them"
        );
        let views = report::view_files(test.iter().map(|&view| capture.views[view].name.as_str()));
        let files = [CONFIG, SCENE, METRICS, REPORT, BACKGROUND, POSES].map(PathBuf::from).into_iter().chain(views);
        let out = OutputFolder::prepare(&out, inputs, files, &[VIEWS, checkpoints::FOLDER])?;
        args.cameras.scale(&mut capture)?;

        let effects = args.effects.choose(&capture, &train, args.model.antialias.unwrap_or_default())?;
        effects.configure(&mut config, args.background, args.sh_degree);
        config.density = config.density.focused(capture.focus.map(Focus::on));
        let job = Job { args, config, capture: Arc::new(capture), effects, device };
        Ok(Self { job, train, test, photos, out, device_name, lpips, start })
    }

    /// Tells the other ranks what is decided, and the checkpoint to resume from.
    pub fn tell(&self, ranks: &dyn Ranks, checkpoint: Option<&Path>) -> Result<()> {
        let Job { args, config, capture, effects, .. } = &self.job;
        let mut args = args.clone();
        if args.capture.is_none() {
            args.capture = Some(std::path::absolute(&capture.folder)?);
        }
        let effects = effects.on.iter().map(|effect| effect.name().to_owned()).collect();
        let checkpoint = checkpoint.map(std::path::absolute).transpose()?;
        ranks::tell(ranks, Some(Some(RunSetup { args, config: config.clone(), effects, checkpoint })))?;
        ranks::agree_on_files(ranks, capture, &self.train)
    }

    /// The options with which the run can be done again: what was decided by the capture is as it was decided.
    pub fn resolved(&self) -> TrainArgs {
        let Job { args, config, effects, .. } = &self.job;
        TrainArgs {
            steps: args.time.is_none().then_some(config.steps),
            sh_degree: Some(config.sh_degree),
            effects: effects.asked_again(),
            ..args.clone()
        }
    }
}

/// Chooses the output folder and reads the capture, after making the demo capture if none was given. Returns the time at which reading began
/// too.
fn open(args: &TrainArgs) -> Result<(PathBuf, Capture, Instant)> {
    let out = || args.out.clone().unwrap_or_else(|| own_folder(args.capture.as_deref()));
    match &args.capture {
        Some(source) if input::lacks_cameras(source) => {
            let folder = match &args.out {
                Some(out) => out.join(reconstruct::FOLDER),
                None => reconstruct::own_folder(source),
            };
            let capture = reconstruct::reconstruct(source, &folder, &args.cameras)?;
            Ok((out(), capture, Instant::now()))
        }
        Some(folder) => {
            args.cameras.check_for_capture(folder)?;
            let start = Instant::now();
            let capture = input::capture(folder)?;
            Ok((out(), capture, start))
        }
        None => {
            let out = out();
            // Before the demo capture is made.
            OutputFolder::prepare(&out, Inputs::default(), [""; 0], &[])?;
            let folder = out.join(DEMO_CAPTURE);
            demo::ensure(&folder, &DemoOptions::default())?;
            let start = Instant::now();
            Ok((out, input::capture(&folder)?, start))
        }
    }
}

/// Returns the default output folder: an empty one with the name of the capture, so that no run replaces the results of another.
fn own_folder(capture: Option<&Path>) -> PathBuf {
    let (name, may_hold) = match capture {
        None => ("demo".into(), &[DEMO_CAPTURE][..]),
        Some(source) => (reconstruct::name_of(source), &[][..]),
    };
    let name = OsStr::new(&name);
    let (first, free) = (Path::new(OUT).join(name), output::free_folder(Path::new(OUT), name, may_hold));
    let (shown, taken) = (free.display(), first.display());
    progress::note(&match free == first {
        true => format!("writing to {shown}"),
        false => format!("{taken} is not empty and is kept: writing to {shown} (`--out` names another folder)"),
    });
    free
}

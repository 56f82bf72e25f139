//! Where a run reads and where it writes.

use std::ffi::OsStr;
use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::Result;
use splat_demo::DemoOptions;
use splat_model::capture::{Capture, Split};

use super::{OUT, TrainArgs, checkpoints};
use crate::inputs::Inputs;
use crate::options::PhotoArgs;
use crate::output::{self, OutputFolder};
use crate::report::{self, BACKGROUND, METRICS, POSES, REPORT, SCENE, VIEWS};
use crate::{demo, input, progress, reconstruct, snapshots};

/// Folder of the demo capture, below the output folder.
const DEMO_CAPTURE: &str = "demo-capture";

/// Chooses the output folder and reads the capture, after making the demo capture if none was given.
pub fn open(args: &TrainArgs) -> Result<(PathBuf, Capture, Instant)> {
    let out = || args.out.clone().unwrap_or_else(|| own_folder(args.capture.as_deref()));
    match &args.capture {
        Some(source) if reconstruct::is_needed(source) => {
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

/// Everything that a run reads: `source` as it was named, the capture, and the files of options. A resumed run has its own scene and does
/// not read that of `--start`.
pub fn inputs_of(source: Inputs, args: &TrainArgs, capture: &Capture, begins: bool) -> Inputs {
    let inputs = source.and_capture(capture).and(&args.lpips.lpips);
    args.start.iter().filter(|_| begins).fold(inputs, |inputs, scene| inputs.and_scene(scene))
}

/// Prepares the output folder for all files of a run.
pub fn prepare(
    out: &Path,
    inputs: Inputs,
    (capture, split, photos): (&Capture, &Split, &PhotoArgs),
) -> Result<OutputFolder> {
    let test = if photos.eval_every == Some(0) { &[][..] } else { &split.test };
    let views = report::view_files(test.iter().map(|&view| capture.views[view].name.as_str()));
    let files = [SCENE, METRICS, REPORT, BACKGROUND, POSES].map(PathBuf::from).into_iter().chain(views);
    OutputFolder::prepare(out, inputs, files, &[VIEWS, checkpoints::FOLDER, snapshots::FOLDER])
}

/// Returns the default output folder: an empty one with the name of the capture, so that no run replaces the results of
/// another.
fn own_folder(capture: Option<&Path>) -> PathBuf {
    let (name, may_hold) = match capture {
        None => ("demo".into(), &[DEMO_CAPTURE][..]),
        Some(source) => (reconstruct::name_of(source), &[][..]),
    };
    let name = OsStr::new(&name);
    let (first, free) = (Path::new(OUT).join(name), output::free_folder(Path::new(OUT), name, may_hold));
    match free == first {
        true => progress::note(&format!("writing to {}", free.display())),
        false => progress::note(&format!(
            "{} is not empty and is kept: writing to {} (`--out` names another folder)",
            first.display(),
            free.display()
        )),
    }
    free
}

//! `splat demo`: the demo capture.

use std::fs;
use std::path::{Path, PathBuf};
use std::process;

use anyhow::{Context, Result, bail};
use serde_json::{Value, json};
use splat_model::capture::Capture;
use splat_model::capture::demo::{self, DemoOptions};

use crate::{output, progress};

/// Marks a folder as a demo capture and says what it was made from.
pub const MARK: &str = "demo.json";

/// The folders of a capture, in the order in which they are put in place: a model stands only beside its pictures.
const FOLDERS: [&str; 2] = ["images", "sparse"];

/// Options of `splat demo`.
#[derive(Clone, Debug, clap::Args)]
pub struct DemoArgs {
    /// The folder to write
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// Make one object mirror its surroundings
    #[arg(long)]
    pub glossy: bool,
    /// Give each photograph its own exposure and white balance
    #[arg(long)]
    pub exposure: bool,
    /// Number of photographs
    #[arg(long, value_name = "N", default_value_t = DemoOptions::default().views)]
    pub views: usize,
    /// Width of the photographs, px
    #[arg(long, value_name = "PX", default_value_t = DemoOptions::default().width)]
    pub width: usize,
    /// Height of the photographs, px
    #[arg(long, value_name = "PX", default_value_t = DemoOptions::default().height)]
    pub height: usize,
    /// Varies the cameras and the choice of sparse points
    #[arg(long, value_name = "S", default_value_t = DemoOptions::default().seed)]
    pub seed: u64,
}

impl DemoArgs {
    /// As the library takes them.
    pub fn options(&self) -> DemoOptions {
        DemoOptions {
            width: self.width,
            height: self.height,
            views: self.views,
            glossy: self.glossy,
            exposure: self.exposure,
            seed: self.seed,
            ..DemoOptions::default()
        }
    }
}

/// Writes the capture and says where it is.
///
/// # Errors
/// Those of [`ensure`].
pub fn run(args: &DemoArgs) -> Result<()> {
    let made = ensure(&args.out, &args.options())?;
    let what = if made { "demo capture" } else { "demo capture, unchanged" };
    progress::say(&format!("{what}: {}", args.out.display()));
    Ok(())
}

/// Writes the demo capture into `folder`, unless the same one is already there and complete; says whether it wrote.
///
/// Everything is made in a hidden folder first, so that what stands under its own name is complete; if the process is
/// killed meanwhile, the hidden folder stays.
///
/// # Errors
/// If an option is out of range, the folder holds some other capture, or it cannot be written.
pub fn ensure(folder: &Path, options: &DemoOptions) -> Result<bool> {
    let mark = mark(options);
    let found = read_mark(folder);
    if found.as_ref() == Some(&mark) && is_complete(folder, options) {
        return Ok(false);
    }
    if found.is_none() {
        refuse_foreign(folder)?;
    }
    progress::note("making the demo capture");
    let temporary = folder.join(format!(".demo.tmp-{}", process::id()));
    let made =
        demo::write(&temporary, options).map_err(Into::into).and_then(|()| put_in_place(folder, &temporary, &mark));
    // Best effort: empty if all went well, and else the first error is the one to report.
    let _ = fs::remove_dir_all(&temporary);
    let shown = folder.display();
    made.with_context(|| {
        format!("cannot make the demo capture in {shown}: mend what is named below, or choose another `--out`")
    })?;
    Ok(true)
}

/// The model goes first and comes last, so that the capture is never complete to look at while pictures are exchanged.
fn put_in_place(folder: &Path, temporary: &Path, mark: &Value) -> Result<()> {
    for name in FOLDERS.iter().rev().map(|name| folder.join(name)).filter(|name| name.exists()) {
        fs::remove_dir_all(&name).with_context(|| format!("cannot replace {}", name.display()))?;
    }
    output::write(&folder.join(MARK), |file| Ok(serde_json::to_writer_pretty(file, mark)?))?;
    for name in FOLDERS {
        let target = folder.join(name);
        fs::rename(temporary.join(name), &target).with_context(|| format!("cannot write {}", target.display()))?;
    }
    Ok(())
}

/// What the capture depends on.
fn mark(options: &DemoOptions) -> Value {
    let DemoOptions { width, height, views, points, glossy, exposure, seed } = *options;
    let version = env!("CARGO_PKG_VERSION");
    json!({
        "splat demo": version, "width": width, "height": height, "views": views, "points": points, "glossy": glossy,
        "exposure": exposure, "seed": seed,
    })
}

/// The mark of a demo capture in `folder`. None also for a file that is no JSON: then it is not ours.
pub fn read_mark(folder: &Path) -> Option<Value> {
    let value: Value = serde_json::from_slice(&fs::read(folder.join(MARK)).ok()?).ok()?;
    value.get("splat demo").is_some().then_some(value)
}

fn is_complete(folder: &Path, options: &DemoOptions) -> bool {
    let complete = |capture: Capture| {
        capture.views.len() == options.views && capture.views.iter().all(|view| view.image_path.is_file())
    };
    Capture::load(folder).is_ok_and(complete)
}

/// A capture that somebody photographed is not to be replaced by a demo.
fn refuse_foreign(folder: &Path) -> Result<()> {
    match FOLDERS.iter().chain([&MARK]).map(|name| folder.join(name)).find(|name| name.exists()) {
        None => Ok(()),
        Some(taken) => bail!(
            "{} is there already and belongs to no demo capture: choose another folder with `--out`, or move it away",
            taken.display()
        ),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SMALL: DemoOptions =
        DemoOptions { width: 16, height: 16, views: 2, points: 10, glossy: false, exposure: false, seed: 0 };

    #[test]
    fn a_complete_capture_is_reused_and_another_replaced() {
        let folder = tempfile::tempdir().unwrap();
        let folder = folder.path().join("demo");
        assert!(ensure(&folder, &SMALL).unwrap());
        assert!(!ensure(&folder, &SMALL).unwrap());
        fs::remove_file(folder.join("images/0001.png")).unwrap();
        assert!(ensure(&folder, &SMALL).unwrap(), "a picture is missing");
        fs::remove_dir_all(folder.join("sparse")).unwrap();
        assert!(ensure(&folder, &SMALL).unwrap(), "interrupted before the model was in place");
        assert!(ensure(&folder, &DemoOptions { views: 3, ..SMALL }).unwrap(), "another demo");
        assert_eq!(Capture::load(&folder).unwrap().views.len(), 3);
        let mut names: Vec<_> = fs::read_dir(&folder).unwrap().map(|entry| entry.unwrap().file_name()).collect();
        names.sort();
        assert_eq!(names, ["demo.json", "images", "sparse"]);
    }

    #[test]
    fn a_folder_with_other_pictures_is_left_alone() {
        let folder = tempfile::tempdir().unwrap();
        let photo = folder.path().join("images/mine.jpg");
        fs::create_dir(photo.parent().unwrap()).unwrap();
        fs::write(&photo, "").unwrap();
        let error = ensure(folder.path(), &SMALL).unwrap_err().to_string();
        assert!(error.contains("images") && error.contains("--out"), "{error}");
        assert!(photo.exists());
    }
}

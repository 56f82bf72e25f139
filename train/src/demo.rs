//! `splat demo`: writes the demo capture.

use std::fs;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use splat_demo::{self as demo, DemoOptions};
use splat_model::capture::Capture;

use crate::own::{self, OwnFiles};
use crate::{output, progress};

/// Marks a folder as a demo capture and records the options it was made with.
pub const MARK: &str = "demo.json";

/// Options of `splat demo`.
#[derive(Clone, Debug, clap::Args)]
pub struct DemoArgs {
    /// Folder to write
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// Make one object a mirror, and give all others a glossy coat
    #[arg(long)]
    pub glossy: bool,
    /// Give each photograph its own exposure and white balance
    #[arg(long)]
    pub exposure: bool,
    /// Vary brightness, white balance and tone across each training photograph, as phones do
    #[arg(long)]
    pub graded: bool,
    /// Use a lens that bends straight lines (OPENCV): corners move by 4% of the width
    #[arg(long)]
    pub lens: bool,
    /// Use an equidistant fisheye lens (OPENCV_FISHEYE) of 120 degrees; not with --lens
    #[arg(long)]
    pub fisheye: bool,
    /// Cover four places of each training photograph with bright discs, and write masks that exclude them
    #[arg(long)]
    pub masks: bool,
    /// Make the ground and the sky transparent; not with --far
    #[arg(long)]
    pub alpha: bool,
    /// Take a third of the photographs from a third of the distance, and a third from 3.5 times as far
    #[arg(long)]
    pub zoom: bool,
    /// Perturb the poses of the training photographs: by 1 degree and 1% of the scene extent
    #[arg(long)]
    pub poses: bool,
    /// Surround the scene with a landscape and a sky, a hundred times as far away as the cameras, which are placed
    /// lower to see it
    #[arg(long)]
    pub far: bool,
    /// Move the camera during the exposure of two fifths of the training photographs, by 5% of the width
    #[arg(long)]
    pub motion: bool,
    /// Move the camera while the rows of each training photograph are read out one after the other, by 5% of the width
    #[arg(long)]
    pub rolling: bool,
    /// Take the training photographs with an open aperture, so that near and far parts are out of focus
    #[arg(long)]
    pub defocus: bool,
    /// Write an exact depth map for each photograph: 16-bit PNG, 0.001 scene units a level
    #[arg(long)]
    pub depth: bool,
    /// Photograph a town of 400 m instead: streets, houses that hide each other, trees; without effects. For captures
    /// that are trained in blocks
    #[arg(long)]
    pub town: bool,
    /// Number of photographs
    #[arg(long, value_name = "N", help = usual("Number of photographs", |options| options.views))]
    pub views: Option<usize>,
    /// Number of sparse points
    #[arg(long, value_name = "N", help = usual("Number of sparse points", |options| options.points))]
    pub points: Option<usize>,
    /// Width of the photographs, px
    #[arg(long, value_name = "PX", help = usual("Width of the photographs, px", |options| options.width))]
    pub width: Option<usize>,
    /// Height of the photographs, px
    #[arg(long, value_name = "PX", help = usual("Height of the photographs, px", |options| options.height))]
    pub height: Option<usize>,
    /// Seed of the cameras, the choice of sparse points, and the random draws of each effect
    #[arg(long, value_name = "S", default_value_t = DemoOptions::default().seed)]
    pub seed: u64,
}

/// Help on an option whose default depends on `--town`.
fn usual(what: &str, of: fn(&DemoOptions) -> usize) -> String {
    format!("{what} [default: {}; with --town {}]", of(&DemoOptions::PLAIN), of(&DemoOptions::TOWN))
}

impl DemoArgs {
    /// Returns the options in the library's type.
    pub fn options(&self) -> DemoOptions {
        let usual = if self.town { DemoOptions::TOWN } else { DemoOptions::PLAIN };
        DemoOptions {
            width: self.width.unwrap_or(usual.width),
            height: self.height.unwrap_or(usual.height),
            views: self.views.unwrap_or(usual.views),
            points: self.points.unwrap_or(usual.points),
            glossy: self.glossy,
            exposure: self.exposure,
            graded: self.graded,
            lens: self.lens,
            fisheye: self.fisheye,
            masks: self.masks,
            alpha: self.alpha,
            zoom: self.zoom,
            poses: self.poses,
            far: self.far,
            motion: self.motion,
            rolling: self.rolling,
            defocus: self.defocus,
            depth: self.depth,
            town: self.town,
            seed: self.seed,
        }
    }
}

/// Writes the capture and prints its folder.
///
/// # Errors
/// The errors of [`ensure`].
pub fn run(args: &DemoArgs) -> Result<()> {
    let made = ensure(&args.out, &args.options())?;
    let what = if made { "demo capture" } else { "demo capture, unchanged" };
    progress::say(&format!("{what}: {}", args.out.display()));
    Ok(())
}

/// Writes the demo capture into `folder`, unless the same one is already there and complete; returns whether it wrote.
///
/// Everything is made in a hidden folder first, so that files under their own names are complete. If the process is
/// killed meanwhile, the hidden folder stays.
///
/// # Errors
/// If an option is out of range, two exclude each other, the folder holds files of anything else where the capture is to be, or it cannot
/// be written.
pub fn ensure(folder: &Path, options: &DemoOptions) -> Result<bool> {
    let found = read_mark(folder).unwrap_or_default();
    if found.made_with == made_with(options) && is_complete(folder, options) {
        return Ok(false);
    }
    let earlier = earlier(folder, &found.files)?;
    progress::note("making the demo capture");
    let shown = folder.display();
    replace(folder, &earlier, options).with_context(|| {
        format!("cannot make the demo capture in {shown}: fix the problem named below, or choose another `--out`")
    })?;
    Ok(true)
}

/// Makes the capture beside its place and moves it there, after removing the files of an earlier one. The model is removed first and moved
/// last, so that the capture never looks complete while pictures are exchanged.
fn replace(folder: &Path, earlier: &[PathBuf], options: &DemoOptions) -> Result<()> {
    fs::create_dir_all(folder)?;
    let temporary = tempfile::Builder::new().prefix(".demo.tmp-").tempdir_in(folder)?;
    let temporary = temporary.path();
    demo::write(temporary, options)?;
    let mut mark = DemoMark { made_with: made_with(options), files: OwnFiles::default() };
    for name in demo::PARTS {
        mark.files.add(temporary, name, name)?;
    }
    for name in demo::PARTS.iter().rev() {
        let root = folder.join(name);
        let of_part: Vec<PathBuf> = earlier.iter().filter(|file| file.starts_with(&root)).cloned().collect();
        own::remove(&root, &of_part).with_context(|| format!("cannot replace {}", root.display()))?;
    }
    output::write(&folder.join(MARK), |file| Ok(serde_json::to_writer_pretty(file, &mark)?))?;
    for name in demo::PARTS {
        let (source, target) = (temporary.join(name), folder.join(name));
        if source.exists() {
            fs::rename(source, &target).with_context(|| format!("cannot write {}", target.display()))?;
        }
    }
    Ok(())
}

/// The mark of a demo capture.
#[derive(Default, Serialize, Deserialize)]
pub struct DemoMark {
    /// The options, and the version of the program under `splat demo`.
    #[serde(flatten)]
    made_with: Value,
    /// What was written.
    #[serde(default)]
    files: OwnFiles,
}

/// Everything that the content of a demo capture depends on.
fn made_with(options: &DemoOptions) -> Value {
    let mut made_with = json!(options);
    made_with["splat demo"] = env!("CARGO_PKG_VERSION").into();
    made_with
}

/// Reads the mark of the demo capture in `folder`. `None` also for any other file of that name.
pub fn read_mark(folder: &Path) -> Option<DemoMark> {
    let mark: DemoMark = serde_json::from_slice(&fs::read(folder.join(MARK)).ok()?).ok()?;
    mark.made_with.get("splat demo").is_some().then_some(mark)
}

fn is_complete(folder: &Path, options: &DemoOptions) -> bool {
    Capture::load(folder).is_ok_and(|capture| capture.views.len() == options.views)
        && demo::files(options).iter().all(|file| folder.join(file).is_file())
}

/// The files of an earlier demo capture where the new one is to be. Any other file there is refused, one of the demo that was changed too: it
/// must not be replaced.
fn earlier(folder: &Path, own: &OwnFiles) -> Result<Vec<PathBuf>> {
    let mut found = Vec::new();
    for root in demo::PARTS.map(|name| folder.join(name)) {
        found.extend(own::files_below(&root).with_context(|| format!("cannot list {}", root.display()))?);
    }
    let mark = folder.join(MARK);
    let other_mark = (mark.exists() && read_mark(folder).is_none()).then_some(&mark);
    match other_mark.into_iter().chain(&found).find(|file| **file == mark || !own.hold(folder, file)) {
        None => Ok(found),
        Some(taken) => bail!(
            "{} already exists and `splat demo` did not write it, or it was changed since: choose another folder with `--out`, or move it \
             away",
            taken.display()
        ),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SMALL: DemoOptions = DemoOptions { width: 16, height: 16, views: 2, points: 10, ..DemoOptions::PLAIN };

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

    /// The files that an effect adds beside the pictures are removed with the effect, and are made again when missing.
    #[test]
    fn what_effects_add_comes_and_goes() {
        let folder = tempfile::tempdir().unwrap();
        let folder = folder.path().join("demo");
        let all = DemoOptions { masks: true, motion: true, depth: true, ..SMALL };
        assert!(ensure(&folder, &all).unwrap());
        assert!(!ensure(&folder, &all).unwrap());
        for file in ["masks/0001.png", "depth/0000.png", "depth/depth.json", "truth.json"] {
            fs::remove_file(folder.join(file)).unwrap();
            assert!(ensure(&folder, &all).unwrap(), "{file} is missing");
            assert!(folder.join(file).is_file(), "{file}");
        }
        assert!(!folder.join("masks/0000.png").exists(), "held out");
        let truth: Value = serde_json::from_slice(&fs::read(folder.join("truth.json")).unwrap()).unwrap();
        let photographs = truth["photographs"].as_array().unwrap();
        assert_eq!(photographs.len(), 2);
        for (photograph, name) in photographs.iter().zip(["0000.png", "0001.png"]) {
            assert_eq!((photograph["name"].as_str(), photograph["aperture"].is_null()), (Some(name), true));
            let rotation = photograph["rotation_wxyz"].as_array().unwrap();
            let squared: f64 = rotation.iter().map(|value| value.as_f64().unwrap().powi(2)).sum();
            assert!((squared - 1.0).abs() < 1e-12 && photograph["readout"]["angular"].as_array().unwrap().len() == 3);
        }
        assert!(ensure(&folder, &SMALL).unwrap());
        for name in ["masks", "depth", "truth.json"] {
            assert!(!folder.join(name).exists(), "{name}");
        }
    }

    /// Two demos with different options never have the same mark: each option's value appears in it.
    #[test]
    fn each_flag_is_an_option_of_its_own() {
        use clap::{CommandFactory, FromArgMatches, Parser};
        #[derive(Parser)]
        struct DemoCli {
            #[command(flatten)]
            demo: DemoArgs,
        }
        let marked = |line: &[&str]| {
            let line = ["demo", "--out", "x"].iter().chain(line);
            made_with(&DemoCli::from_arg_matches(&DemoCli::command().get_matches_from(line)).unwrap().demo.options())
        };
        let plain = marked(&[]);
        assert_eq!(plain, made_with(&DemoOptions::PLAIN));
        let flags: Vec<String> = plain
            .as_object()
            .unwrap()
            .iter()
            .filter(|(_, value)| value.is_boolean())
            .map(|(name, _)| name.clone())
            .collect();
        assert_eq!(flags.len(), 15);
        assert_eq!(marked(&["--town"]), made_with(&DemoOptions::TOWN));
        for flag in flags.into_iter().filter(|flag| flag != "town") {
            let mut expected = plain.clone();
            expected[&flag] = true.into();
            assert_eq!(marked(&[&format!("--{flag}")]), expected);
        }
    }

    #[test]
    fn a_folder_with_other_pictures_is_left_alone() {
        let folder = tempfile::tempdir().unwrap();
        let photo = folder.path().join("images/mine.jpg");
        fs::create_dir(photo.parent().unwrap()).unwrap();
        fs::write(&photo, "").unwrap();
        let error = ensure(folder.path(), &SMALL).unwrap_err().to_string();
        assert!(error.contains("images/mine.jpg") && error.contains("--out"), "{error}");
        assert!(photo.exists());
    }

    /// A demo is replaced by another only as far as it is a demo.
    #[test]
    fn what_a_user_put_into_a_demo_stays() {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name);
        let other = DemoOptions { views: 3, ..SMALL };
        for (file, content) in
            [("images/mine.png", "mine"), ("masks/a/0001.png", "mine"), ("images/0001.png", "painted")]
        {
            ensure(folder.path(), &SMALL).unwrap();
            fs::create_dir_all(path(file).parent().unwrap()).unwrap();
            fs::write(path(file), content).unwrap();
            let before = own::files_below(folder.path()).unwrap();
            let error = ensure(folder.path(), &other).unwrap_err().to_string();
            assert!(error.contains(file) && error.contains("--out"), "{error}");
            assert_eq!(own::files_below(folder.path()).unwrap(), before);
            assert_eq!(fs::read_to_string(path(file)).unwrap(), content);
            fs::remove_file(path(file)).unwrap();
        }
        fs::write(path("notes.txt"), "beside the capture").unwrap();
        assert!(ensure(folder.path(), &other).unwrap() && path("notes.txt").exists());
        fs::write(path(MARK), "{\"steps\": 5}").unwrap();
        assert!(ensure(folder.path(), &SMALL).unwrap_err().to_string().contains(MARK), "of another program");
    }
}

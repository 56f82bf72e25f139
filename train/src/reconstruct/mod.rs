//! `splat reconstruct`, and what `splat train` does with photographs that have no cameras yet: runs the installed COLMAP.
//!
//! Stages: frames of a video (the private module `video`), features, matches, models. Each is finished once (the private module `cache`), so that a second run
//! skips it. The photographs are neither changed nor moved: the folder of the reconstruction holds links to them, and is a capture of its own.

mod cache;
mod failure;
mod photographs;
mod programs;
mod stage;
mod stages;
mod video;

use std::collections::BTreeMap;
use std::ffi::OsStr;
use std::fs;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail, ensure};
use clap::ValueEnum;
use clap::builder::RangedU64ValueParser;
use serde::{Deserialize, Serialize};
use splat_model::capture::scale::from_gps;
use splat_model::capture::unposed::PhotographFolder;
use splat_model::capture::{Capture, Scale};

use self::cache::{Ingredients, Stage, Workspace};
use self::photographs::CameraModelName;
use self::programs::{ColmapProgram, Ffmpeg};
use self::stages::Stages;
use crate::input::{self, is_video};
use crate::inputs::Inputs;
use crate::output::OUT;
use crate::progress::{self, VoiceArgs};
use crate::stop::Stop;

pub use self::stage::Running;

/// Folder of the reconstruction in the output folder of a run.
pub const FOLDER: &str = "reconstruction";

/// Options of `splat reconstruct`.
#[derive(Clone, Debug, clap::Args)]
pub struct ReconstructArgs {
    /// Folder of photographs (JPEG, PNG), or a video
    pub photographs: PathBuf,
    /// Folder for the reconstruction, a capture that all subcommands read [default: out/NAME-reconstruction, after the photographs]
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    #[command(flatten)]
    pub cameras: CameraArgs,
    #[command(flatten)]
    pub voice: VoiceArgs,
}

/// How cameras are found, and the size of the scene.
#[derive(Clone, Debug, Default, clap::Args, Serialize, Deserialize)]
pub struct CameraArgs {
    /// Number of frames to use of a video: the sharpest of as many intervals [default: two for each second of 30 frames, 60 to 200]
    #[arg(long, value_name = "N", value_parser = RangedU64ValueParser::<usize>::new().range(3..=2000))]
    pub frames: Option<usize>,
    /// COLMAP's camera model [default: OPENCV for 20 photographs of one camera or more, else SIMPLE_RADIAL]
    #[arg(long, value_name = "MODEL", value_enum)]
    #[serde(skip)]
    pub camera_model: Option<CameraModelName>,
    /// Leave the size of pictures and the number of features to COLMAP (3,200 px, 8,192), instead of at most 1,600 px and 2,048: many times slower
    #[arg(long)]
    #[serde(skip)]
    pub full_size_features: bool,
    /// Size of the scene, which its file states as the metres of a unit [default: scale.json in the capture's folder, if there is one]
    #[arg(long, value_name = "WHAT", value_enum)]
    pub scale_from: Option<ScaleFrom>,
}

/// What the size of a scene unit is measured from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum ScaleFrom {
    /// GPS positions in EXIF
    Gps,
}

/// Describes the size of a scene unit.
pub fn scale_said(scale: &Scale) -> String {
    let Scale { metres_per_unit, relative_deviation, source } = scale;
    let deviation = relative_deviation.map(|deviation| format!(" ±{:.1}%", 100.0 * deviation)).unwrap_or_default();
    let source = if source.is_empty() { String::new() } else { format!(", by {source}") };
    format!("a scene unit is {metres_per_unit:.4} m{deviation}{source}")
}

impl CameraArgs {
    /// What is left of these options once the cameras are known, for a run that may be resumed from another working directory.
    pub fn from_anywhere(&self) -> Self {
        Self { scale_from: self.scale_from, ..Self::default() }
    }

    /// Refuses options about finding cameras for a capture that has them.
    pub fn check_for_capture(&self, folder: &Path) -> Result<()> {
        let option = match self {
            Self { frames: Some(_), .. } => "--frames",
            Self { camera_model: Some(_), .. } => "--camera-model",
            Self { full_size_features: true, .. } => "--full-size-features",
            _ => return Ok(()),
        };
        bail!(
            "`{option}` is for photographs or videos without cameras, and {} has cameras: leave it out",
            folder.display()
        )
    }

    /// Measures the size of a capture's unit, if that is asked for, and keeps it in a reconstruction of this program.
    /// An error if it cannot be determined or written.
    pub fn scale(&self, capture: &mut Capture) -> Result<()> {
        if let Some(ScaleFrom::Gps) = self.scale_from {
            let scale = from_gps(capture)?.context("`--scale-from gps` finds no scale")?;
            progress::note(&scale_said(&scale));
            cache::keep_scale(&capture.folder, &scale)?;
            capture.scale = Some(scale);
        }
        Ok(())
    }
}

/// Reconstructs photographs, and says what was found.
pub fn run(args: &ReconstructArgs) -> Result<()> {
    let source = &args.photographs;
    ensure!(source.exists(), "there is nothing at {}: name a folder of photographs, or a video", source.display());
    ensure!(!Capture::is_in(source), "{} has cameras already: `splat train` reads it as it is", source.display());
    if source.is_file() && !is_video(source) {
        input::capture(source)?;
    }
    let folder = args.out.clone().unwrap_or_else(|| own_folder(source));
    let mut capture = reconstruct(source, &folder, &args.cameras)?;
    args.cameras.scale(&mut capture)?;
    progress::say(&format!("{}: train on it with `splat train {0}`", folder.display()));
    Ok(())
}

/// The folder of a reconstruction without `--out`: it serves every later run on the same photographs.
pub fn own_folder(source: &Path) -> PathBuf {
    let name = name_of(source);
    let source = std::path::absolute(source).unwrap_or_else(|_| source.to_owned());
    cache::own_folder(Path::new(OUT), &format!("{name}-{FOLDER}"), &source)
}

/// The name of photographs, a video, or what was reconstructed from them, for folders.
pub fn name_of(source: &Path) -> String {
    // The name of `..` is the name of the folder that it leads to.
    let named =
        if source.file_name().is_none() { source.canonicalize().unwrap_or_default() } else { source.to_owned() };
    let folder_of_cameras = named.parent().filter(|_| source.is_file() && Capture::is_in(source));
    let name = match folder_of_cameras.and_then(Path::file_name) {
        Some(folder) => Some(folder),
        None if source.is_file() => named.file_stem(),
        None => named.file_name(),
    };
    let name = name.unwrap_or(OsStr::new("capture")).to_string_lossy().into_owned();
    match name.strip_suffix(&format!("-{FOLDER}")) {
        Some(short) if source.join(cache::STAMP).exists() => short.to_owned(),
        _ => name,
    }
}

/// Finds the cameras of photographs or a video, and returns the capture in `folder`. An error if a program is missing or fails, photographs
/// are too few, broken or do not connect, or the user asked to stop; each message says what was found and what helps.
pub fn reconstruct(source: &Path, folder: &Path, options: &CameraArgs) -> Result<Capture> {
    let stop = Stop::listen()?;
    let is_video = source.is_file();
    ensure!(
        is_video || options.frames.is_none(),
        "`--frames` is for a video, and {} is a folder: leave it out",
        source.display()
    );
    let listed = if is_video { None } else { Some(PhotographFolder::list(source)?) };
    // Before anything is written.
    if let Some(listed) = &listed {
        failure::check_number(listed)?;
    }
    let root = listed.as_ref().map_or(source, |listed| &listed.root);
    Inputs::of([source, root]).spare([folder.to_owned(), folder.join(cache::IMAGES)])?;
    let ingredients = ingredients(source, listed.as_ref(), options)?;
    let programs = match Workspace::is_finished(folder, &ingredients)? {
        true => None,
        false => Some((ColmapProgram::find()?, is_video.then(Ffmpeg::find).transpose()?)),
    };
    let looked = listed.as_ref().filter(|_| programs.is_some()).map(photographs::look).transpose()?;
    let mut workspace = Workspace::open(folder, ingredients)?;
    if let Some((colmap, ffmpeg)) = programs {
        progress::note(&format!(
            "{}: finding the cameras with COLMAP {} on the CPU; all that it prints is in {}",
            source.display(),
            colmap.version,
            workspace.join(cache::LOG).display()
        ));
        let photographs = match (&listed, looked) {
            (Some(listed), Some(looked)) => {
                if let Some(others) = failure::others(listed) {
                    progress::note(&format!(
                        "not used, because only JPEG and PNG are read: {others} (convert them first)"
                    ));
                }
                photographs::link(&workspace, source, listed)?;
                looked
            }
            _ => {
                if let Some(ffmpeg) = ffmpeg.filter(|_| !workspace.has(Stage::Frames)) {
                    let frames = video::extract(&workspace, &ffmpeg, source, options.frames, &stop)?;
                    progress::note(&format!("{frames} frames of {}", source.display()));
                    workspace.finish(Stage::Frames)?;
                }
                photographs::look(&PhotographFolder::list(folder)?)?
            }
        };
        let CameraArgs { camera_model: model, full_size_features: full_size, .. } = *options;
        let stages = Stages { colmap: &colmap, stop: &stop, is_video, model, full_size };
        stages.run(&mut workspace, &photographs)?;
        workspace.finish(Stage::Model)?;
    }
    if let Some(listed) = &listed {
        // The photographs may have been moved since the links were made.
        photographs::link(&workspace, source, listed)?;
    }
    let capture = input::capture(folder)?;
    report(&workspace, &capture)?;
    Ok(capture)
}

fn ingredients(source: &Path, listed: Option<&PhotographFolder>, options: &CameraArgs) -> Result<Ingredients> {
    let bytes = |path: &Path| {
        let metadata = fs::metadata(path).with_context(|| format!("cannot read the size of {}", path.display()))?;
        Ok::<u64, anyhow::Error>(metadata.len())
    };
    let files: Result<BTreeMap<String, u64>> = match listed {
        Some(listed) => listed.names.iter().map(|name| Ok((name.clone(), bytes(&listed.path(name))?))).collect(),
        None => Ok([(name_of(source), bytes(source)?)].into()),
    };
    let frames = options.frames.map(|frames| ("frames".to_string(), frames.to_string()));
    let model = options.camera_model.map(|model| ("camera_model".to_string(), model.name()));
    let full_size = options.full_size_features.then(|| ("full_size_features".to_string(), "true".to_string()));
    let source = std::path::absolute(source).unwrap_or_else(|_| source.to_owned());
    Ok(Ingredients { source, files: files?, options: [frames, model, full_size].into_iter().flatten().collect() })
}

/// Says how many photographs were placed, and how well.
fn report(workspace: &Workspace, capture: &Capture) -> Result<()> {
    let all = PhotographFolder::list(workspace.folder())?.names;
    let placed: std::collections::BTreeSet<&str> = capture.views.iter().map(|view| view.name.as_str()).collect();
    let missing: Vec<String> = all.iter().filter(|name| !placed.contains(name.as_str())).cloned().collect();
    let points = capture.points.positions.len();
    let errors = (0..points).filter_map(|point| capture.tracks.stated_error_px(point)).map(f64::from);
    let (sum, count) = errors.fold((0.0, 0), |(sum, count), error| (sum + error, count + 1));
    let error =
        if count > 0 { format!(", mean reprojection error {:.2} px", sum / f64::from(count)) } else { String::new() };
    progress::note(&format!(
        "{}: {} of {} photographs placed, {points} points{error}",
        workspace.folder().display(),
        placed.len(),
        all.len()
    ));
    let models = fs::read_dir(workspace.join(cache::SPARSE)).map_or(1, Iterator::count);
    if let Some(said) = failure::not_placed(all.len(), &missing, models) {
        progress::note(&said);
    }
    Ok(())
}

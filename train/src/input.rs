//! Input of the subcommands: captures, photographs and scenes.

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::AtomicUsize;

use anyhow::{Context, Result, bail, ensure};
use clap::value_parser;
use glam::DVec3;
use serde::{Deserialize, Serialize};
use splat_model::capture::image::{load, load_all};
use splat_model::capture::unposed::PhotographFolder;
use splat_model::capture::{Capture, CaptureError, Photo, Photograph, PhotographFacts, Split};
use splat_model::effects::masks;
use splat_model::formats;
use splat_model::gaussians::GaussianRows;
use splat_model::optim::scene_extent;
use splat_model::ply::TrainedAs;
use splat_model::sniff::{FileClass, FileKind};
use splat_model::trainer::ranks::{Ranks, gather_all, share_of};

use crate::progress;

/// COLMAP's models, below a capture's folder.
pub const SPARSE: &str = "sparse";

/// Largest number of photographs in memory at once while all are checked.
const AT_ONCE: usize = 64;

/// Reads the cameras of a capture, without opening a picture. An error if the folder is missing or is not a capture.
pub fn capture(folder: &Path) -> Result<Capture> {
    let is_file = folder.is_file() && !Capture::is_in(folder);
    if let Some(FileKind { what, remedy, .. }) = FileKind::of(folder).filter(|_| is_file) {
        bail!("{} is {what}, and no capture: {remedy}", folder.display());
    }
    ensure!(
        folder.exists() && !is_file,
        "there is no capture folder {}: name the folder that holds `images/` and `sparse/0/`, or `transforms.json`, or make one \
         with `splat reconstruct`",
        folder.display()
    );
    let capture = Capture::load(folder).map_err(|error| match lacks_cameras(folder) {
        true => anyhow::Error::from(error).context(format!(
            "{} holds photographs whose cameras are unknown: find them with `splat reconstruct {0}`",
            folder.display()
        )),
        false => error.into(),
    })?;
    capture.remarks.iter().for_each(|remark| progress::note(&format!("{}: {remark}", folder.display())));
    Ok(capture)
}

/// Whether `splat train` is to reconstruct this first: a video, or a folder of photographs without cameras. A folder with a broken
/// reconstruction is not.
pub fn lacks_cameras(source: &Path) -> bool {
    let has_cameras = Capture::is_in(source) || source.join(SPARSE).exists();
    let has_photographs =
        || PhotographFolder::list(source).is_ok_and(|found| !found.names.is_empty() || !found.other.is_empty());
    !has_cameras && (is_video(source) || source.is_dir() && has_photographs())
}

/// Whether a file is a video, as far as can be told: FFmpeg knows more kinds than this program.
pub fn is_video(source: &Path) -> bool {
    source.is_file() && FileKind::of(source).is_none_or(|kind| kind.class == FileClass::Video)
}

/// Returns the extent of the scene that a capture's cameras see, scene units.
pub fn extent(capture: &Capture) -> f64 {
    let centres: Vec<_> = capture.views.iter().map(|view| view.cam_from_world.inverse().translation).collect();
    scene_extent(&centres)
}

/// Names of a capture's first views, for a message.
pub fn some_names(capture: &Capture) -> String {
    const LISTED: usize = 5;
    let names: Vec<&str> = capture.views.iter().take(LISTED).map(|view| view.name.as_str()).collect();
    let more = if capture.views.len() > LISTED { ", ..." } else { "" };
    format!("{}{more}", names.join(", "))
}

/// Selection and size of the photographs.
#[derive(Clone, Debug, clap::Args, Serialize, Deserialize)]
pub struct PhotoArgs {
    /// Hold out every Kth photograph in name order for testing
    #[arg(long, value_name = "K", help = format!(
        "Hold out every Kth photograph in name order for testing, beginning with the first; 0 holds out none [default: the \
         capture's own split if its files have one, otherwise {}]", Split::USUAL
    ))]
    pub test_every: Option<usize>,
    /// Downsize photographs whose longer side exceeds this, px
    #[arg(long, value_name = "PX", value_parser = value_parser!(u32).range(1..))]
    pub max_side: Option<u32>,
}

impl PhotoArgs {
    /// Returns the split of a capture, and these options as reported: with the number that was used, or none if the
    /// capture's own split applies.
    pub fn split(&self, capture: &Capture) -> (Split, Self) {
        let counted = self.test_every.or_else(|| capture.split.is_none().then_some(Split::USUAL));
        (Split::of(capture, counted), Self { test_every: counted, ..self.clone() })
    }
}

/// Decodes the photographs of some views of a capture, on all threads. With `masked`, they have their masks, and
/// photographs whose masks exclude every pixel are dropped. An error if a picture is missing, cannot be decoded, or
/// differs in size from its camera; with `masked`, also if this holds for a mask, or if masks leave no photograph.
pub fn photographs(capture: &Capture, views: &[usize], max_side: Option<u32>, masked: bool) -> Result<Vec<Photo>> {
    capture.check_photographs(views)?;
    let photos = decoded(capture, views, max_side, masked)?;
    say_dropped(capture, views.len(), photos.len())?;
    Ok(photos)
}

/// Decodes as [`photographs`] does, without a note on dropped photographs.
fn decoded(capture: &Capture, views: &[usize], max_side: Option<u32>, masked: bool) -> Result<Vec<Photo>> {
    let counter = progress::counter("reading photographs", views.len());
    let mut photos = load_all(views.iter().map(|&view| &capture.views[view]), max_side, |_| counter.inc(1))?;
    if masked {
        masks::attach(capture, views, &mut photos)
            .context("a mask cannot be used (`splat train --effects=-masks` ignores masks)")?;
    }
    Ok(photos)
}

fn say_dropped(capture: &Capture, asked: usize, left: usize) -> Result<()> {
    let dropped = asked - left;
    ensure!(
        dropped == 0 || left > 0,
        "the masks of {} exclude every pixel of {dropped} photographs, and no other is left: `--effects=-masks` does \
         without masks, and `--test-every` chooses the held-out photographs",
        capture.folder.display()
    );
    if dropped > 0 {
        progress::note(&format!("photographs left out, because their masks exclude every pixel: {dropped}"));
    }
    Ok(())
}

/// Selection of a capture's photographs, and how they are read.
pub struct PhotoSelection<'a> {
    pub capture: &'a Arc<Capture>,
    /// Largest length of the longer side, px; longer photographs are downsized.
    pub max_side: Option<u32>,
    /// Whether masks apply.
    pub masked: bool,
    /// Whether alpha channels are ignored.
    pub opaque: bool,
}

impl PhotoSelection<'_> {
    /// Reads the photographs of some views together with the other ranks of a run, each of which decodes its share of them, so that a broken
    /// picture does not end a long run. Photographs are kept while they fit into `room`, bytes. The others are decoded again on each use.
    /// An error as for [`photographs`] in its own share, and if another rank is gone.
    pub fn read(&self, views: &[usize], room: usize, ranks: &dyn Ranks) -> Result<Vec<Photograph>> {
        self.capture.check_photographs(views)?;
        let names = views.iter().map(|&view| (self.capture.views[view].name.as_str(), view));
        let by_name: BTreeMap<&str, usize> = names.collect();
        let room = Arc::new(AtomicUsize::new(room));
        let photograph = |&(view, has_alpha, has_mask): &(usize, bool, bool)| {
            let of = &self.capture.views[view];
            let (name, intrinsics) = (of.name.clone(), of.intrinsics_within(self.max_side));
            let facts = PhotographFacts { name, intrinsics, cam_from_world: of.cam_from_world, has_alpha, has_mask };
            Photograph::read_later(facts, &room, self.again(view))
        };
        let (mut own, mut found) = (BTreeMap::new(), Vec::new());
        for some in views[share_of(ranks.rank(), ranks.count(), views.len())].chunks(AT_ONCE) {
            for photo in decoded(self.capture, some, self.max_side, self.masked)? {
                let photo = Arc::new(made_opaque(photo, self.opaque));
                let facts = (by_name[photo.name.as_str()], photo.alpha.is_some(), photo.mask.is_some());
                let of_own = photograph(&facts);
                of_own.keep(&photo);
                own.insert(facts.0, of_own);
                found.push(facts);
            }
        }
        let found = gather_all(ranks, &found)?.concat();
        say_dropped(self.capture, views.len(), found.len())?;
        Ok(found.iter().map(|facts| own.remove(&facts.0).unwrap_or_else(|| photograph(facts))).collect())
    }

    /// Returns a function that decodes a photograph again.
    fn again(&self, view: usize) -> impl Fn() -> Result<Photo, CaptureError> + Send + Sync + 'static {
        let (capture, max_side, masked, opaque) = (Arc::clone(self.capture), self.max_side, self.masked, self.opaque);
        move || {
            let mut photos = vec![load(&capture.views[view], max_side)?];
            if masked {
                masks::attach(&capture, &[view], &mut photos)?;
            }
            let photo = photos.pop().map(|photo| made_opaque(photo, opaque));
            photo.ok_or_else(|| CaptureError::Changed { name: capture.views[view].name.clone() })
        }
    }
}

fn made_opaque(photo: Photo, opaque: bool) -> Photo {
    let alpha = photo.alpha.filter(|_| !opaque);
    Photo { alpha, ..photo }
}

/// Reads the rows of a scene that `option` names, how it was trained, and the origin that positions are relative to: that of `capture`, or
/// else of the scene. Prints a note if some of its Gaussians cannot be rendered. An error if the file is missing, is not a
/// scene, or holds no Gaussian.
pub fn rows(option: &str, path: &Path, capture: Option<&Capture>) -> Result<(GaussianRows, TrainedAs, DVec3)> {
    let (scene, _) = formats::read(path).with_context(|| format!("cannot read the scene that `{option}` names"))?;
    let formats::SceneFile { mut rows, mut origin, trained, .. } = scene;
    ensure!(!rows.is_empty(), "{} holds no Gaussian: name another scene as `{option}`", path.display());
    if let Some(capture) = capture {
        move_means(&mut rows, (origin - capture.origin).to_array());
        origin = capture.origin;
    }
    progress::note_unusable(path, rows.unusable(), rows.len());
    Ok((rows, trained, origin))
}

/// Returns some rows of a scene, with spherical harmonics up to `sh_degree`.
pub fn selected(rows: &GaussianRows, which: impl IntoIterator<Item = usize>, sh_degree: usize) -> GaussianRows {
    let mut found = GaussianRows { sh_degree, ..GaussianRows::like(rows) };
    which.into_iter().for_each(|row| found.push(rows, row));
    found
}

/// Adds `capture_from_scene` to every position, in f64.
///
/// The positions move, not the cameras. A capture keeps its cameras near zero, so positions near them have digits to spare. Cameras moved
/// to a scene stored far from zero would lose digits, and every render would have to take the difference of two large numbers.
pub fn move_means(rows: &mut GaussianRows, capture_from_scene: [f64; 3]) {
    // Without an offset, the usual case, a scene keeps its values to the last bit.
    if capture_from_scene == [0.0; 3] {
        return;
    }
    for mean in &mut rows.means {
        for (coordinate, offset) in mean.iter_mut().zip(capture_from_scene) {
            *coordinate = (f64::from(*coordinate) + offset) as f32;
        }
    }
}

#[cfg(test)]
mod tests;

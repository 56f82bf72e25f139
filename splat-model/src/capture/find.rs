//! Finds the cameras of a folder: at the usual places, or else anywhere in it or directly above it.

use std::path::{Path, PathBuf};

use super::names::{SAMPLE, children, entries, parent};
use super::read::{read, regular_size};
use super::transforms::{MAX_BYTES, SINGLE, TRAIN};
use super::{Capture, CaptureError, colmap, transforms};
use crate::encoding::utf8;

/// Folders below the given one that are searched: `CAPTURE/nerfstudio/colmap/sparse/0`.
const DEEPEST: usize = 4;

/// Files that mark what this program wrote, whose cameras are of other runs: a reconstruction, a demo capture, a finished run.
pub(super) const OURS: [&str; 3] = ["reconstruction.json", "demo.json", "metrics.json"];

/// Folders beside a folder of photographs that hold its cameras, in the layouts of nerfstudio, of the original code's `convert.py` and of COLMAP.
const BESIDE: [&str; 6] = ["colmap", "distorted", "dense", "undistorted", "sparse_txt", "text"];

/// Where cameras are.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Cameras {
    /// Folders of COLMAP models, such as `sparse/0` and `sparse/1`; several in order of their numbers.
    Colmap(Vec<PathBuf>),
    /// A JSON file with frames.
    Json(PathBuf),
}

impl Cameras {
    fn path(&self) -> &Path {
        match self {
            Self::Colmap(models) => &models[0],
            Self::Json(file) => file,
        }
    }

    fn load(&self, pictures: &colmap::Pictures) -> Result<Capture, CaptureError> {
        match self {
            Self::Colmap(models) => colmap::load(models, pictures),
            Self::Json(file) => transforms::load(file),
        }
    }
}

/// Whether cameras are in a folder or directly above it, or are a file.
pub(super) fn is_there(source: &Path) -> bool {
    match source.is_file() {
        true => of_file(source).is_some(),
        false => !inside(source, 0).is_empty() || !above(source).is_empty(),
    }
}

pub(super) fn load(source: &Path) -> Result<Capture, CaptureError> {
    if let Some(cameras) = of_file(source) {
        return cameras.load(&colmap::Pictures::Near(&parent(source)));
    }
    let near = colmap::Pictures::Near(source);
    if let Some(usual) = usual(source) {
        return usual.load(&near);
    }
    let found = inside(source, 0);
    let (found, pictures) =
        if found.is_empty() { (above(source), colmap::Pictures::In(source)) } else { (found, near) };
    let is_above = matches!(pictures, colmap::Pictures::In(_));
    let mut fitting = Vec::new();
    match &found[..] {
        // The error names the usual place.
        [] => return colmap::load(&colmap::models_in(&source.join(colmap::SPARSE)), &pictures),
        [only] if !is_above => fitting.push((only, only.load(&pictures)?)),
        several => {
            for cameras in several {
                let capture = cameras.load(&pictures)?;
                if has_pictures(&capture, is_above.then_some(source)) {
                    fitting.push((cameras, capture));
                }
            }
        }
    }
    let list = |cameras: &mut dyn Iterator<Item = &Cameras>| {
        cameras.map(|cameras| cameras.path().display().to_string()).collect::<Vec<_>>().join(" and ")
    };
    let detail = match (fitting.len(), is_above) {
        (1, _) => {
            let (chosen, capture) = fitting.remove(0);
            let (path, picture) = (chosen.path().display(), capture.views[0].image_path.display());
            let mut remark = format!("cameras are read from {path}, the first photograph is {picture}");
            if found.len() > 1 {
                let others = list(&mut found.iter().filter(|cameras| *cameras != chosen));
                remark.push_str(&format!("; the photographs of {others} are not there"));
            }
            return Ok(Capture { remarks: [vec![remark], capture.remarks].concat(), ..capture });
        }
        (0, true) => {
            "cameras lie above it, and their photographs are not in it. Name the folder above if they belong together, and else move the \
             photographs to a folder of their own"
        }
        (0, false) => {
            "it holds cameras at several places, and the photographs of none are there. Put the photographs into `images/` beside the \
             cameras, and name one of these places instead of the folder"
        }
        _ => "cameras are at several places. Name the one that is meant instead of the folder, or remove the others",
    };
    Err(CaptureError::content(source, format!("{detail}. Found: {}", list(&mut found.iter()))))
}

/// Whether some of the first photographs are there, in `folder` if one is given.
fn has_pictures(capture: &Capture, folder: Option<&Path>) -> bool {
    let folder = folder.map(|folder| folder.canonicalize().unwrap_or_default());
    capture.views.iter().take(SAMPLE).any(|view| match &folder {
        None => view.image_path.is_file(),
        Some(folder) => view.image_path.canonicalize().is_ok_and(|path| path.starts_with(folder)),
    })
}

/// The cameras that a file is or belongs to.
fn of_file(file: &Path) -> Option<Cameras> {
    if !file.is_file() {
        return None;
    }
    let name = file.file_name()?.to_str()?.to_ascii_lowercase();
    let (stem, extension) = name.rsplit_once('.')?;
    match extension {
        "json" => has_frames(file).then(|| Cameras::Json(file.to_owned())),
        "bin" | "txt" if ["cameras", "images", "points3d", "rigs", "frames"].contains(&stem) => {
            Some(parent(file)).filter(|folder| is_model(folder)).map(|folder| Cameras::Colmap(vec![folder]))
        }
        _ => None,
    }
}

/// The cameras at the usual places of a folder: the complete models in `sparse/`, or else the files of NeRF-synthetic, instant-ngp and
/// nerfstudio.
fn usual(folder: &Path) -> Option<Cameras> {
    let models = colmap::models_in(&folder.join(colmap::SPARSE));
    if models.iter().any(|model| colmap::is_complete(model)) {
        return Some(Cameras::Colmap(models));
    }
    let json = [TRAIN, SINGLE].map(|name| folder.join(name));
    json.into_iter().find(|file| file.is_file()).map(Cameras::Json)
}

/// The cameras at the usual places of a folder, or else those whose files lie in the folder itself or in numbered subfolders.
fn here(folder: &Path) -> Vec<Cameras> {
    if let Some(cameras) = usual(folder) {
        return vec![cameras];
    }
    let models: Vec<PathBuf> = colmap::models_in(folder).into_iter().filter(|model| is_model(model)).collect();
    let models = if models.is_empty() && is_model(folder) { vec![folder.to_owned()] } else { models };
    let is_json = |path: &PathBuf| path.extension().is_some_and(|kind| kind.eq_ignore_ascii_case("json"));
    let mut json: Vec<PathBuf> = entries(folder).filter(|path| is_json(path) && has_frames(path)).collect();
    json.sort();
    let models = (!models.is_empty()).then_some(Cameras::Colmap(models));
    models.into_iter().chain(json.into_iter().map(Cameras::Json)).collect()
}

/// All cameras in a folder. Where a folder has them at the usual places, others in it do not count.
fn inside(folder: &Path, depth: usize) -> Vec<Cameras> {
    let mut found = here(folder);
    if depth == DEEPEST || usual(folder).is_some() {
        return found;
    }
    for child in children(folder) {
        let is_counted = |of: &Cameras| matches!(of, Cameras::Colmap(models) if models.contains(&child));
        let is_ours = OURS.iter().any(|file| child.join(file).is_file());
        if !is_ours && !found.iter().any(is_counted) {
            found.extend(inside(&child, depth + 1));
        }
    }
    found
}

/// The cameras directly above a folder: in the first of the places there that has any.
fn above(folder: &Path) -> Vec<Cameras> {
    let above = parent(folder);
    let places = std::iter::once(above.clone()).chain(BESIDE.map(|name| above.join(name)));
    places.map(|place| here(&place)).find(|found| !found.is_empty()).unwrap_or_default()
}

/// Whether a folder has files of a model, complete or not. A file `images.txt` alone may be any list.
fn is_model(folder: &Path) -> bool {
    ["cameras.bin", "cameras.txt", "images.bin"].iter().any(|name| folder.join(name).is_file())
}

/// Whether a file is JSON with frames that have poses.
fn has_frames(file: &Path) -> bool {
    let is_small = regular_size(file).is_ok_and(|bytes| bytes <= MAX_BYTES);
    let text = if is_small { read(file).map(utf8).unwrap_or_default() } else { Vec::new() };
    let holds = |word: &[u8]| text.windows(word.len()).any(|part| part == word);
    holds(b"\"frames\"") && holds(b"\"transform_matrix\"")
}

#[cfg(test)]
mod tests;

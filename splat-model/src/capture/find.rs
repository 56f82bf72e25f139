//! Finds the cameras of a folder: at the usual places, or else anywhere in it or directly above it.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use super::format::{CaptureFormat, formats};
use super::names::{SAMPLE, children, parent};
use super::{Capture, CaptureError, Result, colmap, panoramas};

/// Folders below the given one that are searched: `CAPTURE/nerfstudio/colmap/sparse/0`.
const DEEPEST: usize = 4;

/// Files that mark what this program wrote, whose cameras are of other runs: a reconstruction, a demo capture, a finished run.
pub(super) const OURS: [&str; 3] = ["reconstruction.json", "demo.json", "metrics.json"];

/// Folders beside a folder of photographs that hold its cameras, in the layouts of nerfstudio, of the original code's `convert.py` and of COLMAP.
const BESIDE: [&str; 6] = ["colmap", "distorted", "dense", "undistorted", "sparse_txt", "text"];

/// Cameras of a format: files or folders, of which several are models of one capture.
pub(super) struct Cameras {
    format: Arc<dyn CaptureFormat>,
    paths: Vec<PathBuf>,
}

impl Cameras {
    fn load(&self, pictures: &colmap::Pictures) -> Result<Capture> {
        panoramas::cut(Capture { format: self.format.name(), ..self.format.load(&self.paths, pictures)? })
    }
}

/// The cameras that the first format finds.
fn first(find: impl Fn(&dyn CaptureFormat) -> Vec<PathBuf>) -> Option<Cameras> {
    let found = |format: Arc<dyn CaptureFormat>| Cameras { paths: find(&*format), format };
    formats().into_iter().map(found).find(|cameras| !cameras.paths.is_empty())
}

/// Whether cameras are in a folder or directly above it, or are a file.
pub(super) fn is_there(source: &Path) -> bool {
    if source.is_file() {
        return of_file(source).is_some();
    }
    !inside(source, 0).is_empty() || !above(source).is_empty()
}

pub(super) fn load(source: &Path) -> Result<Capture> {
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
        cameras.map(|cameras| cameras.paths[0].display().to_string()).collect::<Vec<_>>().join(" and ")
    };
    let detail = match (fitting.len(), is_above) {
        (1, _) => {
            let (chosen, capture) = fitting.remove(0);
            let (path, picture) = (chosen.paths[0].display(), capture.views[0].image_path.display());
            let mut remark = format!("cameras are read from {path}, the first photograph is {picture}");
            if found.len() > 1 {
                let others = list(&mut found.iter().filter(|cameras| !std::ptr::eq(*cameras, chosen)));
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
    if file.is_file() { first(|format| format.of_file(file)) } else { None }
}

/// The cameras at the usual places of a folder.
fn usual(folder: &Path) -> Option<Cameras> {
    first(|format| format.usual(folder))
}

/// The cameras at the usual places of a folder, or else those directly in it.
fn here(folder: &Path) -> Vec<Cameras> {
    if let Some(cameras) = usual(folder) {
        return vec![cameras];
    }
    let of = |format: Arc<dyn CaptureFormat>| {
        format.here(folder).into_iter().map(move |paths| Cameras { format: format.clone(), paths })
    };
    formats().into_iter().flat_map(of).collect()
}

/// All cameras in a folder. Where a folder has them at the usual places, others in it do not count.
fn inside(folder: &Path, depth: usize) -> Vec<Cameras> {
    let mut found = here(folder);
    if depth == DEEPEST || usual(folder).is_some() {
        return found;
    }
    for child in children(folder) {
        let is_counted = |of: &Cameras| of.paths.contains(&child);
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

#[cfg(test)]
mod tests;

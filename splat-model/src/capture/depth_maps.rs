//! The files of depth maps.

use std::path::PathBuf;

use super::masks::by_name;
use super::names::Names;
use super::{Capture, View};

/// Folders of a capture in which tools keep depth maps.
const FOLDERS: [&str; 3] = ["depth", "depths", "depth_maps"];

/// The file beside depth maps that states their scale.
pub(crate) const SCALE: &str = "depth.json";

pub(crate) fn folders(capture: &Capture) -> Vec<PathBuf> {
    FOLDERS.iter().map(|name| capture.folder.join(name)).filter(|folder| folder.is_dir()).collect()
}

/// The depth map of each view: a PNG file named like a mask (see [`masks`](super::masks)), in the first folder that has one for any view. `None`
/// for a view without a map.
pub(crate) fn find(capture: &Capture) -> Vec<Option<PathBuf>> {
    let mut files = Names::default();
    for folder in folders(capture) {
        let of_view = |view: &View| by_name(std::slice::from_ref(&folder), &view.name, &mut files);
        let found: Vec<Option<PathBuf>> = capture.views.iter().map(of_view).collect();
        if found.iter().any(Option::is_some) {
            return found;
        }
    }
    vec![None; capture.views.len()]
}

/// The folder of a capture's depth maps, relative to the capture; `None` if no photograph has one.
pub fn folder(capture: &Capture) -> Option<PathBuf> {
    let first = find(capture).into_iter().flatten().next()?;
    Some(first.strip_prefix(&capture.folder).ok()?.components().next()?.as_os_str().into())
}

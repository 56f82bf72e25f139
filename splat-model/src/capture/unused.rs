//! What lies in a capture and is not used: masks and depth maps of no photograph, and pictures without cameras.

use std::collections::{BTreeSet, HashSet};
use std::path::{Path, PathBuf};

use super::find::OURS;
use super::names::{PICTURES, entries, files_below, parent};
use super::{Capture, View, depth_maps, masks};

pub(super) fn remarks(capture: &Capture) -> Vec<String> {
    // What this program writes holds nothing of the user's.
    if OURS.iter().any(|file| capture.folder.join(file).is_file()) {
        return Vec::new();
    }
    let of_face: fn(&View) -> &str = |view| &view.name;
    let masks = (masks::folders(capture), masks::find(capture), View::photograph as _);
    let depth = (depth_maps::folders(capture), depth_maps::find(capture), of_face);
    let mut remarks = Vec::new();
    let mut used: HashSet<PathBuf> = capture.views.iter().map(|view| view.image_path.clone()).collect();
    for (folders, found, name) in [masks, depth] {
        let found: HashSet<PathBuf> = found.into_iter().flatten().collect();
        remarks.extend(folders.iter().filter_map(|folder| unmatched(capture, folder, &found, name)));
        used.extend(found);
    }
    let folders: BTreeSet<PathBuf> = capture.views.iter().map(|view| parent(&view.image_path)).collect();
    for folder in folders {
        let is_left = |path: &PathBuf| is_picture(path) && path.is_file() && !used.contains(path);
        let mut left: Vec<PathBuf> = entries(&folder).filter(is_left).collect();
        left.sort();
        if let Some(first) = left.first() {
            let (count, shown) = (left.len(), named(&capture.folder, first));
            remarks.push(format!(
                "pictures without a camera are not used: {count} in {}, such as {shown}",
                folder.display()
            ));
        }
    }
    remarks
}

/// A note on a folder of masks or depth maps that does not fit the photographs, after whose `name` its files are named.
fn unmatched(capture: &Capture, folder: &Path, found: &HashSet<PathBuf>, name: fn(&View) -> &str) -> Option<String> {
    let files: Vec<String> = match files_below(folder, &[]) {
        Ok(files) => files.into_iter().filter(|name| name != depth_maps::UNIT).collect(),
        Err(error) => return Some(error.to_string()),
    };
    let left: Vec<&String> = files.iter().filter(|name| !found.contains(&folder.join(name))).collect();
    let (first, view) = (left.first()?, capture.views.first()?);
    let [whole, short] = masks::names(name(view), "png").map(|name| named(&capture.folder, &folder.join(name)));
    let belong = match left.len() == files.len() {
        true => "none belongs to a photograph".to_string(),
        false => format!("{} of them belong to no photograph", left.len()),
    };
    let what = if is_picture(Path::new(first)) { "pictures" } else { "files" };
    let (folder, count) = (named(&capture.folder, folder), files.len());
    Some(format!(
        "{folder}/ holds {count} {what}, and {belong}: expected for instance {whole} or {short}, found {first}"
    ))
}

fn is_picture(path: &Path) -> bool {
    path.extension().is_some_and(|kind| PICTURES.iter().any(|known| kind.eq_ignore_ascii_case(known)))
}

/// A path as it is called in the capture.
fn named(folder: &Path, path: &Path) -> String {
    path.strip_prefix(folder).unwrap_or(path).display().to_string()
}

#[cfg(test)]
mod tests;

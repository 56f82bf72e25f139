//! What lies in a capture and is not used: masks and depth maps of no photograph, pictures without cameras, and everything else at the top.

use std::collections::{BTreeMap, BTreeSet, HashSet};
use std::fs;
use std::path::{Path, PathBuf};

use super::Capture;
use super::find::{self, OURS, parent};
use super::names::{PICTURES, files_below};
use super::scale::SCALE_FILE;
use crate::effects::{depth, masks};

/// Files at the top of a capture that are read by other means or mean nothing.
const KNOWN: [&str; 3] = [SCALE_FILE, "Thumbs.db", "desktop.ini"];

/// Entries of the list that are named.
const MOST: usize = 12;

/// Notes on what is not used.
pub(super) fn remarks(capture: &Capture) -> Vec<String> {
    // What this program writes holds nothing of the user's.
    if OURS.iter().any(|file| capture.folder.join(file).is_file()) {
        return Vec::new();
    }
    let masks = (masks::folders(capture), masks::find(capture));
    let depth = (depth::folders(capture), depth::find(capture));
    let mut remarks = Vec::new();
    let mut used: HashSet<PathBuf> = capture.files.iter().cloned().collect();
    used.extend(capture.views.iter().map(|view| view.image_path.clone()));
    for (folders, found) in [masks, depth] {
        let found: HashSet<PathBuf> = found.into_iter().flatten().collect();
        remarks.extend(folders.iter().filter_map(|folder| unmatched(capture, folder, &found)));
        used.extend(folders);
        used.extend(found);
    }
    let folders: BTreeSet<PathBuf> = capture.views.iter().map(|view| parent(&view.image_path)).collect();
    for folder in folders {
        let is_left = |path: &PathBuf| is_picture(path) && path.is_file() && !used.contains(path);
        let mut left: Vec<PathBuf> = entries(&folder).into_iter().filter(is_left).collect();
        left.sort();
        if let Some(first) = left.first() {
            let (count, shown) = (left.len(), named(&capture.folder, first));
            remarks.push(format!(
                "pictures without a camera are not used: {count} in {}, such as {shown}",
                folder.display()
            ));
        }
        used.extend(left);
    }
    remarks.extend(others(&capture.folder, &used));
    remarks
}

/// A note on a folder of masks or depth maps that does not fit the photographs.
fn unmatched(capture: &Capture, folder: &Path, found: &HashSet<PathBuf>) -> Option<String> {
    let files: Vec<String> = files_below(folder).into_iter().filter(|name| name != depth::SCALE).collect();
    let left: Vec<&String> = files.iter().filter(|name| !found.contains(&folder.join(name))).collect();
    let (first, view) = (left.first()?, capture.views.first()?);
    let [whole, short] = masks::names(&view.name).map(|name| named(&capture.folder, &folder.join(name)));
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

/// A note on everything else at the top of the capture, by kind.
fn others(folder: &Path, used: &HashSet<PathBuf>) -> Option<String> {
    let tops: HashSet<PathBuf> = used
        .iter()
        .filter_map(|path| Some(folder.join(path.strip_prefix(folder).ok()?.components().next()?)))
        .collect();
    let (mut list, mut kinds) = (Vec::new(), BTreeMap::<String, Vec<String>>::new());
    let mut entries = entries(folder);
    entries.sort();
    for path in entries.into_iter().filter(|path| !tops.contains(path)) {
        let name = named(folder, &path);
        if name.starts_with('.') || KNOWN.contains(&name.as_str()) {
            continue;
        }
        match path.is_dir() {
            true if find::is_inside(&path) => list.push(format!("{name}/ (cameras)")),
            true => list.push(format!("{name}/")),
            false if find::has_frames(&path) => list.push(format!("{name} (cameras)")),
            false => {
                let kind = path.extension().unwrap_or_default().to_string_lossy().to_lowercase();
                kinds.entry(kind).or_default().push(name);
            }
        }
    }
    list.extend(kinds.into_iter().flat_map(|(kind, names)| match names.len() {
        0..=3 => names,
        count => vec![format!("{count} files .{kind}")],
    }));
    let more = list.len().saturating_sub(MOST);
    list.truncate(MOST);
    if more > 0 {
        list.push(format!("{more} more"));
    }
    (!list.is_empty()).then(|| format!("not used: {}", list.join(", ")))
}

fn is_picture(path: &Path) -> bool {
    path.extension().is_some_and(|kind| PICTURES.iter().any(|known| kind.eq_ignore_ascii_case(known)))
}

/// A path as it is called in the capture.
fn named(folder: &Path, path: &Path) -> String {
    path.strip_prefix(folder).unwrap_or(path).display().to_string()
}

fn entries(folder: &Path) -> Vec<PathBuf> {
    fs::read_dir(folder).into_iter().flatten().flatten().map(|entry| entry.path()).collect()
}

#[cfg(test)]
mod tests;

//! Folders, and names of files as other programs and other systems wrote them.

use std::collections::{BTreeSet, HashMap};
use std::fs;
use std::path::{Component, Path, PathBuf};

use unicode_normalization::UnicodeNormalization;

use super::read::{quoted, unreadable};
use super::{CaptureError, Result};

/// Extensions of pictures. A name may lack its own (NeRF-synthetic), or have one more on the disk than in the list (BlenderNeRF).
pub(crate) const PICTURES: [&str; 3] = ["png", "jpg", "jpeg"];

/// Photographs of a capture that are looked for to see whether it belongs to a folder.
pub(super) const SAMPLE: usize = 8;

/// The path without `.`; `None` where it is absolute or leads out of its folder, whether `\` separates folders, as on Windows, or not.
pub(super) fn below(path: &str) -> Option<String> {
    let with_slashes = path.replace('\\', "/");
    let has_drive = matches!(with_slashes.as_bytes(), [drive, b':', b'/', ..] if drive.is_ascii_alphabetic());
    if has_drive || with_slashes.starts_with('/') || with_slashes.split('/').any(|part| part == "..") {
        return None;
    }
    let mut parts = Vec::new();
    for part in Path::new(path).components() {
        match part {
            Component::Normal(part) => parts.push(part.to_str()?),
            Component::CurDir => {}
            _ => return None,
        }
    }
    (!parts.is_empty()).then(|| parts.join("/"))
}

/// A name without its letter case and its Unicode form: file systems differ in both.
fn folded(name: &str) -> String {
    name.chars().flat_map(char::to_lowercase).nfc().collect()
}

/// Finds files by such names. Folders are listed once, and only where a name is not there as it is.
#[derive(Default)]
pub(crate) struct Names {
    /// The names in a folder, by their folded form.
    listed: HashMap<PathBuf, HashMap<String, Vec<String>>>,
}

impl Names {
    /// The path below `root` of the file that `stated` means: as it stands, with `/` for `\`, with one of `extensions` added; or else as the only
    /// file whose name differs from that in letter case or Unicode form alone.
    pub fn find(&mut self, root: &Path, stated: &str, extensions: &[&str]) -> Option<String> {
        let with_slashes = stated.replace('\\', "/");
        let forms = if with_slashes == stated { vec![with_slashes] } else { vec![stated.to_owned(), with_slashes] };
        let longer = |form: &String| extensions.iter().map(|extension| format!("{form}.{extension}")).collect();
        let longer: Vec<String> = forms.iter().flat_map(|form| -> Vec<String> { longer(form) }).collect();
        let candidates = [forms, longer].concat();
        let is_there = candidates.iter().find(|name| root.join(name).is_file());
        is_there.cloned().or_else(|| candidates.iter().find_map(|name| self.alike(root, name)))
    }

    fn alike(&mut self, root: &Path, name: &str) -> Option<String> {
        let mut found = String::new();
        for part in name.split('/').filter(|part| !["", "."].contains(part)) {
            let beside = self.listed.entry(root.join(&found)).or_insert_with_key(|folder| listing(folder));
            let alike = beside.get(&folded(part))?;
            let same = alike.iter().find(|name| *name == part);
            let [only] = same.map_or(alike.as_slice(), std::slice::from_ref) else { return None };
            found.push_str(if found.is_empty() { "" } else { "/" });
            found.push_str(only);
        }
        root.join(&found).is_file().then_some(found)
    }
}

fn listing(folder: &Path) -> HashMap<String, Vec<String>> {
    let mut names: HashMap<String, Vec<String>> = HashMap::new();
    for entry in fs::read_dir(folder).into_iter().flatten().flatten() {
        if let Ok(name) = entry.file_name().into_string() {
            names.entry(folded(&name)).or_default().push(name);
        }
    }
    names
}

/// What lies where a file is missing, or in the nearest folder above that is there.
pub(super) fn beside(missing: &Path) -> String {
    let folder = missing.ancestors().skip(1).find(|folder| folder.is_dir()).unwrap_or(Path::new("."));
    let names = listing(folder).into_values().flatten().filter(|name| !name.starts_with('.'));
    let names: BTreeSet<String> = names.map(|name| quoted(&name)).collect();
    let some = names.iter().take(3).cloned().collect::<Vec<_>>().join(", ");
    match names.len() {
        0 => format!("{} is empty", folder.display()),
        1..=3 => format!("{} holds {some}", folder.display()),
        count => format!("{} holds {some} and {} more", folder.display(), count - 3),
    }
}

/// The error for photographs that `file` lists, of which these are missing.
pub(super) fn missing_photographs(missing: &[PathBuf], of: usize, file: &Path) -> CaptureError {
    let first = missing.first().cloned().unwrap_or_default();
    let detail = format!(
        "{} of {of} photographs that it lists are missing, the first is {}: {}. Put the photographs where it lists them: below \
         `images/`, or for JSON below its folder",
        missing.len(),
        first.display(),
        beside(&first)
    );
    CaptureError::content(file, detail)
}

/// The folder that holds a file or folder.
pub(super) fn parent(path: &Path) -> PathBuf {
    match (path.parent(), path.file_name()) {
        (Some(parent), Some(_)) if parent.as_os_str().is_empty() => PathBuf::from("."),
        (Some(parent), Some(_)) => parent.to_owned(),
        _ => path.join(".."),
    }
}

/// What is in a folder; nothing if it cannot be listed.
pub(super) fn entries(folder: &Path) -> impl Iterator<Item = PathBuf> {
    fs::read_dir(folder).into_iter().flatten().flatten().map(|entry| entry.path())
}

/// The folders in a folder that are not hidden, in order.
pub(super) fn children(folder: &Path) -> Vec<PathBuf> {
    let is_hidden = |path: &Path| path.file_name().is_some_and(|name| name.to_string_lossy().starts_with('.'));
    let mut found: Vec<PathBuf> = entries(folder).filter(|path| path.is_dir() && !is_hidden(path)).collect();
    found.sort();
    found
}

/// Names of files in a folder and its subfolders, in order, without hidden ones and those in folders of the names
/// `without`. An error if a folder cannot be listed.
pub(super) fn files_below(folder: &Path, without: &[&str]) -> Result<Vec<String>> {
    const DEEPEST: usize = 8;
    let (mut found, mut folders) = (Vec::new(), vec![(folder.to_owned(), String::new(), 0)]);
    while let Some((folder, prefix, depth)) = folders.pop() {
        let failed = |reason| unreadable(&folder, reason);
        for entry in fs::read_dir(&folder).map_err(failed)? {
            let entry = entry.map_err(failed)?;
            // Formats of cameras hold names in UTF-8.
            let Ok(name) = entry.file_name().into_string() else { continue };
            match entry.path().is_dir() {
                _ if name.starts_with('.') => {}
                true if depth == DEEPEST || without.contains(&name.as_str()) => {}
                true => folders.push((entry.path(), format!("{prefix}{name}/"), depth + 1)),
                false => found.push(format!("{prefix}{name}")),
            }
        }
    }
    found.sort();
    Ok(found)
}

#[cfg(test)]
mod tests;

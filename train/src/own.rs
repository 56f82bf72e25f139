//! Files that this program wrote, known by their names and their content. It deletes no others.

use std::collections::BTreeMap;
use std::fs::{self, File};
use std::io::{self, Read};
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

/// The files that were written into a folder: their paths below it, with `/`, and the SHA-256 of each.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct OwnFiles(BTreeMap<String, String>);

impl OwnFiles {
    /// Adds all files below `folder/part`, as they are now, under the name `named`. Earlier entries below that name are forgotten.
    ///
    /// # Errors
    /// If one cannot be read.
    pub fn add(&mut self, folder: &Path, part: &str, named: &str) -> io::Result<()> {
        self.0.retain(|name, _| !is_below(name, named));
        let from = folder.join(part);
        for file in files_below(&from)? {
            let rest = name_below(&from, &file);
            let name = if rest.is_empty() { named.to_owned() } else { format!("{named}/{rest}") };
            self.0.insert(name, digest(&file)?);
        }
        Ok(())
    }

    /// Whether a file is one of these, and still as it was written.
    pub fn hold(&self, folder: &Path, file: &Path) -> bool {
        let known = self.0.get(&name_below(folder, file));
        // A link is none, wherever it leads.
        known.is_some_and(|known| !file.is_symlink() && digest(file).is_ok_and(|found| *known == found))
    }
}

fn is_below(name: &str, part: &str) -> bool {
    name.strip_prefix(part).is_some_and(|rest| rest.is_empty() || rest.starts_with('/'))
}

/// The path below a folder, with `/`.
pub fn name_below(folder: &Path, file: &Path) -> String {
    let below = file.strip_prefix(folder).unwrap_or(file);
    below.components().map(|part| part.as_os_str().to_string_lossy()).collect::<Vec<_>>().join("/")
}

/// All files below a folder, or the file itself, in order. Links are files: where they lead is not looked at. Empty if there is nothing.
///
/// # Errors
/// If a folder cannot be listed.
pub fn files_below(path: &Path) -> io::Result<Vec<PathBuf>> {
    let Ok(metadata) = fs::symlink_metadata(path) else { return Ok(Vec::new()) };
    if !metadata.is_dir() {
        return Ok(vec![path.to_owned()]);
    }
    let mut entries = fs::read_dir(path)?.map(|entry| Ok(entry?.path())).collect::<io::Result<Vec<_>>>()?;
    entries.sort();
    Ok(entries.iter().map(|entry| files_below(entry)).collect::<io::Result<Vec<_>>>()?.concat())
}

/// Removes files, then the folders at and below `root` that are empty.
///
/// # Errors
/// If a file cannot be removed.
pub fn remove(root: &Path, files: &[PathBuf]) -> io::Result<()> {
    files.iter().try_for_each(fs::remove_file)?;
    remove_empty(root);
    Ok(())
}

fn remove_empty(folder: &Path) {
    if !folder.is_symlink() && folder.is_dir() {
        fs::read_dir(folder).into_iter().flatten().flatten().for_each(|entry| remove_empty(&entry.path()));
        // Fails where something is left, which is the point.
        let _ = fs::remove_dir(folder);
    }
}

/// Whether a file begins with these bytes, or is a beginning of them: one that a killed process was writing.
pub fn begins_with(file: &Path, bytes: &[u8]) -> bool {
    let mut found = Vec::new();
    let read = File::open(file).and_then(|file| file.take(bytes.len() as u64).read_to_end(&mut found));
    read.is_ok() && bytes.starts_with(&found)
}

/// SHA-256 of a file, in hexadecimal digits.
fn digest(file: &Path) -> io::Result<String> {
    let mut hash = Sha256::new();
    io::copy(&mut File::open(file)?, &mut hash)?;
    Ok(format!("{:x}", hash.finalize()))
}

#[cfg(test)]
mod tests;

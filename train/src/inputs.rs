//! The rule for every file that a subcommand writes: it is none of the files that the same command reads.
//!
//! Files are compared by what they are, not by how they are called: a link, `..`, a hard link or, on file systems that ignore it,
//! another letter case leads to the same file.

use std::collections::HashMap;
use std::path::{Component, Path, PathBuf};

use anyhow::{Result, bail};
use file_id::{FileId, get_file_id};
use splat_model::capture::Capture;
use splat_model::effects::survey::input_files;

/// What a path leads to.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
enum Identity {
    Existing(FileId),
    /// The path without links: of what does not exist yet, and where a file system gives no lasting numbers.
    Place(PathBuf),
}

impl Identity {
    fn all(path: &Path) -> impl Iterator<Item = Self> {
        let place = place(path);
        get_file_id(&place).ok().map(Self::Existing).into_iter().chain([Self::Place(place)])
    }
}

/// The absolute path without links, as far as it exists, and without `..`: folders that do not exist yet will be ordinary ones.
fn place(path: &Path) -> PathBuf {
    let path = std::path::absolute(path).unwrap_or_else(|_| path.to_owned());
    if let Ok(found) = path.canonicalize() {
        return found;
    }
    match (path.parent(), path.components().next_back()) {
        (Some(folder), Some(Component::Normal(name))) => place(folder).join(name),
        (Some(folder), Some(Component::ParentDir)) => place(folder).parent().unwrap_or(folder).to_owned(),
        _ => path,
    }
}

/// The files and folders that a command reads, each as the user knows it.
#[derive(Clone, Debug, Default)]
pub struct Inputs {
    known: HashMap<Identity, PathBuf>,
}

impl Inputs {
    /// Takes these paths as inputs.
    pub fn of<P: AsRef<Path>>(paths: impl IntoIterator<Item = P>) -> Self {
        Self::default().and(paths)
    }

    /// Takes these paths as inputs too.
    pub fn and<P: AsRef<Path>>(mut self, paths: impl IntoIterator<Item = P>) -> Self {
        for path in paths {
            let path = path.as_ref();
            self.known.extend(Identity::all(path).map(|identity| (identity, path.to_owned())));
        }
        self
    }

    /// Takes all files of a capture as inputs too: its own, photographs, masks and depth maps.
    pub fn and_capture(self, capture: &Capture) -> Self {
        self.and(input_files(capture))
    }

    /// The input that a path leads to, if it is one.
    pub fn find(&self, path: &Path) -> Option<&Path> {
        // Most commands that write pictures write many.
        if self.known.is_empty() {
            None
        } else {
            Identity::all(path).find_map(|of| self.known.get(&of).map(PathBuf::as_path))
        }
    }

    /// Refuses to write, or to remove, any of these files that is an input. An error if one is; the message names it and the input.
    pub fn spare<P: AsRef<Path>>(&self, outputs: impl IntoIterator<Item = P>) -> Result<()> {
        for output in outputs {
            let (output, found) = (output.as_ref().display(), self.find(output.as_ref()));
            let Some(input) = found.map(Path::display) else { continue };
            let same = if input.to_string() == output.to_string() { String::new() } else { format!(" ({input})") };
            bail!(
                "{output} is an input of this command{same}, which would be lost: nothing is written; choose another folder or \
                 name for the results"
            );
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests;

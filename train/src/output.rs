//! Output files that appear complete or not at all: each is written under another name in the same folder, then renamed.

use std::collections::BTreeSet;
use std::ffi::OsStr;
use std::fs::{self, File};
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use splat_model::replace::{name_of_temporary, replace};

use crate::inputs::Inputs;

/// Default parent folder of the runs, each of which has its own folder.
pub const OUT: &str = "out";

/// A writable folder for results, none of which replaces an input.
#[derive(Debug)]
pub struct OutputFolder {
    path: PathBuf,
    inputs: Inputs,
    /// Files that are to be written.
    files: BTreeSet<PathBuf>,
}

impl OutputFolder {
    /// Creates the folder if necessary and checks that it can hold `files` and `folders`, so that a long run does not
    /// fail at its end, and that no file is an input. An error if a file is one of `inputs`, before anything is
    /// written; if the folder cannot be created or written to, or something of another kind has one of those names.
    pub fn prepare<F: AsRef<Path>>(
        path: &Path,
        inputs: Inputs,
        files: impl IntoIterator<Item = F>,
        folders: &[&str],
    ) -> Result<Self> {
        let files: BTreeSet<PathBuf> = files.into_iter().map(|name| path.join(name)).collect();
        inputs.spare(&files)?;
        let shown = path.display();
        fs::create_dir_all(path).with_context(|| {
            format!(
                "cannot make the output folder {shown}: choose another with `--out`, or move away the file in its place"
            )
        })?;
        // Another process never has a file of this name.
        tempfile::Builder::new().prefix(".splat-trial-").tempfile_in(path).with_context(|| {
            format!("cannot write to the output folder {shown}: fix its permissions, or choose another with `--out`")
        })?;
        let folders = folders.iter().map(|name| (path.join(name), true));
        for (taken, folder_wanted) in files.iter().map(|file| (file.clone(), false)).chain(folders) {
            if taken.exists() && taken.is_dir() != folder_wanted {
                let (found, wanted) = if folder_wanted { ("a file", "folder") } else { ("a folder", "file") };
                let shown = taken.display();
                bail!(
                    "{shown} is {found}, but a {wanted} is to be written there: move it away, or choose another `--out`"
                );
            }
        }
        Ok(Self { path: path.to_owned(), inputs, files })
    }

    /// Path of the folder.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Returns the path of a file or folder in it.
    pub fn join(&self, name: impl AsRef<Path>) -> PathBuf {
        self.path.join(name)
    }

    /// Removes what a killed process left of the files that are to be written. Only for a process that owns the folder alone.
    pub fn sweep(&self) {
        let folders: BTreeSet<&Path> = self.files.iter().filter_map(|file| file.parent()).collect();
        for entry in folders.into_iter().filter_map(|folder| fs::read_dir(folder).ok()).flatten().flatten() {
            let (path, name) = (entry.path(), entry.file_name());
            let of = name.to_str().and_then(name_of_temporary);
            if of.is_some_and(|name| self.files.contains(&path.with_file_name(name))) {
                // A leftover file only takes up space.
                let _ = fs::remove_file(path);
            }
        }
    }

    /// Writes one file, replacing an existing one that is no input. See [`write()`]. An error as for [`write()`], and
    /// if the file is an input.
    pub fn write(&self, name: impl AsRef<Path>, fill: impl FnOnce(&mut BufWriter<File>) -> Result<()>) -> Result<()> {
        write(&self.spared(name)?, fill)
    }

    /// Returns the path of a file to be written in it. An error if the file is an input.
    pub fn spared(&self, name: impl AsRef<Path>) -> Result<PathBuf> {
        let path = self.join(name);
        self.inputs.spare([&path])?;
        Ok(path)
    }
}

/// Makes the folder of a file that is to be written, which is no input. An error if the file is one of `inputs`, or its
/// folder cannot be made.
pub fn prepare_file(path: &Path, inputs: &Inputs) -> Result<()> {
    inputs.spare([path])?;
    let folder = path.parent().unwrap_or(path);
    fs::create_dir_all(folder).with_context(|| format!("cannot make the folder for {}", path.display()))
}

/// Returns the first of `parent/NAME`, `parent/NAME-2`, `parent/NAME-3` and so on that does not exist, or is a folder
/// that holds at most these entries.
pub fn free_folder(parent: &Path, name: &OsStr, may_hold: &[&str]) -> PathBuf {
    let is_free = |path: &Path| match fs::read_dir(path) {
        Ok(mut entries) => {
            entries.all(|entry| entry.is_ok_and(|entry| may_hold.iter().any(|name| entry.file_name() == *name)))
        }
        // An existing path that cannot be listed is not free. Where nothing can be created, creating the folder reports it.
        Err(_) => !path.exists(),
    };
    numbered(parent, name, is_free)
}

/// Returns the first of `parent/NAME`, `parent/NAME-2`, `parent/NAME-3` and so on that is accepted.
pub fn numbered(parent: &Path, name: &OsStr, accepts: impl Fn(&Path) -> bool) -> PathBuf {
    let mut path = parent.join(name);
    for number in 2.. {
        if accepts(&path) {
            break;
        }
        let mut numbered = name.to_owned();
        numbered.push(format!("-{number}"));
        path = parent.join(numbered);
    }
    path
}

/// Returns the last component of a path, for titles.
pub fn last_name(path: &Path) -> String {
    path.file_name().unwrap_or(path.as_os_str()).to_string_lossy().into_owned()
}

/// Formats a number with so many significant digits.
pub fn short(value: f64, digits: usize) -> String {
    match value.abs() {
        0.0 => "0".into(),
        size if !(1e-3..10_f64.powi(digits as i32 + 2)).contains(&size) => format!("{value:.*e}", digits - 1),
        size => format!("{value:.*}", (digits as i32 - 1 - size.log10().floor() as i32).max(0) as usize),
    }
}

/// Writes a file: `fill` writes it under a temporary name, and the complete file is renamed to its own. Missing parent
/// folders are created. No temporary file is left behind unless the process is killed. An error if a folder or the file
/// cannot be written, `fill` fails, or an empty file would replace another.
pub fn write(path: &Path, fill: impl FnOnce(&mut BufWriter<File>) -> Result<()>) -> Result<()> {
    let folder = path.parent().map_or(Ok(()), fs::create_dir_all).map_err(anyhow::Error::from);
    let written = folder.and_then(|()| replace(path, fill));
    let shown = path.display();
    written.with_context(|| format!("cannot write {shown}: check that its folder can be written to and has room left"))
}

/// Writes a file of lines. See [`write()`]. An error as for [`write()`].
pub fn write_lines(path: &Path, lines: &[String]) -> Result<()> {
    write(path, |file| Ok(lines.iter().try_for_each(|line| writeln!(file, "{line}"))?))
}

#[cfg(test)]
mod tests;

//! Output files that appear complete or not at all: each is written under another name in the same folder, then
//! renamed.

use std::ffi::OsStr;
use std::fs::{self, File};
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};
use std::{iter, process};

use anyhow::{Context, Result, bail};
use splat_model::replace::{is_temporary, temporary_name};

/// A writable folder for results.
#[derive(Debug)]
pub struct OutputFolder {
    path: PathBuf,
}

impl OutputFolder {
    /// Creates the folder if necessary and checks that it can hold `files` and `folders`, so that a long run does not
    /// fail at its end.
    ///
    /// # Errors
    /// If the folder cannot be created or written to, or something of another kind has one of those names.
    pub fn prepare(path: &Path, files: &[&str], folders: &[&str]) -> Result<Self> {
        let shown = path.display();
        fs::create_dir_all(path).with_context(|| {
            format!(
                "cannot make the output folder {shown}: choose another with `--out`, or move away the file in its place"
            )
        })?;
        let trial = path.join(format!(".splat-trial-{}", process::id()));
        fs::write(&trial, b"").and_then(|()| fs::remove_file(&trial)).with_context(|| {
            format!("cannot write to the output folder {shown}: fix its permissions, or choose another with `--out`")
        })?;
        for (names, folder_wanted) in [(files, false), (folders, true)] {
            for taken in names.iter().map(|name| path.join(name)).filter(|name| name.exists()) {
                if taken.is_dir() != folder_wanted {
                    let (found, wanted) = if folder_wanted { ("a file", "folder") } else { ("a folder", "file") };
                    let shown = taken.display();
                    bail!(
                        "{shown} is {found}, but a {wanted} is to be written there: move it away, or choose another `--out`"
                    );
                }
            }
        }
        Ok(Self { path: path.to_owned() })
    }

    /// Path of the folder.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Returns the path of a file or folder in it.
    pub fn join(&self, name: impl AsRef<Path>) -> PathBuf {
        self.path.join(name)
    }

    /// Removes temporary files that a killed process left here and in these folders. Only for a process that owns them
    /// alone.
    pub fn sweep(&self, folders: &[&str]) {
        let all = iter::once(self.path.clone()).chain(folders.iter().map(|name| self.join(name)));
        for entry in all.filter_map(|folder| fs::read_dir(folder).ok()).flatten().flatten() {
            if entry.file_name().to_str().is_some_and(is_temporary) {
                // A leftover file only takes up space.
                let _ = fs::remove_file(entry.path());
            }
        }
    }

    /// Writes one file, replacing an existing one. See [`write()`].
    ///
    /// # Errors
    /// The errors of [`write()`].
    pub fn write(&self, name: impl AsRef<Path>, fill: impl FnOnce(&mut BufWriter<File>) -> Result<()>) -> Result<()> {
        write(&self.join(name), fill)
    }
}

/// Returns the first of `parent/NAME`, `parent/NAME-2`, `parent/NAME-3` and so on that does not exist, or is a folder
/// that holds at most these entries.
pub fn free_folder(parent: &Path, name: &OsStr, may_hold: &[&str]) -> PathBuf {
    let is_free = |path: &Path| match fs::read_dir(path) {
        Ok(mut entries) => {
            entries.all(|entry| entry.is_ok_and(|entry| may_hold.iter().any(|name| entry.file_name() == *name)))
        }
        // An existing path that cannot be listed is not free. Where nothing can be created, creating the folder reports
        // it.
        Err(_) => !path.exists(),
    };
    let mut path = parent.join(name);
    for number in 2.. {
        if is_free(&path) {
            break;
        }
        let mut numbered = name.to_owned();
        numbered.push(format!("-{number}"));
        path = parent.join(numbered);
    }
    path
}

/// Writes a file: `fill` writes it under a temporary name, and the complete file is renamed to its own. Missing parent
/// folders are created. No temporary file is left behind unless the process is killed.
///
/// # Errors
/// If a folder or the file cannot be written, or `fill` fails.
pub fn write(path: &Path, fill: impl FnOnce(&mut BufWriter<File>) -> Result<()>) -> Result<()> {
    let written = temporary_name(path).map_err(Into::into).and_then(|temporary| {
        if let Some(folder) = path.parent() {
            fs::create_dir_all(folder)?;
        }
        let written = fill_and_rename(&temporary, path, fill);
        if written.is_err() {
            // Best effort: the first error is the one to report.
            let _ = fs::remove_file(&temporary);
        }
        written
    });
    let shown = path.display();
    written.with_context(|| format!("cannot write {shown}: check that its folder can be written to and has room left"))
}

fn fill_and_rename(temporary: &Path, path: &Path, fill: impl FnOnce(&mut BufWriter<File>) -> Result<()>) -> Result<()> {
    let mut file = BufWriter::new(File::create(temporary)?);
    fill(&mut file)?;
    file.flush()?;
    // Closed before the rename, which some systems refuse for open files.
    drop(file);
    Ok(fs::rename(temporary, path)?)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn names_in(folder: &Path) -> Vec<String> {
        let entries = fs::read_dir(folder).unwrap();
        entries.map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect()
    }

    #[test]
    fn a_file_is_replaced_whole() {
        let folder = tempfile::tempdir().unwrap();
        let out = OutputFolder::prepare(folder.path(), &["a.txt"], &[]).unwrap();
        for text in ["first, longer", "second"] {
            out.write("a.txt", |file| Ok(file.write_all(text.as_bytes())?)).unwrap();
            assert_eq!(fs::read_to_string(out.join("a.txt")).unwrap(), text);
        }
        assert_eq!(names_in(folder.path()), ["a.txt"]);
    }

    #[test]
    fn what_a_killed_process_left_is_swept_away() {
        let folder = tempfile::tempdir().unwrap();
        let out = OutputFolder::prepare(folder.path(), &[], &["views"]).unwrap();
        let kept = [".hidden", "a.tmp-7-0", ".a.tmp-x-0", ".tmp-7-0", "views/b.png"];
        for name in [&kept[..], &[".a.txt.tmp-7-0", "views/.b.png.tmp-123-45"]].concat() {
            out.write(name, |_| Ok(())).unwrap();
        }
        fs::write(temporary_name(&out.join("scene.ply")).unwrap(), b"a half").unwrap();
        out.sweep(&["views", "none"]);
        let mut left = names_in(folder.path());
        left.sort();
        assert_eq!(left, [".a.tmp-x-0", ".hidden", ".tmp-7-0", "a.tmp-7-0", "views"]);
        assert_eq!(names_in(&out.join("views")), ["b.png"]);
    }

    #[test]
    fn a_folder_is_free_until_something_is_in_it() {
        let folder = tempfile::tempdir().unwrap();
        let free = |may_hold: &[&str]| free_folder(folder.path(), OsStr::new("fox.v1"), may_hold);
        let path = |name: &str| folder.path().join(name);
        assert_eq!(free(&[]), path("fox.v1"));
        fs::create_dir(path("fox.v1")).unwrap();
        assert_eq!(free(&[]), path("fox.v1"), "empty");
        fs::create_dir(path("fox.v1/checkpoints")).unwrap();
        assert_eq!(free(&[]), path("fox.v1-2"));
        assert_eq!(free(&["checkpoints"]), path("fox.v1"));
        fs::write(path("fox.v1-2"), "a file").unwrap();
        fs::create_dir_all(path("fox.v1-3/views")).unwrap();
        assert_eq!(free(&[]), path("fox.v1-4"));
        // Nothing can be below a file; the error is left to whoever creates the folder.
        assert_eq!(free_folder(&path("fox.v1-2"), OsStr::new("a"), &[]), path("fox.v1-2/a"));
    }

    #[test]
    fn a_failure_leaves_the_old_file_and_nothing_else() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.txt");
        write(&path, |file| Ok(file.write_all(b"good")?)).unwrap();
        let error = write(&path, |file| {
            file.write_all(b"ba")?;
            bail!("the sun went down")
        });
        let error = format!("{:#}", error.unwrap_err());
        assert!(error.contains("a.txt") && error.contains("the sun went down"), "{error}");
        assert_eq!(fs::read_to_string(&path).unwrap(), "good");
        assert_eq!(names_in(folder.path()), ["a.txt"]);
    }

    #[test]
    fn what_cannot_be_written_is_found_beforehand() {
        let folder = tempfile::tempdir().unwrap();
        let taken = folder.path().join("taken");
        fs::write(&taken, "").unwrap();
        fs::create_dir(folder.path().join("metrics.json")).unwrap();
        for (path, files, folders) in [
            (taken.clone(), vec![], vec![]),
            (taken.join("below"), vec![], vec![]),
            (folder.path().to_owned(), vec!["metrics.json"], vec![]),
            (folder.path().to_owned(), vec![], vec!["taken"]),
        ] {
            let error = OutputFolder::prepare(&path, &files, &folders).unwrap_err().to_string();
            let named = files.first().or(folders.first()).map_or(path.clone(), |name| path.join(name));
            assert!(error.contains(named.to_str().unwrap()) && error.contains("--out"), "{error}");
        }
    }
}

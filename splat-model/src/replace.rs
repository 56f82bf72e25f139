//! Atomic writing of files: each is written under a temporary name in the same folder, then renamed.

use std::ffi::OsString;
use std::fs::{self, File};
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};

/// Part of the names of files in progress, before the process id.
const TEMPORARY: &str = ".tmp-";

/// An action that the operating system refused.
#[derive(Debug)]
pub(crate) struct Refused {
    /// The action, with the remedy if there is one.
    pub action: &'static str,
    /// The system's reason.
    pub source: io::Error,
}

/// Writes a file by calling `fill`. It replaces an existing file once it is complete and on the disk; nothing at all replaces none. No
/// temporary file is left behind unless the process is killed.
pub(crate) fn replace(path: &Path, fill: impl FnOnce(&mut BufWriter<File>) -> io::Result<()>) -> Result<(), Refused> {
    let refused = |action| move |source| Refused { action, source };
    let temporary = temporary_name(path).map_err(refused("name the file"))?;
    let written = write_file(&temporary, fill)
        .map_err(refused("write the scene (is the folder there, writable, and not full?)"))
        .and_then(|()| fs::rename(&temporary, path).map_err(refused("rename the finished file")));
    if written.is_err() {
        // Best effort: the first error is the one to report.
        let _ = fs::remove_file(&temporary);
    }
    written
}

/// Returns a hidden name in the same folder for a file in progress, because a rename is atomic only within a file system. The
/// process id and a counter keep two writers of the same file apart.
///
/// # Errors
/// If the path names no file.
pub fn temporary_name(path: &Path) -> io::Result<PathBuf> {
    static COUNTER: AtomicU64 = AtomicU64::new(0);
    let name = path.file_name().ok_or_else(|| io::Error::new(io::ErrorKind::InvalidInput, "the path names no file"))?;
    let mut temporary = OsString::from(".");
    temporary.push(name);
    temporary.push(format!("{TEMPORARY}{}-{}", std::process::id(), COUNTER.fetch_add(1, Ordering::Relaxed)));
    Ok(path.with_file_name(temporary))
}

/// The name that [`temporary_name`] made this one of, if it did. A process that was killed leaves such files.
pub fn name_of_temporary(name: &str) -> Option<&str> {
    let (name, writer) = name.strip_prefix('.')?.rsplit_once(TEMPORARY)?;
    writer.split('-').all(|number| number.parse::<u64>().is_ok()).then_some(name)
}

fn write_file(path: &Path, fill: impl FnOnce(&mut BufWriter<File>) -> io::Result<()>) -> io::Result<()> {
    let mut out = BufWriter::with_capacity(1 << 20, File::create(path)?);
    fill(&mut out)?;
    out.flush()?;
    if out.get_ref().metadata()?.len() == 0 {
        return Err(io::Error::other("nothing was written"));
    }
    // Without this, a power cut after the rename could leave an empty file in place of a good one.
    out.get_ref().sync_all()
}

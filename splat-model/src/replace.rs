//! Scene files appear whole or not at all: each is written under another name in the same folder, then renamed.

use std::ffi::OsString;
use std::fs::{self, File};
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};

/// What the operating system refused.
#[derive(Debug)]
pub(crate) struct Refused {
    /// What was tried, with the remedy where there is one.
    pub action: &'static str,
    /// The system's reason.
    pub source: io::Error,
}

/// Fills a file, which replaces the one of that name once all of it is on the disk. No temporary file is left behind.
pub(crate) fn replace(path: &Path, fill: impl FnOnce(&mut BufWriter<File>) -> io::Result<()>) -> Result<(), Refused> {
    let refused = |action| move |source| Refused { action, source };
    let temporary = temporary_name(path).map_err(refused("name the file"))?;
    let written = write_file(&temporary, fill)
        .map_err(refused("write the scene (is the folder there, writable, and not full?)"))
        .and_then(|()| fs::rename(&temporary, path).map_err(refused("put the finished file under its name")));
    if written.is_err() {
        // Best effort: the first error is the one to report.
        let _ = fs::remove_file(&temporary);
    }
    written
}

/// A name in the same folder, because a rename is atomic only within a file system. Process and counter keep two
/// writers of the same scene apart.
fn temporary_name(path: &Path) -> io::Result<PathBuf> {
    static COUNTER: AtomicU64 = AtomicU64::new(0);
    let name = path.file_name().ok_or_else(|| io::Error::new(io::ErrorKind::InvalidInput, "the path names no file"))?;
    let mut temporary = OsString::from(".");
    temporary.push(name);
    temporary.push(format!(".{}-{}.tmp", std::process::id(), COUNTER.fetch_add(1, Ordering::Relaxed)));
    Ok(path.with_file_name(temporary))
}

fn write_file(path: &Path, fill: impl FnOnce(&mut BufWriter<File>) -> io::Result<()>) -> io::Result<()> {
    let mut out = BufWriter::with_capacity(1 << 20, File::create(path)?);
    fill(&mut out)?;
    out.flush()?;
    // Else a power cut after the rename could leave an empty file where a good one was.
    out.get_ref().sync_all()
}

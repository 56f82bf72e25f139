//! Temporary folders for cases that read and write files.

use std::error::Error;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use std::process;
use std::sync::atomic::{AtomicU64, Ordering};

use splat_demo::{DemoOptions, write};
use splat_model::capture::{Capture, CaptureError, Photo, load_all};

/// A folder that is removed when it is dropped.
#[derive(Debug)]
pub struct TemporaryFolder(PathBuf);

impl TemporaryFolder {
    /// Creates an empty folder below the system's folder for temporary files.
    ///
    /// # Errors
    /// If the folder cannot be created.
    pub fn new() -> io::Result<Self> {
        static COUNTER: AtomicU64 = AtomicU64::new(0);
        let number = COUNTER.fetch_add(1, Ordering::Relaxed);
        let path = std::env::temp_dir().join(format!("splat-hard-cases-{}-{number}", process::id()));
        fs::create_dir_all(&path)?;
        Ok(Self(path))
    }

    /// Path of the folder.
    pub fn path(&self) -> &Path {
        &self.0
    }
}

impl Drop for TemporaryFolder {
    fn drop(&mut self) {
        // Files left there do no harm.
        let _ = fs::remove_dir_all(&self.0);
    }
}

/// Writes the demo capture and reads it back, with its photographs.
///
/// # Errors
/// If the capture cannot be written or read.
pub fn demo(folder: &Path, options: &DemoOptions) -> Result<(Capture, Vec<Photo>), Box<dyn Error>> {
    write(folder, options)?;
    let capture = Capture::load(folder)?;
    let photos = photographs(&capture)?;
    Ok((capture, photos))
}

/// Reads all photographs of a capture, at full size.
///
/// # Errors
/// If a photograph cannot be read.
pub fn photographs(capture: &Capture) -> Result<Vec<Photo>, CaptureError> {
    load_all(&capture.views, None, |_| {})
}

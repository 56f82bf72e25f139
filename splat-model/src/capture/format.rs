//! Formats of captures: those of this library, and those that a program registers.

use std::path::{Path, PathBuf};
use std::sync::{Arc, PoisonError, RwLock};

use super::names::parent;
use super::{Capture, Pictures, Result, colmap, exports, transforms};

/// A format of captures: where its cameras are, and how they are read.
pub trait CaptureFormat: Send + Sync {
    /// The name, as `splat inspect` gives it.
    fn name(&self) -> &'static str;

    /// The cameras at the format's usual place of a folder: files or folders, of which several are models of one capture. Empty if there are
    /// none. Called for folders below a capture's too.
    fn usual(&self, folder: &Path) -> Vec<PathBuf>;

    /// All cameras directly in a folder without any at a usual place.
    fn here(&self, _folder: &Path) -> Vec<Vec<PathBuf>> {
        Vec::new()
    }

    /// The cameras that a file is or belongs to. Empty if it is none of this format.
    fn of_file(&self, file: &Path) -> Vec<PathBuf> {
        let usual = self.usual(&parent(file));
        if usual.iter().any(|path| path == file) { usual } else { Vec::new() }
    }

    /// Reads cameras, for example into [`Capture::near_zero`].
    ///
    /// # Errors
    /// If they, or what belongs to them, cannot be read, or hold what no capture can have.
    fn load(&self, cameras: &[PathBuf], pictures: &Pictures) -> Result<Capture>;
}

static REGISTERED: RwLock<Vec<Arc<dyn CaptureFormat>>> = RwLock::new(Vec::new());

/// Adds a format to those that this process reads, before the library's.
///
/// # Panics
/// If there is a format of that name.
pub fn register(format: Arc<dyn CaptureFormat>) {
    let taken = formats().iter().any(|other| other.name() == format.name());
    assert!(!taken, "there are two formats of captures named `{}`", format.name());
    REGISTERED.write().unwrap_or_else(PoisonError::into_inner).push(format);
}

/// All formats, in the order in which they are tried.
pub(super) fn formats() -> Vec<Arc<dyn CaptureFormat>> {
    let mut all = REGISTERED.read().unwrap_or_else(PoisonError::into_inner).clone();
    all.extend([Arc::new(colmap::Colmap) as Arc<dyn CaptureFormat>, Arc::new(transforms::Json)]);
    all.extend(exports::formats());
    all
}

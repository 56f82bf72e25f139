//! What the tests of several formats share.

use std::io::Write;
use std::path::PathBuf;

/// The folder of a real capture below `SPLAT_DATA_DIR`, or none, after a line that says so.
pub(crate) fn real_capture(name: &str) -> Option<PathBuf> {
    let standard = concat!(env!("CARGO_MANIFEST_DIR"), "/../../shared/data");
    let data = std::env::var_os("SPLAT_DATA_DIR").map_or_else(|| PathBuf::from(standard), PathBuf::from);
    let folder = data.join(name);
    if folder.exists() {
        return Some(folder);
    }
    // Written past the test harness, which swallows what passing tests print, and in one piece.
    let line = format!("SKIPPED: no {}; set SPLAT_DATA_DIR to the real captures\n", folder.display());
    std::io::stderr().write_all(line.as_bytes()).unwrap();
    None
}

/// Error messages are part of the interface: each must hold what the reader needs.
#[track_caller]
pub(super) fn assert_says(message: &str, parts: &[&str]) {
    for part in parts {
        assert!(message.contains(part), "{part:?} is not in: {message}");
    }
}

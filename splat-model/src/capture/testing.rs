//! Helpers that tests of several formats share.

use std::io::Write;
use std::path::PathBuf;

/// The folder of a real capture below `SPLAT_DATA_DIR` (`docs/CAPTURES.md`), or `None` after a message that the test is
/// skipped.
pub(crate) fn real_capture(name: &str) -> Option<PathBuf> {
    let folder = std::env::var_os("SPLAT_DATA_DIR").map(|data| PathBuf::from(data).join(name));
    let line = match folder {
        Some(folder) if folder.is_dir() => return Some(folder),
        Some(folder) => {
            format!("SKIPPED: no {name}: {} is no folder (SPLAT_DATA_DIR, docs/CAPTURES.md)\n", folder.display())
        }
        None => format!("SKIPPED: no {name}: SPLAT_DATA_DIR is not set (docs/CAPTURES.md)\n"),
    };
    // Written directly to stderr and in one piece, because the test harness hides the output of passing tests.
    std::io::stderr().write_all(line.as_bytes()).unwrap();
    None
}

/// Checks that a message holds every part. Error messages are part of the interface.
#[track_caller]
pub(crate) fn assert_says(message: &str, parts: &[&str]) {
    for part in parts {
        assert!(message.contains(part), "{part:?} is not in: {message}");
    }
}

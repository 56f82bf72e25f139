//! Optional data outside the repository: real captures and larger reference vectors.

use std::io::Write;
use std::path::{Path, PathBuf};

/// Returns a folder of `SPLAT_DATA_DIR`, whose layout `docs/CAPTURES.md` describes: `fox_small` and the other captures, and
/// `reference`. `None` if the folder does not exist, after a line that says so.
pub fn optional_data(name: &str) -> Option<PathBuf> {
    match find(std::env::var_os("SPLAT_DATA_DIR").as_deref().map(Path::new), name) {
        Ok(folder) => Some(folder),
        Err(line) => {
            announce(&line);
            None
        }
    }
}

/// Returns the folder, or a line that says why there is none.
fn find(data: Option<&Path>, name: &str) -> Result<PathBuf, String> {
    let Some(data) = data else {
        return Err(format!("SKIPPED: no {name}: SPLAT_DATA_DIR is not set (docs/CAPTURES.md)"));
    };
    let folder = data.join(name);
    if folder.is_dir() {
        return Ok(folder);
    }
    Err(format!("SKIPPED: no {name}: {} is not a folder (SPLAT_DATA_DIR, docs/CAPTURES.md)", folder.display()))
}

/// Writes a line that the test harness does not hide, so that skipped tests and measurements are visible.
pub fn announce(line: &str) {
    // One write per line, because tests run in parallel. A test must not fail because its log cannot be written.
    let _ = std::io::stderr().write_all(format!("{line}\n").as_bytes());
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_not_there_is_named_in_one_line() {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR"));
        assert_eq!(find(Some(folder), "reference"), Ok(folder.join("reference")));
        for data in [None, Some(folder)] {
            let line = find(data, "no_such_capture").expect_err("there is none");
            let says = ["SKIPPED", "no_such_capture", "SPLAT_DATA_DIR", "docs/CAPTURES.md"];
            assert!(says.iter().all(|part| line.contains(part)) && !line.contains('\n'), "{line}");
        }
    }
}

//! Small JSON files, which are not read beyond a maximum length.

use std::fs::File;
use std::io::{self, Read};
use std::path::Path;

use serde::de::DeserializeOwned;
use thiserror::Error;

/// A file without the expected value.
#[derive(Debug, Error)]
pub(crate) enum JsonFault {
    /// The file cannot be read.
    #[error("{0}")]
    Read(io::Error),
    /// The file holds something else; a description of it.
    #[error("{0}")]
    Content(String),
}

/// Reads the value in a file of at most `largest` bytes.
pub(crate) fn read<T: DeserializeOwned>(path: &Path, largest: u64) -> Result<T, JsonFault> {
    let mut text = Vec::new();
    let read = File::open(path).and_then(|file| file.take(largest + 1).read_to_end(&mut text));
    read.map_err(JsonFault::Read)?;
    if text.len() as u64 > largest {
        return Err(JsonFault::Content(format!("more than {largest} bytes")));
    }
    serde_json::from_slice(&text).map_err(|error| JsonFault::Content(error.to_string()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_is_read_to_its_length_and_no_further() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("numbers.json");
        std::fs::write(&path, "[1, 2]").unwrap();
        assert_eq!(read::<Vec<u32>>(&path, 6).unwrap(), [1, 2]);
        assert!(
            matches!(read::<Vec<u32>>(&path, 5), Err(JsonFault::Content(what)) if what.contains("more than 5 bytes"))
        );
        assert!(matches!(read::<String>(&path, 6), Err(JsonFault::Content(what)) if what.contains("invalid type")));
        assert!(matches!(read::<String>(&folder.path().join("none"), 6), Err(JsonFault::Read(_))));
    }
}

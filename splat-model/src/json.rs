//! Small JSON files, which are not read beyond a maximum length.

use std::fs::File;
use std::io::{self, Read};
use std::path::Path;

use serde::de::DeserializeOwned;

use crate::encoding::utf8;

/// Reads the value in a file of at most `largest` bytes. `unread` makes the error of a file that cannot be read, and `content`
/// that of a file that holds something else.
pub(crate) fn read<T: DeserializeOwned, E>(
    path: &Path,
    largest: u64,
    unread: impl Fn(io::Error) -> E,
    content: impl Fn(String) -> E,
) -> Result<T, E> {
    let mut text = Vec::new();
    let read = File::open(path).and_then(|file| file.take(largest + 1).read_to_end(&mut text));
    read.map_err(unread)?;
    if text.len() as u64 > largest {
        return Err(content(format!("more than {largest} bytes")));
    }
    serde_json::from_slice(&utf8(text)).map_err(|error| content(error.to_string()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_is_read_to_its_length_and_no_further() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("numbers.json");
        std::fs::write(&path, "[1, 2]").unwrap();
        let file = |largest| read::<Vec<u32>, _>(&path, largest, |_| "unread".to_owned(), |what| what);
        assert_eq!(file(6).unwrap(), [1, 2]);
        assert!(file(5).unwrap_err().contains("more than 5 bytes"));
        let text = |path: &Path| read::<String, _>(path, 6, |_| "unread".to_owned(), |what| what).unwrap_err();
        assert!(text(&path).contains("invalid type"));
        assert_eq!(text(&folder.path().join("none")), "unread");
    }
}

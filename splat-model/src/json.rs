//! Small JSON files, which are not read beyond a maximum length.

use std::fs::File;
use std::io::Read;
use std::path::Path;

use serde::de::DeserializeOwned;

use crate::encoding::utf8;

/// Reads the value in a file of at most `largest` bytes. `wrong` makes the error of a file that cannot be read, or holds something else.
pub(crate) fn read<T: DeserializeOwned, E>(path: &Path, largest: u64, wrong: impl Fn(String) -> E) -> Result<T, E> {
    let mut text = Vec::new();
    let read = File::open(path).and_then(|file| file.take(largest + 1).read_to_end(&mut text));
    read.map_err(|error| wrong(error.to_string()))?;
    if text.len() as u64 > largest {
        return Err(wrong(format!("more than {largest} bytes")));
    }
    serde_json::from_slice(&utf8(text)).map_err(|error| wrong(error.to_string()))
}

#[cfg(test)]
mod tests;

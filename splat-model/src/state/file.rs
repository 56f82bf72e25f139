//! State files: safetensors, which other programs can open, with the facts and a checksum in the metadata.
//!
//! The checksum is the SHA-256 of all names, shapes, values and facts. A file is written under a temporary name and renamed
//! when it is complete and on the disk.

use std::borrow::Cow;
use std::collections::HashMap;
use std::fs::{self, File};
use std::io::{self, Read};
use std::path::{Path, PathBuf};

use safetensors::{Dtype, SafeTensors, View};
use sha2::{Digest, Sha256};
use thiserror::Error;

use super::{Array, State, Values};
use crate::replace;

/// Metadata key of [`FORMAT`].
const FORMAT_KEY: &str = "splat_state";

/// Version of the file format. The meaning of the entries is not part of it.
const FORMAT: &str = "1";

/// Metadata key of the checksum.
const CHECKSUM_KEY: &str = "sha256";

/// Prefix of the metadata keys of facts.
const FACT: &str = "fact:";

/// A state that cannot be written or read. Each message names the file.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum FileError {
    /// The operating system reported an error.
    #[error("{path}: could not {action}: {source}", path = path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// The attempted action, with the remedy if there is one.
        action: &'static str,
        /// The system's reason.
        source: io::Error,
    },
    /// The file is not a state, or has another version of the format.
    #[error("{path}: {found}, expected a state of the format {FORMAT}: read it with the version that wrote it", path = path.display())]
    Format {
        /// The file.
        path: PathBuf,
        /// The content that was found.
        found: String,
    },
    /// The file is damaged.
    #[error("{path}: the file is damaged: {detail}", path = path.display())]
    Damaged {
        /// The file.
        path: PathBuf,
        /// The reason.
        detail: String,
    },
}

impl View for &Array {
    fn dtype(&self) -> Dtype {
        match self.values {
            Values::F32(_) => Dtype::F32,
            Values::I32(_) => Dtype::I32,
        }
    }

    fn shape(&self) -> &[usize] {
        &self.shape
    }

    fn data(&self) -> Cow<'_, [u8]> {
        Cow::Borrowed(self.values.bytes())
    }

    fn data_len(&self) -> usize {
        self.values.bytes().len()
    }
}

impl State {
    /// Writes the state to a file. An existing file is replaced once the new one is complete and on the disk.
    ///
    /// # Errors
    /// If the file cannot be written. An existing file then stays unchanged.
    pub fn write(&self, path: &Path) -> Result<(), FileError> {
        let write = || -> io::Result<()> {
            let temporary = replace::begin(path)?;
            let facts = self.facts.iter().map(|(name, text)| (format!("{FACT}{name}"), text.clone()));
            let ours = [(FORMAT_KEY.to_owned(), FORMAT.to_owned()), (CHECKSUM_KEY.to_owned(), self.checksum())];
            let metadata: HashMap<String, String> = facts.chain(ours).collect();
            safetensors::serialize_to_file(&self.arrays, Some(metadata), temporary.path()).map_err(io::Error::other)?;
            replace::finish(temporary, path)?;
            // Writes the folder's entry to the disk, so that the new name survives a power loss. Some systems do not support it.
            let _ = path.parent().map(File::open).transpose()?.map(|folder| folder.sync_all());
            Ok(())
        };
        let action = "write it: check that its folder can be written to and has room left";
        write().map_err(|source| FileError::Io { path: path.to_owned(), action, source })
    }

    /// Whether [`Self::write`] of any version wrote a file, by its header. The rest may be damaged.
    pub fn is_in(path: &Path) -> bool {
        // The largest header of safetensors.
        const MOST: u64 = 100_000_000;
        let read = || {
            let mut file = File::open(path).ok()?;
            let mut length = [0; 8];
            file.read_exact(&mut length).ok()?;
            let length = u64::from_le_bytes(length);
            let mut header = Vec::new();
            file.take(length.min(MOST)).read_to_end(&mut header).ok()?;
            let header: serde_json::Value = serde_json::from_slice(&header).ok()?;
            Some(header["__metadata__"].get(FORMAT_KEY).is_some())
        };
        read().unwrap_or(false)
    }

    /// Reads a file that [`Self::write`] wrote.
    ///
    /// # Errors
    /// If the file cannot be read, has another format, or is damaged.
    pub fn read(path: &Path) -> Result<Self, FileError> {
        let io = |source| FileError::Io { path: path.to_owned(), action: "read it", source };
        let damaged = |detail: String| FileError::Damaged { path: path.to_owned(), detail };
        let format = |found: String| FileError::Format { path: path.to_owned(), found };
        let bytes = fs::read(path).map_err(io)?;
        let (_, header) = SafeTensors::read_metadata(&bytes).map_err(|error| damaged(error.to_string()))?;
        let mut metadata = header.metadata().clone().unwrap_or_default();
        match metadata.remove(FORMAT_KEY).as_deref() {
            Some(FORMAT) => {}
            Some(other) => return Err(format(format!("a state of the format {other:?}"))),
            None => return Err(format("a file of tensors alone".into())),
        }
        let checksum = metadata.remove(CHECKSUM_KEY).ok_or_else(|| damaged("it has no checksum".into()))?;
        let tensors = SafeTensors::deserialize(&bytes).map_err(|error| damaged(error.to_string()))?;
        let mut state = Self::default();
        for (name, view) in tensors.iter() {
            let words = view.data().as_chunks::<4>().0.iter();
            let values = match view.dtype() {
                Dtype::F32 => Values::F32(words.map(|bytes| f32::from_le_bytes(*bytes)).collect()),
                Dtype::I32 => Values::I32(words.map(|bytes| i32::from_le_bytes(*bytes)).collect()),
                other => return Err(damaged(format!("`{name}` is of the type {other}, expected F32 or I32"))),
            };
            state.arrays.insert(name.to_owned(), Array { shape: view.shape().to_vec(), values });
        }
        let fact = |(name, text): (String, String)| name.strip_prefix(FACT).map(|name| (name.to_owned(), text));
        state.facts = metadata.into_iter().filter_map(fact).collect();
        match state.checksum() == checksum {
            true => Ok(state),
            false => Err(damaged("its checksum does not match its contents".into())),
        }
    }

    /// The checksum in hexadecimal digits.
    fn checksum(&self) -> String {
        let mut hash = Sha256::new();
        // Each entry begins with its length, so that different states never give the same bytes.
        let mut add = |bytes: &[u8]| {
            hash.update((bytes.len() as u64).to_le_bytes());
            hash.update(bytes);
        };
        for (name, Array { shape, values }) in &self.arrays {
            add(name.as_bytes());
            add(&shape.iter().flat_map(|side| (*side as u64).to_le_bytes()).collect::<Vec<_>>());
            add(values.bytes());
        }
        for (name, text) in &self.facts {
            add(name.as_bytes());
            add(text.as_bytes());
        }
        format!("{:x}", hash.finalize())
    }
}

#[cfg(test)]
mod tests {
    use burn::tensor::{DType, Device, Tensor};

    use super::*;

    fn state() -> State {
        let mut state = State::default();
        state.put("scene/means", Tensor::<2>::from_floats([[1.0, -2.5], [f32::MIN_POSITIVE, 1e30]], &Device::flex()));
        state.put("none", Tensor::<1>::zeros([0], &Device::flex()));
        state.put_words("scene/words", Tensor::from_data([[7, -1]], (&Device::flex(), DType::I32)));
        state.tell("step", &17).unwrap();
        state.tell("rate", &0.1_f64.next_up()).unwrap();
        state
    }

    #[test]
    fn what_is_written_is_read() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.safetensors");
        state().write(&path).unwrap();
        state().write(&path).unwrap();
        assert_eq!(State::read(&path).unwrap(), state());
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1, "a temporary file is left");
    }

    #[test]
    fn a_flipped_bit_or_a_missing_end_is_noticed() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.safetensors");
        state().write(&path).unwrap();
        let bytes = fs::read(&path).unwrap();
        for at in 0..bytes.len() {
            for bit in [0, 3, 7] {
                let mut changed = bytes.clone();
                changed[at] ^= 1 << bit;
                fs::write(&path, changed).unwrap();
                // Blanks between header and data have no meaning.
                let found = State::read(&path);
                let harmless = found.as_ref().is_ok_and(|found| *found == state());
                assert!(found.is_err() || harmless && bytes[at] == b' ', "byte {at}, bit {bit}: {found:?}");
            }
        }
        for length in 0..bytes.len() {
            fs::write(&path, &bytes[..length]).unwrap();
            let error = State::read(&path).unwrap_err().to_string();
            assert!(error.contains("a.safetensors"), "{error}");
        }
    }

    #[test]
    fn other_files_are_told_apart() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.safetensors");
        let read = || State::read(&path).unwrap_err();
        assert!(matches!(read(), FileError::Io { .. }));
        let arrays = state().arrays;
        safetensors::serialize_to_file(&arrays, None, &path).unwrap();
        assert!(read().to_string().contains("tensors alone"), "{}", read());
        let newer = HashMap::from([(FORMAT_KEY.to_owned(), "2".to_owned())]);
        safetensors::serialize_to_file(&arrays, Some(newer), &path).unwrap();
        assert!(read().to_string().contains("\"2\""), "{}", read());
        fs::write(&path, b"").unwrap();
        assert!(matches!(read(), FileError::Damaged { .. }));
    }

    #[test]
    fn a_state_is_known_by_its_header() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.safetensors");
        state().write(&path).unwrap();
        let whole = fs::read(&path).unwrap();
        fs::write(&path, &whole[..whole.len() - 1]).unwrap();
        assert!(State::is_in(&path), "its values are damaged");
        for other in [&whole[..40], b"", b"state of another program"] {
            fs::write(&path, other).unwrap();
            assert!(!State::is_in(&path), "{other:?}");
        }
        safetensors::serialize_to_file(&state().arrays, None, &path).unwrap();
        assert!(!State::is_in(&path), "tensors alone");
        assert!(!State::is_in(folder.path()) && !State::is_in(&folder.path().join("none")));
    }

    #[test]
    fn what_cannot_be_written_leaves_the_old() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.safetensors");
        // A folder in place of the file.
        fs::create_dir(&path).unwrap();
        let error = State::default().write(&path).unwrap_err().to_string();
        assert!(error.contains("a.safetensors") && error.contains("room"), "{error}");
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1, "a temporary file is left");
    }
}

//! State files: safetensors, which other programs can open, with the facts and a checksum in the metadata.
//!
//! The checksum is the SHA-256 of all names, shapes, values and facts. A file is written under a temporary name and renamed
//! when it is complete and on the disk.

use std::collections::HashMap;
use std::fs::{self, File};
use std::io::{self, Read};
use std::path::Path;

use burn::tensor::{DType, TensorData};
use safetensors::tensor::TensorView;
use safetensors::{Dtype, SafeTensorError, SafeTensors};
use sha2::{Digest, Sha256};

use super::State;
use crate::{FileError, replace};

/// Metadata key of [`FORMAT`].
const FORMAT_KEY: &str = "splat_state";

/// Version of the file format. The meaning of the entries is not part of it.
const FORMAT: &str = "1";

/// Metadata key of the checksum.
const CHECKSUM_KEY: &str = "sha256";

/// Prefix of the metadata keys of facts.
const FACT: &str = "fact:";

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
            let views = self.views().collect::<Result<Vec<_>, _>>().map_err(io::Error::other)?;
            safetensors::serialize_to_file(views, Some(metadata), temporary.path()).map_err(io::Error::other)?;
            replace::finish(temporary, path)?;
            // Writes the folder's entry to the disk, so that the new name survives a power loss. Some systems do not support it.
            if let Some(Ok(folder)) = path.parent().map(File::open) {
                let _ = folder.sync_all();
            }
            Ok(())
        };
        let failed =
            |reason| format!("could not write it: check that its folder can be written to and has room left: {reason}");
        write().map_err(|reason| FileError::new(path, failed(reason)))
    }

    fn views(&self) -> impl Iterator<Item = Result<(&str, TensorView<'_>), SafeTensorError>> {
        self.arrays.iter().map(|(name, data)| {
            let of = if data.dtype() == DType::I32 { Dtype::I32 } else { Dtype::F32 };
            Ok((name.as_str(), TensorView::new(of, data.shape().to_vec(), data.as_bytes())?))
        })
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
        let error = |detail: String| FileError::new(path, detail);
        let damaged = |detail: String| error(format!("the file is damaged: {detail}"));
        let other = |found: &str| {
            error(format!("{found}, expected a state of the format {FORMAT}: read it with the version that wrote it"))
        };
        let bytes = fs::read(path).map_err(|reason| error(format!("could not read it: {reason}")))?;
        let (_, header) = SafeTensors::read_metadata(&bytes).map_err(|error| damaged(error.to_string()))?;
        let mut metadata = header.metadata().clone().unwrap_or_default();
        match metadata.remove(FORMAT_KEY).as_deref() {
            Some(FORMAT) => {}
            Some(found) => return Err(other(&format!("a state of the format {found:?}"))),
            None => return Err(other("a file of tensors alone")),
        }
        let checksum = metadata.remove(CHECKSUM_KEY).ok_or_else(|| damaged("it has no checksum".into()))?;
        let tensors = SafeTensors::deserialize(&bytes).map_err(|error| damaged(error.to_string()))?;
        let mut state = Self::default();
        for (name, view) in tensors.iter() {
            let (bytes, shape) = (view.data(), view.shape().to_vec());
            let data = match view.dtype() {
                Dtype::F32 => TensorData::new(bytemuck::pod_collect_to_vec::<u8, f32>(bytes), shape),
                Dtype::I32 => TensorData::new(bytemuck::pod_collect_to_vec::<u8, i32>(bytes), shape),
                other => return Err(damaged(format!("`{name}` is of the type {other}, expected F32 or I32"))),
            };
            state.arrays.insert(name.to_owned(), data);
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
        for (name, data) in &self.arrays {
            add(name.as_bytes());
            add(&data.shape().iter().flat_map(|side| (*side as u64).to_le_bytes()).collect::<Vec<_>>());
            add(data.as_bytes());
        }
        for (name, text) in &self.facts {
            add(name.as_bytes());
            add(text.as_bytes());
        }
        format!("{:x}", hash.finalize())
    }
}

#[cfg(test)]
mod tests;

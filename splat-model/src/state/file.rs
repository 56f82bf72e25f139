//! State files: safetensors, which other programs can open, with a checksum in the metadata. A fact is an array of bytes.
//!
//! The checksum is the SHA-256 of all entries. A file is written under a temporary name and renamed when it is complete and on the disk.

use std::collections::HashMap;
use std::fmt::Display;
use std::fs::{self, File};
use std::io::{self, BufReader};
use std::path::Path;

use burn::tensor::{DType, TensorData};
use bytemuck::pod_collect_to_vec;
use safetensors::tensor::{Dtype, Metadata, SafeTensors, TensorView};
use serde::Deserialize;
use sha2::{Digest, Sha256};

use super::State;
use crate::{FileError, replace};

/// Metadata key of [`FORMAT`].
const FORMAT_KEY: &str = "splat_state";

/// Version of the file format. The meaning of the entries is not part of it.
const FORMAT: &str = "2";

/// Metadata key of the checksum.
const CHECKSUM_KEY: &str = "sha256";

/// The types of entries, here and in a file.
const TYPES: [(DType, Dtype); 3] = [(DType::F32, Dtype::F32), (DType::I32, Dtype::I32), (DType::U8, Dtype::U8)];

impl State {
    /// Writes the state to a file. An existing file is replaced once the new one is complete and on the disk.
    ///
    /// # Errors
    /// If the file cannot be written. An existing file then stays unchanged.
    pub fn write(&self, path: &Path) -> Result<(), FileError> {
        let write = || -> io::Result<()> {
            let temporary = replace::begin(path)?;
            let metadata = [(FORMAT_KEY, FORMAT), (CHECKSUM_KEY, &self.checksum())];
            let metadata = HashMap::from(metadata.map(|(key, value)| (key.to_owned(), value.to_owned())));
            let permissions = temporary.as_file().metadata()?.permissions();
            safetensors::serialize_to_file(self.views(), Some(metadata), temporary.path()).map_err(io::Error::other)?;
            // It has put a file of its own there, which its owner alone may read.
            fs::set_permissions(temporary.path(), permissions)?;
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

    fn views(&self) -> impl Iterator<Item = (&str, TensorView<'_>)> {
        self.entries.iter().map(|(name, data)| {
            let of =
                TYPES.iter().find(|(own, _)| *own == data.dtype()).expect("entries are only made of these types").1;
            let view = TensorView::new(of, data.shape().to_vec(), data.as_bytes());
            (name.as_str(), view.expect("data is as long as its shape says"))
        })
    }

    /// Whether [`Self::write`] of any version wrote a file, by its header. The rest may be damaged.
    pub fn is_in(path: &Path) -> bool {
        let header = || {
            let mut file = BufReader::new(File::open(path).ok()?);
            // The header's length.
            file.seek_relative(8).ok()?;
            Metadata::deserialize(&mut serde_json::Deserializer::from_reader(file)).ok()?.metadata().clone()
        };
        header().is_some_and(|metadata| metadata.contains_key(FORMAT_KEY))
    }

    /// Reads a file that [`Self::write`] wrote.
    ///
    /// # Errors
    /// If the file cannot be read, has another format, or is damaged.
    pub fn read(path: &Path) -> Result<Self, FileError> {
        let damaged = |detail: &dyn Display| FileError::new(path, format!("the file is damaged: {detail}"));
        let bytes = fs::read(path).map_err(|reason| FileError::new(path, format!("could not read it: {reason}")))?;
        let (_, header) = SafeTensors::read_metadata(&bytes).map_err(|error| damaged(&error))?;
        let metadata = header.metadata().clone().unwrap_or_default();
        let format = metadata.get(FORMAT_KEY);
        if format.is_none_or(|format| format != FORMAT) {
            let found =
                format.map_or("a file of tensors alone".into(), |format| format!("a state of the format {format:?}"));
            let expected = format!("expected a state of the format {FORMAT}: read it with the version that wrote it");
            return Err(FileError::new(path, format!("{found}, {expected}")));
        }
        let tensors = SafeTensors::deserialize(&bytes).map_err(|error| damaged(&error))?;
        let mut state = Self::default();
        for (name, view) in tensors.iter() {
            // Typed, because Burn copies bytes once more to align them.
            let (bytes, shape) = (view.data(), view.shape().to_vec());
            let data = match view.dtype() {
                Dtype::F32 => TensorData::new(pod_collect_to_vec::<u8, f32>(bytes), shape),
                Dtype::I32 => TensorData::new(pod_collect_to_vec::<u8, i32>(bytes), shape),
                Dtype::U8 => TensorData::new(bytes.to_vec(), shape),
                other => return Err(damaged(&format!("`{name}` is of the type {other}, expected F32, I32 or U8"))),
            };
            state.entries.insert(name.to_owned(), data);
        }
        match metadata.get(CHECKSUM_KEY) {
            Some(checksum) if *checksum == state.checksum() => Ok(state),
            _ => Err(damaged(&"its checksum does not match its contents")),
        }
    }

    /// The checksum in hexadecimal digits.
    fn checksum(&self) -> String {
        let mut hash = Sha256::new();
        for (name, data) in &self.entries {
            // It says how many bytes follow, so that different states never give the same bytes.
            hash.update(format!("{name:?} {:?} {:?}", data.dtype(), data.shape().to_vec()));
            hash.update(data.as_bytes());
        }
        format!("{:x}", hash.finalize())
    }
}

#[cfg(test)]
mod tests;

//! The bytes of a document's buffers: the container's, in the document itself, or in files beside it.

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::fs::File;
use std::io::{self, Read, Seek, SeekFrom};
use std::ops::Range;
use std::path::{Component, Path, PathBuf};

use base64::Engine;
use base64::engine::general_purpose::STANDARD;

use super::document::Document;
use crate::ply::brief;

/// Beginning of a URI that holds its data, up to the media type.
const DATA: &str = "data:";

/// The bytes of a buffer.
pub enum Buffer {
    /// All bytes, in memory.
    Held(Vec<u8>),
    /// Some bytes of a file, which are read when they are needed.
    InFile { file: File, first: u64, len: usize },
}

impl Buffer {
    pub fn len(&self) -> usize {
        match self {
            Self::Held(bytes) => bytes.len(),
            Self::InFile { len, .. } => *len,
        }
    }

    /// Some of the bytes, within [`Self::len`].
    pub fn part(&self, which: Range<usize>) -> io::Result<Cow<'_, [u8]>> {
        match self {
            Self::Held(bytes) => Ok(Cow::Borrowed(&bytes[which])),
            Self::InFile { file, first, .. } => {
                let mut bytes = vec![0; which.len()];
                let mut file = file;
                file.seek(SeekFrom::Start(first + which.start as u64))?;
                file.read_exact(&mut bytes)?;
                Ok(Cow::Owned(bytes))
            }
        }
    }
}

/// Buffers by their index.
pub type Buffers = BTreeMap<usize, Buffer>;

/// Reads the buffers that primitives with the extension use, and no other. `binary` is the container's second chunk.
///
/// # Errors
/// What is wrong, and what was expected.
pub fn load(document: &Document, path: &Path, mut binary: Option<Buffer>) -> Result<Buffers, String> {
    let primitives = document.meshes.iter().flat_map(|mesh| &mesh.primitives);
    let splats = primitives.filter(|primitive| primitive.extensions.splatting.is_some());
    let accessors =
        splats.flat_map(|primitive| primitive.attributes.values()).filter_map(|&i| document.accessors.get(i));
    let views = accessors.filter_map(|accessor| document.buffer_views.get(accessor.buffer_view?));
    let mut loaded = Buffers::new();
    for index in views.map(|view| view.buffer) {
        if loaded.contains_key(&index) {
            continue;
        }
        // Views of buffers that do not exist are refused where they are used.
        let Some(buffer) = document.buffers.get(index) else { continue };
        let bytes = match &buffer.uri {
            None if index == 0 => binary.take().ok_or("buffer 0 has no `uri`, and the file no binary chunk")?,
            None => {
                return Err(format!(
                    "buffer {index} has no `uri`, expected one: only buffer 0 may be in the file's binary chunk"
                ));
            }
            Some(uri) => match uri.strip_prefix(DATA) {
                Some(data) => Buffer::Held(decoded(data).map_err(|what| format!("buffer {index}: {what}"))?),
                None => Buffer::Held(beside(path, uri).map_err(|what| format!("buffer {index}: {what}"))?),
            },
        };
        if bytes.len() < buffer.byte_length {
            return Err(format!(
                "buffer {index} has {} bytes, expected `byteLength` {}; it is truncated",
                bytes.len(),
                buffer.byte_length
            ));
        }
        loaded.insert(index, bytes);
    }
    Ok(loaded)
}

/// The data of a URI after `data:`.
fn decoded(data: &str) -> Result<Vec<u8>, String> {
    let (kind, text) = data.split_once(',').ok_or("its `uri` begins with `data:` and has no comma")?;
    if !kind.ends_with(";base64") {
        return Err(format!("its `uri` holds data as `{}`, expected base64", brief(kind)));
    }
    STANDARD.decode(text).map_err(|error| format!("its `uri` is not base64: {error}"))
}

/// The bytes of a file in the folder of the document.
fn beside(document: &Path, uri: &str) -> Result<Vec<u8>, String> {
    let name = PathBuf::from(unescaped(uri));
    let below = name.components().all(|part| matches!(part, Component::Normal(_) | Component::CurDir));
    if !below || name.as_os_str().is_empty() {
        return Err(format!(
            "its `uri` is `{}`, expected the name of a file in the folder of the document",
            brief(uri)
        ));
    }
    let file = document.with_file_name("").join(name);
    let read = || {
        let opened = File::open(&file)?;
        if !opened.metadata()?.is_file() {
            return Err(std::io::Error::other("not a file"));
        }
        let mut bytes = Vec::new();
        (&opened).read_to_end(&mut bytes)?;
        Ok(bytes)
    };
    read().map_err(|error| format!("`{}` beside the document cannot be read: {error}", brief(uri)))
}

/// A URI with `%20` and the like as the characters that they stand for.
pub(in crate::formats) fn unescaped(uri: &str) -> String {
    let mut bytes = Vec::with_capacity(uri.len());
    let mut rest = uri.as_bytes();
    while let Some((&first, after)) = rest.split_first() {
        let hex = after.get(..2).and_then(|two| std::str::from_utf8(two).ok());
        match hex.and_then(|two| u8::from_str_radix(two, 16).ok()) {
            Some(byte) if first == b'%' => {
                bytes.push(byte);
                rest = &after[2..];
            }
            _ => {
                bytes.push(first);
                rest = after;
            }
        }
    }
    String::from_utf8_lossy(&bytes).into_owned()
}

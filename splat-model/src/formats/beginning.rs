//! Which format a file has, by its first bytes.

use std::fs::File;
use std::io::{BufReader, Read};
use std::path::Path;

use flate2::bufread::GzDecoder;

use super::{sog, spz};
use crate::FileError;
use crate::sniff::{FileClass, FileKind};

/// What the first bytes of a scene's file tell.
pub(super) enum Beginning {
    Ply,
    Spz,
    Zip,
}

impl Beginning {
    pub fn of(path: &Path) -> Result<Self, FileError> {
        let mut first = Vec::new();
        File::open(path)
            .map_err(FileError::io(path, "open the scene (is the path right?)"))?
            .take(16)
            .read_to_end(&mut first)
            .map_err(FileError::io(path, "read the scene (is the path right?)"))?;
        let line = first.split(|byte| *byte == b'\n').next().unwrap_or_default().trim_ascii();
        let is_json = first.trim_ascii_start().starts_with(b"{");
        let name = path.file_name().unwrap_or_default().to_string_lossy().to_ascii_lowercase();
        let ends = |end: &str| name.ends_with(end);
        Ok(match () {
            () if spz::is_spz(&first) => match gunzipped(path).and_then(|inner| FileKind::of_bytes(&inner)) {
                Some(inner) => {
                    let what = format!("a gzip file around {}, not SPZ", inner.what);
                    return Err(FileError::foreign(path, what, "unpack it with `gunzip`"));
                }
                None => Self::Spz,
            },
            () if first.starts_with(b"glTF") || is_json && ends(".gltf") => return Err(gltf(path)),
            () if first.starts_with(&sog::MAGIC) => Self::Zip,
            () if is_json && ends(sog::META) => {
                let what = "the document of an unpacked SOG scene".into();
                let remedy = format!("pack it with its pictures (`zip -0 scene.sog {} *.webp`)", sog::META);
                return Err(FileError::foreign(path, what, remedy));
            }
            () if line == b"ply" => Self::Ply,
            () => return Err(unknown(path, line)),
        })
    }
}

/// The first bytes in a gzip file; `None` if it is none, damaged or SPZ.
fn gunzipped(path: &Path) -> Option<Vec<u8>> {
    let mut first = Vec::new();
    GzDecoder::new(BufReader::new(File::open(path).ok()?)).take(16).read_to_end(&mut first).ok()?;
    Some(first).filter(|first| !first.is_empty() && !first.starts_with(&spz::MAGIC))
}

/// The error for a file that begins so and is no scene.
fn unknown(path: &Path, line: &[u8]) -> FileError {
    match FileKind::of(path).filter(|kind| !matches!(kind.class, FileClass::Scene | FileClass::Text)) {
        Some(FileKind { what, remedy, .. }) => FileError::foreign(path, what, remedy),
        None => {
            let found = String::from_utf8_lossy(line).escape_debug().to_string();
            FileError::new(
                path,
                format!(
                    "not a scene: it begins with `{found}`, expected a PLY file (original layout or SuperSplat's compressed one), SPZ \
                     (version 1 to 4) or SOG; export it as one of these"
                ),
            )
        }
    }
}

fn gltf(path: &Path) -> FileError {
    let what = "a scene in glTF, which is written here and not read".into();
    FileError::foreign(path, what, "convert it to PLY with `npx @playcanvas/splat-transform IN OUT.ply`")
}

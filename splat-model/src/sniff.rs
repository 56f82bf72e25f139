//! What a file is that cannot be used, so that errors name it.

use std::fs::File;
use std::io::Read;
use std::path::Path;

use infer::MatcherType;

/// What a file is by its first bytes, or else by its name.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FileKind {
    /// A noun, such as "a ZIP archive".
    pub what: String,
    /// What to do with it.
    pub remedy: String,
    /// What can be done with it.
    pub class: FileClass,
}

/// What can be done with a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FileClass {
    /// A picture that can be decoded: JPEG, PNG, WebP.
    Picture,
    /// A video, of which FFmpeg takes frames.
    Video,
    /// A scene or points in a format that is read.
    Scene,
    /// Text, JSON included.
    Text,
    /// Nothing before it is converted.
    Other,
}

/// First bytes that the crate `infer` does not know.
const BEGINNINGS: [(&[u8], &str, &str, FileClass); 7] = [
    (b"ply", "a PLY file, a scene or points", SCENE, FileClass::Scene),
    (b"glTF", "a scene in glTF", SCENE, FileClass::Scene),
    (b"NGSP", "a scene in SPZ", SCENE, FileClass::Scene),
    (b"version https://git-lfs", "a pointer of Git LFS", "fetch the file itself with `git lfs pull`", FileClass::Other),
    (b"FUJIFILM", "the raw file of a camera", RAW, FileClass::Other),
    (b"IIRO", "the raw file of a camera", RAW, FileClass::Other),
    (b"IIU\0", "the raw file of a camera", RAW, FileClass::Other),
];

const SCENE: &str = "name the folder that holds the photographs and their cameras; `splat view` shows a scene";

const RAW: &str = "develop it to JPEG with the camera's program, darktable or RawTherapee";

impl FileKind {
    /// The kind of a file; `None` if neither its content nor its name tells, or it cannot be read.
    pub fn of(path: &Path) -> Option<Self> {
        let mut first = Vec::new();
        File::open(path).ok()?.take(1 << 10).read_to_end(&mut first).ok()?;
        let kind = Self::of_scene(path).or_else(|| Self::of_bytes(&first))?;
        let format = path.extension().map(|format| format.to_string_lossy().to_uppercase());
        match format.filter(|format| kind.what.ends_with("archive") && ["SPZ", "SOG"].contains(&&**format)) {
            Some(format) => Some(Self::new(format!("a scene in {format}"), SCENE, FileClass::Scene)),
            None => Some(kind),
        }
    }

    fn new(what: impl Into<String>, remedy: impl Into<String>, class: FileClass) -> Self {
        Self { what: what.into(), remedy: remedy.into(), class }
    }

    /// A scene in a format that is not read.
    pub(crate) fn of_scene(path: &Path) -> Option<Self> {
        let name = path.file_name()?.to_str()?.to_ascii_lowercase();
        let kind = ["splat", "ksplat"].into_iter().find(|kind| name.ends_with(&format!(".{kind}")))?;
        Some(Self::new(
            format!("a scene in the format .{kind}"),
            "convert it to PLY with `npx @playcanvas/splat-transform IN OUT.ply`, or in SuperSplat (https://superspl.at/editor)",
            FileClass::Other,
        ))
    }

    /// The kind of a file that begins so.
    pub(crate) fn of_bytes(first: &[u8]) -> Option<Self> {
        const AGAIN: &str = "copy or export it again";
        if first.is_empty() {
            return Some(Self::new("an empty file", AGAIN, FileClass::Other));
        }
        if let Some((_, what, remedy, class)) = BEGINNINGS.iter().find(|(bytes, ..)| first.starts_with(bytes)) {
            return Some(Self::new(*what, *remedy, *class));
        }
        if first.get(4..12) == Some(b"ftypcrx ") {
            return Some(Self::new("the raw file of a camera", RAW, FileClass::Other));
        }
        let Some(found) = infer::get(first) else {
            let is_text = !first.iter().any(|byte| byte.is_ascii_control() && !byte.is_ascii_whitespace());
            let is_json = matches!(first.trim_ascii_start().first(), Some(b'{' | b'['));
            let what = if is_json { "a JSON file without frames that have poses" } else { "a text file" };
            return is_text.then(|| {
                Self::new(what, "name the folder that holds the photographs and their cameras", FileClass::Text)
            });
        };
        let (kind, upper) = (found.extension(), found.extension().to_uppercase());
        let convert = format!("convert it to JPEG, for instance with ImageMagick's `magick IN.{kind} OUT.jpg`");
        let (what, remedy, class) = match (found.matcher_type(), kind) {
            (_, "jpg" | "png" | "webp") => {
                (format!("a {upper} picture"), "name the folder that holds it".into(), FileClass::Picture)
            }
            // FFmpeg reads animations.
            (MatcherType::Video, _) | (_, "gif") => {
                (format!("a video ({kind})"), "`splat reconstruct` takes its frames".into(), FileClass::Video)
            }
            (_, "heif") => ("a HEIC (HEIF) picture".into(), convert, FileClass::Other),
            (_, "avif") => ("an AVIF picture".into(), convert, FileClass::Other),
            (_, "tif") => ("a TIFF picture or the raw file of a camera".into(), convert, FileClass::Other),
            (MatcherType::Image, _) => (format!("a {upper} picture"), convert, FileClass::Other),
            (MatcherType::Archive, "pdf" | "sqlite") => {
                (format!("a file of the kind {kind}"), AGAIN.into(), FileClass::Other)
            }
            (MatcherType::Archive, _) => {
                (format!("a {upper} archive"), "unpack it, and name what it holds".into(), FileClass::Other)
            }
            _ => (format!("a file of the kind {kind}"), AGAIN.into(), FileClass::Other),
        };
        Some(Self::new(what, remedy, class))
    }
}

#[cfg(test)]
mod tests;

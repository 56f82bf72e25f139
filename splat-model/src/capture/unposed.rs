//! Photographs without a reconstruction: what a folder holds, before anything finds their cameras.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use rayon::prelude::*;
use sha2::{Digest, Sha256};

use super::Result;
use super::exif::Exif;
use super::image::{decode, size};
use super::names::{PICTURES, files_below};
use super::read::read;

/// Extensions of pictures that cannot be read, but that a user may have meant.
const OTHER_PICTURES: [&str; 12] =
    ["heic", "heif", "avif", "tif", "tiff", "webp", "bmp", "dng", "cr2", "cr3", "nef", "arw"];

/// Folders beside photographs that hold other pictures of a capture.
const NOT_PHOTOGRAPHS: [&str; 5] = ["masks", "mask", "depth", "depths", "depth_maps"];

/// The pictures of a folder.
#[derive(Clone, Debug, Default)]
pub struct PhotographFolder {
    /// The folder that [`names`](Self::names) are relative to: the given one, or `images` in it.
    pub root: PathBuf,
    /// Paths below the root with `/` between folders, in order of name.
    pub names: Vec<String>,
    /// Number of pictures by extension whose format cannot be read.
    pub other: BTreeMap<String, usize>,
}

impl PhotographFolder {
    /// Lists the JPEG and PNG files of a folder and its subfolders, or of its subfolder `images` where there is one. Hidden
    /// files and the folders of masks and depth maps are left out. No file is opened.
    ///
    /// # Errors
    /// A [`CaptureError`](crate::capture::CaptureError) if a folder cannot be listed.
    pub fn list(folder: &Path) -> Result<Self> {
        let images = folder.join("images");
        let root = if images.is_dir() { images } else { folder.to_owned() };
        let mut found = Self { root, ..Self::default() };
        for name in files_below(&found.root, &NOT_PHOTOGRAPHS)? {
            let extension =
                Path::new(&name).extension().map(|extension| extension.to_string_lossy().to_ascii_lowercase());
            match extension {
                Some(kind) if PICTURES.contains(&kind.as_str()) => found.names.push(name),
                Some(kind) if OTHER_PICTURES.contains(&kind.as_str()) => *found.other.entry(kind).or_default() += 1,
                _ => {}
            }
        }
        Ok(found)
    }

    /// The path of a photograph.
    pub fn path(&self, name: &str) -> PathBuf {
        self.root.join(name)
    }

    /// Looks at every photograph, on all threads: it is decoded once, so that a broken one is found before hours of work.
    /// `progress` receives 1 for each, from any thread.
    ///
    /// # Errors
    /// A [`CaptureError`](crate::capture::CaptureError) that names a photograph that cannot be read or decoded.
    pub fn look(&self, progress: impl Fn(u64) + Sync) -> Result<Vec<Unposed>> {
        let one = |name: &String| {
            let found = Unposed::look(name, &self.path(name))?;
            progress(1);
            Ok(found)
        };
        self.names.par_iter().map(one).collect()
    }
}

/// A photograph whose camera is unknown.
#[derive(Clone, Debug)]
pub struct Unposed {
    /// Path below the folder of the photographs.
    pub name: String,
    /// Width and height as stored, px: a rotation tag is not applied.
    pub size: [usize; 2],
    /// What the camera wrote down.
    pub exif: Exif,
    /// SHA-256 of the file.
    digest: [u8; 32],
}

impl Unposed {
    fn look(name: &str, file: &Path) -> Result<Self> {
        let [width, height] = size(file)?;
        decode(file, [width, height])?;
        let digest = Sha256::digest(read(file)?).into();
        Ok(Self { name: name.to_owned(), size: [width, height], exif: Exif::read(file)?, digest })
    }
}

/// The number of different files among photographs: a copy under another name shows nothing new.
pub fn different(photographs: &[Unposed]) -> usize {
    photographs.iter().map(|photograph| photograph.digest).collect::<BTreeSet<_>>().len()
}

/// Photographs that one camera with one zoom took.
#[derive(Clone, Debug)]
pub struct SameCamera {
    /// Indices into the photographs.
    pub members: Vec<usize>,
    /// Width and height, px.
    pub size: [usize; 2],
    /// Focal length by EXIF, px.
    pub focal_px: Option<f64>,
}

/// Groups photographs whose EXIF names the same camera and focal length and whose size is the same, largest group first.
/// Without EXIF the size alone decides.
pub fn by_camera(photographs: &[Unposed]) -> Vec<SameCamera> {
    let mut groups: BTreeMap<_, Vec<usize>> = BTreeMap::new();
    for (i, photograph) in photographs.iter().enumerate() {
        let Exif { camera, focal_mm, focal_35mm, .. } = &photograph.exif;
        // Tenths of a millimetre: a lens without zoom may be stated with rounding.
        let tenths = |mm: &Option<f64>| mm.map(|mm| (10.0 * mm).round() as u64);
        groups.entry((photograph.size, camera, tenths(focal_mm), tenths(focal_35mm))).or_default().push(i);
    }
    let group = |members: Vec<usize>| {
        let Unposed { size, exif, .. } = &photographs[members[0]];
        SameCamera { members, size: *size, focal_px: exif.focal_px(*size) }
    };
    let mut groups: Vec<SameCamera> = groups.into_values().map(group).collect();
    groups.sort_by_key(|group| (std::cmp::Reverse(group.members.len()), group.members[0]));
    groups
}

#[cfg(test)]
mod tests;

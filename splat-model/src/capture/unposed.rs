//! Photographs without a reconstruction: what a folder holds, before anything finds their cameras.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};

use rayon::prelude::*;
use sha2::{Digest, Sha256};
use splat_op::Intrinsics;

use super::CaptureError;
use super::exif::Exif;
use super::image::{decode, size};
use super::names::PICTURES;
use super::read::{read, unreadable};

/// Extensions of pictures that cannot be read, but that a user may have meant.
const OTHER_PICTURES: [&str; 12] =
    ["heic", "heif", "avif", "tif", "tiff", "webp", "bmp", "dng", "cr2", "cr3", "nef", "arw"];

/// Folders beside photographs that hold other pictures of a capture.
const NOT_PHOTOGRAPHS: [&str; 5] = ["masks", "mask", "depth", "depths", "depth_maps"];

/// Largest depth of subfolders that are searched.
const MAX_DEPTH: usize = 8;

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
    /// A [`CaptureError`] if a folder cannot be listed.
    pub fn list(folder: &Path) -> Result<Self, CaptureError> {
        let images = folder.join("images");
        let root = if images.is_dir() { images } else { folder.to_owned() };
        let mut found = Self { root: root.clone(), ..Self::default() };
        found.walk(&root, "", 0)?;
        found.names.sort();
        Ok(found)
    }

    fn walk(&mut self, folder: &Path, prefix: &str, depth: usize) -> Result<(), CaptureError> {
        let entries = fs::read_dir(folder).map_err(|reason| unreadable(folder, reason))?;
        for entry in entries {
            let entry = entry.map_err(|reason| unreadable(folder, reason))?;
            // Formats of cameras hold names in UTF-8.
            let Ok(name) = entry.file_name().into_string() else { continue };
            let path = entry.path();
            if name.starts_with('.') {
                continue;
            } else if path.is_dir() {
                if depth < MAX_DEPTH && !NOT_PHOTOGRAPHS.contains(&name.as_str()) {
                    self.walk(&path, &format!("{prefix}{name}/"), depth + 1)?;
                }
                continue;
            }
            let extension = path.extension().map(|extension| extension.to_string_lossy().to_ascii_lowercase());
            match extension {
                Some(kind) if PICTURES.contains(&kind.as_str()) => self.names.push(format!("{prefix}{name}")),
                Some(kind) if OTHER_PICTURES.contains(&kind.as_str()) => *self.other.entry(kind).or_default() += 1,
                _ => {}
            }
        }
        Ok(())
    }

    /// The path of a photograph.
    pub fn path(&self, name: &str) -> PathBuf {
        self.root.join(name)
    }

    /// Looks at every photograph, on all threads: it is decoded once, so that a broken one is found before hours of work.
    /// `progress` receives 1 for each, from any thread.
    ///
    /// # Errors
    /// A [`CaptureError`] that names a photograph that cannot be read or decoded.
    pub fn look(&self, progress: impl Fn(u64) + Sync) -> Result<Vec<Unposed>, CaptureError> {
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
    fn look(name: &str, file: &Path) -> Result<Self, CaptureError> {
        let [width, height] = size(file)?;
        decode(file, &Intrinsics::centred(width, height, 1.0))?;
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
mod tests {
    use image::RgbImage;

    use super::super::View;
    use super::super::exif::tests::{turned, write_jpeg};
    use super::super::image::load;
    use super::super::testing::assert_says;
    use super::*;

    fn picture(width: u32, height: u32) -> RgbImage {
        RgbImage::from_fn(width, height, |x, y| image::Rgb([(8 * x) as u8, (8 * y) as u8, 90]))
    }

    #[test]
    fn photographs_are_listed_by_name_without_masks_and_strangers() {
        let folder = tempfile::tempdir().unwrap();
        for name in ["b.JPG", "a/c.png", "masks/b.JPG.png", "depth/b.png", ".hidden.png", "clip.heic", "notes.txt"] {
            let path = folder.path().join(name);
            fs::create_dir_all(path.parent().unwrap()).unwrap();
            fs::write(path, "x").unwrap();
        }
        let found = PhotographFolder::list(folder.path()).unwrap();
        assert_eq!(found.names, ["a/c.png", "b.JPG"]);
        assert_eq!(found.other, [("heic".to_string(), 1)].into());
        fs::create_dir(folder.path().join("images")).unwrap();
        fs::write(folder.path().join("images/z.png"), "x").unwrap();
        let found = PhotographFolder::list(folder.path()).unwrap();
        assert_eq!((found.root, found.names), (folder.path().join("images"), vec!["z.png".to_string()]));
        assert!(PhotographFolder::list(&folder.path().join("none")).is_err());
    }

    /// COLMAP does not either: `train/tests/cli/reconstruct.rs` looks at the installed one.
    #[test]
    fn a_rotation_tag_turns_nothing() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("turned.jpg");
        write_jpeg(&file, &picture(24, 16), &[turned()]);
        let all = PhotographFolder::list(folder.path()).unwrap().look(|_| ()).unwrap();
        assert_eq!(all[0].size, [24, 16]);
        let intrinsics = Intrinsics::centred(24, 16, 20.0);
        let view = View { name: String::new(), image_path: file, intrinsics, cam_from_world: Default::default() };
        let photo = load(&view, None).unwrap();
        // Red grows to the right as stored.
        assert!(photo.rgb[3 * 20] > photo.rgb[3 * 2] + 80, "{:?}", &photo.rgb[..72]);
    }

    #[test]
    fn a_broken_photograph_is_named() {
        let folder = tempfile::tempdir().unwrap();
        picture(24, 16).save(folder.path().join("good.png")).unwrap();
        let bytes = fs::read(folder.path().join("good.png")).unwrap();
        fs::write(folder.path().join("cut.png"), &bytes[..bytes.len() - 40]).unwrap();
        let error = PhotographFolder::list(folder.path()).unwrap().look(|_| ()).unwrap_err().to_string();
        assert_says(&error, &["cut.png", "cannot decode", "export or copy it again"]);
    }

    #[test]
    fn photographs_of_one_camera_and_size_share_it() {
        let photograph = |camera: Option<&str>, focal_35mm: Option<f64>, size: [usize; 2], digest: u8| Unposed {
            name: String::new(),
            size,
            exif: Exif { camera: camera.map(str::to_owned), focal_35mm, ..Exif::default() },
            digest: [digest; 32],
        };
        let all = [
            photograph(None, None, [40, 30], 0),
            photograph(Some("A"), Some(28.0), [40, 30], 1),
            photograph(Some("A"), Some(28.01), [40, 30], 1),
            photograph(Some("A"), Some(50.0), [40, 30], 2),
            photograph(Some("A"), Some(28.0), [30, 40], 3),
        ];
        let groups = by_camera(&all);
        let members: Vec<&[usize]> = groups.iter().map(|group| &group.members[..]).collect();
        assert_eq!(members, [&[1, 2][..], &[0], &[3], &[4]]);
        assert_eq!(groups[1].focal_px, None);
        assert!((groups[0].focal_px.unwrap() - 28.0 / 43.2666 * 50.0).abs() < 1e-3);
        assert_eq!(different(&all), 4);
    }
}

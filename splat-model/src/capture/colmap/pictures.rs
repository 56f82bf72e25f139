//! Finds the pictures of a model.

use std::path::{Path, PathBuf};

use super::ImageRecord;
use crate::capture::image;
use crate::capture::names::{Names, PICTURES, SAMPLE, children, parent};

/// Where the photographs of a capture may be.
pub enum Pictures<'a> {
    /// In or around this folder, which the user named.
    Near(&'a Path),
    /// In this folder alone, beside which the cameras lie.
    In(&'a Path),
}

/// The folder that names of pictures are relative to, and the folder of the capture, which has masks and the like.
pub(super) struct Root {
    pub pictures: PathBuf,
    pub capture: PathBuf,
}

impl Pictures<'_> {
    /// The folder in which the first images of a model with the file `cameras` are. Of several it is the one whose pictures have the size of their
    /// cameras; without any it is `images`.
    pub(super) fn root(
        &self,
        cameras: &Path,
        images: &[ImageRecord],
        size: impl Fn(&ImageRecord) -> Option<[usize; 2]>,
    ) -> Root {
        let candidates = self.candidates(&parent(cameras));
        let mut names = Names::default();
        let mut first = |root: &Path| {
            let found = |image: &ImageRecord| Some((names.find(root, &image.name, &PICTURES)?, size(image)));
            images.iter().take(SAMPLE).find_map(found)
        };
        let mut of_other_size = None;
        for root in &candidates {
            if let Some((name, size)) = first(&root.pictures) {
                if image::size(&root.pictures.join(name)).is_ok_and(|found| Some(found) == size) {
                    return Root { pictures: root.pictures.clone(), capture: root.capture.clone() };
                }
                of_other_size.get_or_insert(root);
            }
        }
        let is_usual = |root: &&Root| root.pictures.ends_with("images") && root.pictures.is_dir();
        match of_other_size.or_else(|| candidates.iter().find(is_usual)) {
            Some(root) => Root { pictures: root.pictures.clone(), capture: root.capture.clone() },
            None => {
                let capture = match self {
                    Self::Near(near) => near.to_path_buf(),
                    Self::In(folder) => parent(folder),
                };
                Root { pictures: capture.join("images"), capture }
            }
        }
    }

    fn candidates(&self, model: &Path) -> Vec<Root> {
        let near = match self {
            Self::In(folder) => return vec![Root { pictures: folder.to_path_buf(), capture: parent(folder) }],
            Self::Near(near) => *near,
        };
        // Folders from the model up to the one that was named, and two more where that is the model's own, such as `CAPTURE/sparse/0`.
        let mut above = vec![model.to_owned()];
        let is_own = model == near || parent(model) == near;
        while above.len() < 6 && (is_own && above.len() < 4 || !is_own && above.last().is_some_and(|last| last != near))
        {
            above.push(parent(&above[above.len() - 1]));
        }
        let around = |capture: &PathBuf| {
            let pictures = [capture.join("images"), capture.join("input"), capture.clone()];
            pictures.map(|pictures| Root { pictures, capture: capture.clone() })
        };
        let beside = |pictures: PathBuf| Root { pictures, capture: near.to_owned() };
        above.iter().flat_map(around).chain(children(near).into_iter().map(beside)).collect()
    }
}

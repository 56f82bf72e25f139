//! Finds the files of a folder's model.

use std::fs;
use std::path::{Path, PathBuf};

use super::{CaptureError, Result, binary, parse, text};

pub(in crate::capture) const SPARSE: &str = "sparse";

/// The paths of a model's files, each binary or text by its extension.
#[derive(Clone)]
pub(super) struct ModelFiles {
    pub cameras: PathBuf,
    pub images: PathBuf,
    /// The file of points, which need not exist.
    pub points: PathBuf,
}

impl ModelFiles {
    /// The files of one encoding, "bin" or "txt".
    pub(super) fn encoded(model: &Path, extension: &str) -> Self {
        let [cameras, images, points] =
            ["cameras", "images", "points3D"].map(|name| model.join(name).with_extension(extension));
        Self { cameras, images, points }
    }
}

/// Whether a folder holds a model; its points may be missing.
pub(in crate::capture) fn is_complete(model: &Path) -> bool {
    of_model(model).is_ok()
}

/// One of some models, and a note for the user about the choice. COLMAP leaves several, `sparse/0`, `sparse/1` and so on, where it could not register all photographs together; the choice
/// is the first of those with the most photographs.
///
/// # Errors
/// If there is none, or the photographs of one of several cannot be counted.
pub(super) fn find(models: &[PathBuf]) -> Result<(ModelFiles, Option<String>)> {
    let complete: Vec<(&PathBuf, ModelFiles)> =
        models.iter().filter_map(|model| Some((model, of_model(model).ok()?))).collect();
    let [_, _, ..] = complete.as_slice() else {
        let only = complete.into_iter().next().map(|(_, files)| Ok(files));
        return Ok((only.unwrap_or_else(|| of_model(&models[0]))?, None));
    };
    let mut counted = Vec::with_capacity(complete.len());
    for (model, files) in complete {
        let images = parse(&files.images, binary::images, text::images)?.len();
        counted.push((images, model, files));
    }
    // A stable sort keeps the first of the largest in front.
    counted.sort_by_key(|(images, ..)| std::cmp::Reverse(*images));
    let above = models[0].parent().and_then(Path::parent).unwrap_or(Path::new(""));
    let name = |model: &Path| model.strip_prefix(above).unwrap_or(model).display().to_string();
    let others = counted[1..].iter().map(|(images, model, _)| format!("{} has {images}", name(model)));
    let remark = format!(
        "{} models: {}, the largest, is taken, with {} photographs; {}",
        counted.len(),
        name(counted[0].1),
        counted[0].0,
        others.collect::<Vec<_>>().join(", ")
    );
    let (_, _, files) = counted.swap_remove(0);
    Ok((files, Some(remark)))
}

/// The folders of models that a folder such as `sparse` may hold: the numbered ones, in order, or else the folder itself.
pub(in crate::capture) fn models_in(folder: &Path) -> Vec<PathBuf> {
    let entries = fs::read_dir(folder).into_iter().flatten().flatten();
    let numbered = entries.filter_map(|entry| {
        let number: u32 = entry.file_name().to_str()?.parse().ok()?;
        entry.path().is_dir().then(|| (number, entry.path()))
    });
    let mut numbered: Vec<(u32, PathBuf)> = numbered.collect();
    numbered.sort();
    if numbered.is_empty() { vec![folder.to_owned()] } else { numbered.into_iter().map(|(_, path)| path).collect() }
}

/// The model's files, binary before text. Cameras and images must be of one encoding, because a stale file of the other
/// may lie beside them; points refer to nothing and are taken as they come.
pub(super) fn of_model(model: &Path) -> Result<ModelFiles> {
    let [binary, text] = ["bin", "txt"].map(|extension| ModelFiles::encoded(model, extension));
    for (files, other) in [(&binary, &text), (&text, &binary)] {
        if files.cameras.exists() && files.images.exists() {
            let points = if files.points.exists() { &files.points } else { &other.points };
            return Ok(ModelFiles { points: points.clone(), ..files.clone() });
        }
    }
    let no_cameras = !binary.cameras.exists() && !text.cameras.exists();
    let no_images = !binary.images.exists() && !text.images.exists();
    let (cameras, images) = ([binary.cameras, text.cameras], [binary.images, text.images]);
    let (what, looked_for) = match (no_cameras, no_images) {
        (true, true) => ("COLMAP model", [cameras, images].concat()),
        (true, false) => ("cameras", cameras.to_vec()),
        (false, true) => ("images", images.to_vec()),
        (false, false) => ("cameras and images of one encoding", [cameras, images].concat()),
    };
    Err(CaptureError::Missing {
        what,
        looked_for,
        fix: "Name the folder that holds `images/` and `sparse/0/`, or `transforms.json`; make a model with `splat reconstruct` or `colmap mapper`, or convert one with \
              `colmap model_converter`",
    })
}

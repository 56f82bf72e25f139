//! Cameras in JSON: `transforms.json` of instant-ngp and nerfstudio, `transforms_train.json` and its siblings of
//! NeRF-synthetic (Mildenhall et al. 2020).
//!
//! Formats: <https://docs.nerf.studio/quickstart/data_conventions.html>, and instant-ngp's `docs/nerf_dataset_tips.md`. Each of
//! `frames` has a `file_path` and a `transform_matrix`, which takes the camera's coordinates to the world's, with
//! OpenGL's axes: +x right, +y up, +z back (see [`camera::pose`]). Lens parameters stand beside `frames` or in a
//! frame, where they apply to that frame alone; pixel centres are at +0.5. The world is that of the file:
//! `applied_transform`, `applied_scale`, `scale`, `offset` and `aabb_scale`, which record how it was made or how one
//! program frames it, are ignored, and so are depth maps (`depth_file_path`).
//!
//! A name in JSON is a path relative to the file's folder and may not leave it. A `file_path` without an extension
//! means the `.png`, `.jpg` or `.jpeg` that exists. Where `w` and `h` are missing, they come from the picture's header.

mod camera;
mod json;

#[cfg(test)]
mod tests;

use std::collections::{BTreeSet, HashMap};
use std::io;
use std::path::{Component, Path, PathBuf};

use self::camera::Lenses;
use self::json::{Fields, Value};
use super::read::{Place, PlaceInFile, quoted, read, regular_size, unreadable};
use super::{Capture, CaptureError, Split, View};
use crate::ply;

/// NeRF-synthetic's file of training frames.
const TRAIN: &str = "transforms_train.json";
/// NeRF-synthetic's file of test frames, then its substitutes; the first that exists is read.
const HELD_OUT: [&str; 2] = ["transforms_test.json", "transforms_val.json"];
/// The file of instant-ngp and nerfstudio.
const SINGLE: &str = "transforms.json";

/// The largest accepted file. A frame takes about a kilobyte.
const MAX_BYTES: u64 = 256 << 20;

/// The longest accepted path; messages name several on one screen.
const MAX_PATH_BYTES: usize = 400;

/// Appended to a `file_path` without an extension, in this order.
const EXTENSIONS: [&str; 3] = ["png", "jpg", "jpeg"];

impl Place<'_> {
    /// The value of an optional field; `null` counts as absent.
    fn optional<'a, T>(
        &self,
        fields: &'a Fields,
        field: &'static str,
        typed: impl FnOnce(&'a Value) -> Result<T, String>,
        expected: &str,
    ) -> Result<Option<T>, CaptureError> {
        match fields.get(field) {
            Value::Null => Ok(None),
            value => typed(value).map(Some).map_err(|found| self.refuse(field, found, expected)),
        }
    }

    /// The value of a required field.
    fn required<'a, T>(
        &self,
        fields: &'a Fields,
        field: &'static str,
        typed: impl FnOnce(&'a Value) -> Result<T, String>,
        expected: &str,
    ) -> Result<T, CaptureError> {
        self.optional(fields, field, typed, expected)?.ok_or_else(|| self.refuse(field, "missing", expected))
    }

    /// A path relative to the file's folder, without `.`. It must stay below that folder.
    fn path(&self, field: &'static str, path: &str) -> Result<String, CaptureError> {
        let refuse = || {
            self.refuse_with(
                field,
                quoted(path),
                "a path of at most 400 bytes below the folder of the file, neither absolute nor with `..`",
                "Move the file to the folder that holds the pictures, and correct its paths",
            )
        };
        let mut parts = Vec::new();
        for part in Path::new(path).components() {
            match part {
                Component::Normal(part) => parts.push(part.to_str().ok_or_else(refuse)?),
                Component::CurDir => {}
                _ => return Err(refuse()),
            }
        }
        let odd = parts.is_empty() || path.len() > MAX_PATH_BYTES || path.contains(char::is_control);
        if odd { Err(refuse()) } else { Ok(parts.join("/")) }
    }
}

/// Whether the folder holds a file of this format.
pub(super) fn is_there(folder: &Path) -> bool {
    [TRAIN, SINGLE].iter().any(|name| folder.join(name).is_file())
}

/// See [`Capture::load`].
pub(super) fn load(folder: &Path) -> Result<Capture, CaptureError> {
    let mut reading = Reading { folder, files: Vec::new(), named: HashMap::new(), views: Vec::new(), points: None };
    let train = folder.join(TRAIN);
    let split = if train.is_file() {
        let count = reading.add(&train)?.0;
        let held_out = HELD_OUT.iter().map(|name| folder.join(name)).find(|file| file.is_file());
        match held_out {
            Some(file) => {
                let both = reading.add(&file)?.0;
                Some(Split { train: (0..count).collect(), test: (count..both).collect() })
            }
            None => None,
        }
    } else {
        let file = folder.join(SINGLE);
        let (_, fields) = reading.add(&file)?;
        reading.split(&file, &fields)?
    };
    reading.finish(split)
}

/// The lists of file names that nerfstudio knows: for training, validation and testing.
const LISTS: [&str; 3] = ["train_filenames", "val_filenames", "test_filenames"];

/// The capture as read so far.
struct Reading<'a> {
    folder: &'a Path,
    files: Vec<PathBuf>,
    /// The view of a name, by its picture's name and by its name in the file.
    named: HashMap<String, usize>,
    /// The views, with their masks where they name one.
    views: Vec<(View, Option<PathBuf>)>,
    points: Option<PathBuf>,
}

impl Reading<'_> {
    /// Reads a file and adds its frames. Returns the number of views so far and the file's fields.
    fn add(&mut self, file: &Path) -> Result<(usize, Fields), CaptureError> {
        let bytes = regular_size(file).map_err(|reason| unreadable(file, reason))?;
        if bytes > MAX_BYTES {
            let reason = format!("it has {bytes} bytes, expected at most {MAX_BYTES}");
            return Err(unreadable(file, io::Error::new(io::ErrorKind::FileTooLarge, reason)));
        }
        let fields = json::parse(file, &read(file)?)?;
        let whole = Place::new(file, PlaceInFile::Whole);
        let frames = whole.required(&fields, "frames", Value::list, "a list of frames")?;
        if frames.is_empty() {
            return Err(CaptureError::NoViews { file: file.to_owned() });
        }
        for (index, frame) in frames.iter().enumerate() {
            self.add_frame(file, index, frame, &fields)?;
        }
        if let Some(points) = whole.optional(&fields, "ply_file_path", Value::text, "the path of a PLY file")? {
            self.points = Some(self.folder.join(whole.path("ply_file_path", points)?));
        }
        self.files.push(file.to_owned());
        Ok((self.views.len(), fields))
    }

    fn add_frame(&mut self, file: &Path, index: usize, frame: &Value, of_file: &Fields) -> Result<(), CaptureError> {
        const PICTURE: &str = "the path of a picture";
        let place = Place::new(file, PlaceInFile::Frame(index));
        let frame = frame.fields().map_err(|found| place.refuse("frames", found, "a frame, which is an object"))?;
        let stated = place.required(frame, "file_path", Value::text, PICTURE)?;
        let place = place.of_path(stated);
        let matrix = place.required(frame, "transform_matrix", Value::matrix, json::MATRIX)?;
        let cam_from_world = camera::pose(&place, matrix)?;
        let stated = place.path("file_path", stated)?;
        let name = self.picture(&stated)?;
        let image_path = self.folder.join(&name);
        let intrinsics = Lenses { place, frame, file: of_file }.intrinsics(&image_path)?;
        let mask = place.optional(frame, "mask_path", Value::text, PICTURE)?;
        let mask = mask.map(|path| place.path("mask_path", path)).transpose()?;
        let view = self.views.len();
        if self.named.insert(name.clone(), view).is_some() {
            let found = format!("{} again", quoted(&name));
            return Err(place.refuse("file_path", found, "a picture of its own for each frame"));
        }
        self.named.entry(stated).or_insert(view);
        let mask = mask.map(|path| self.folder.join(path));
        self.views.push((View { name, image_path, intrinsics, cam_from_world }, mask));
        Ok(())
    }

    /// The path of a picture with its extension.
    fn picture(&self, stated: &str) -> Result<String, CaptureError> {
        let extension = Path::new(stated).extension().and_then(|extension| extension.to_str());
        let known = |extension: &str| EXTENSIONS.iter().any(|known| known.eq_ignore_ascii_case(extension));
        if extension.is_some_and(known) || self.folder.join(stated).is_file() {
            return Ok(stated.to_owned());
        }
        let candidates = EXTENSIONS.map(|extension| format!("{stated}.{extension}"));
        let found = candidates.iter().find(|name| self.folder.join(name).is_file());
        found.cloned().ok_or_else(|| CaptureError::Missing {
            what: "picture",
            looked_for: candidates.iter().map(|name| self.folder.join(name)).collect(),
            fix: "Copy the pictures to where `file_path` says, from the folder of the JSON file",
        })
    }

    /// The split given by the lists, if there are any. Validation views replace missing test views. Views
    /// in no list are for training if there is no training list, and held out if that is the only list.
    fn split(&self, file: &Path, fields: &Fields) -> Result<Option<Split>, CaptureError> {
        let place = Place::new(file, PlaceInFile::Whole);
        let listed = |field| -> Result<Option<BTreeSet<usize>>, CaptureError> {
            let Some(list) = place.optional(fields, field, Value::texts, "a list of paths")? else { return Ok(None) };
            let view = |path: &str| {
                let unknown = || place.refuse(field, quoted(path), "the `file_path` of a frame");
                self.named.get(&place.path(field, path)?).copied().ok_or_else(unknown)
            };
            list.into_iter().map(view).collect::<Result<_, _>>().map(Some)
        };
        let [train, val, test] = [listed(LISTS[0])?, listed(LISTS[1])?, listed(LISTS[2])?];
        if [&train, &val, &test].into_iter().all(Option::is_none) {
            return Ok(None);
        }
        let unlisted = |lists: [&Option<BTreeSet<usize>>; 2]| -> BTreeSet<usize> {
            let listed = |view: &usize| lists.into_iter().flatten().any(|list| list.contains(view));
            (0..self.views.len()).filter(|view| !listed(view)).collect()
        };
        let held_out = match (&val, &test) {
            (None, None) => unlisted([&train, &None]),
            (_, Some(test)) if !test.is_empty() => test.clone(),
            _ => val.clone().unwrap_or_default(),
        };
        let train = train.unwrap_or_else(|| unlisted([&val, &test]));
        if let Some(&both) = train.intersection(&held_out).next() {
            let found = format!("{}, which is held out too", quoted(&self.views[both].0.name));
            return Err(place.refuse(LISTS[0], found, "names that are in no other list"));
        }
        Ok(Some(Split { train: train.into_iter().collect(), test: held_out.into_iter().collect() }))
    }

    /// The capture, its views in order of name.
    fn finish(self, split: Option<Split>) -> Result<Capture, CaptureError> {
        let (positions, colours) = match &self.points {
            Some(file) => {
                regular_size(file).map_err(|reason| unreadable(file, reason))?;
                ply::read_points(file).map_err(CaptureError::Points)?
            }
            None => Default::default(),
        };
        let mut views: Vec<_> = self.views.into_iter().enumerate().collect();
        views.sort_by(|(_, (a, _)), (_, (b, _))| a.name.cmp(&b.name));
        let mut ranks = vec![0; views.len()];
        views.iter().enumerate().for_each(|(rank, (view, _))| ranks[*view] = rank);
        let ranked = |list: Vec<usize>| -> Vec<usize> {
            list.into_iter().map(|view| ranks[view]).collect::<BTreeSet<_>>().into_iter().collect()
        };
        let split = split.map(|Split { train, test }| Split { train: ranked(train), test: ranked(test) });
        let (views, masks) = views.into_iter().map(|(_, view)| view).unzip();
        let files = self.files.into_iter().chain(self.points).collect();
        Ok(Capture { split, masks, files, ..Capture::near_zero(self.folder, views, &positions, colours) })
    }
}

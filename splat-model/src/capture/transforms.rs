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
use std::fmt;
use std::fs;
use std::io;
use std::path::{Component, Path, PathBuf};

use glam::DAffine3;

use self::camera::Lenses;
use self::json::{Field, File, TransformsFrame};
use super::colmap::quoted;
use super::{Capture, CaptureError, PointCloud, Split, View, origin};
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

const CORRECT: &str = "Correct the file, or export it again";

/// An entry of a file, as errors name it.
#[derive(Clone, Copy, Debug)]
struct TransformsEntry<'a> {
    file: &'a Path,
    /// The frame's index, from 0, and its `file_path`; none for fields beside `frames`.
    frame: Option<(usize, &'a str)>,
}

impl fmt::Display for TransformsEntry<'_> {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.frame {
            Some((index, "")) => write!(out, "frame {index}"),
            Some((index, path)) => write!(out, "frame {index} ({})", quoted(path)),
            None => out.write_str("the file as a whole"),
        }
    }
}

impl TransformsEntry<'_> {
    fn refuse(&self, field: &'static str, found: impl fmt::Display, expected: impl fmt::Display) -> CaptureError {
        self.refuse_with(field, found, expected, CORRECT)
    }

    fn refuse_with(
        &self,
        field: &'static str,
        found: impl fmt::Display,
        expected: impl fmt::Display,
        fix: &'static str,
    ) -> CaptureError {
        let (found, expected) = (found.to_string().into(), expected.to_string().into());
        CaptureError::Entry { file: self.file.to_owned(), place: self.to_string(), field, found, expected, fix }
    }

    /// The value of an optional field.
    fn optional<'a, T>(
        &self,
        field: &'static str,
        value: &'a Field<T>,
        expected: &str,
    ) -> Result<Option<&'a T>, CaptureError> {
        match value {
            Field::Absent => Ok(None),
            Field::Is(value) => Ok(Some(value)),
            Field::Wrong(found) => Err(self.refuse(field, found, expected)),
        }
    }

    /// The value of a required field.
    fn required<'a, T>(&self, field: &'static str, value: &'a Field<T>, expected: &str) -> Result<&'a T, CaptureError> {
        self.optional(field, value, expected)?.ok_or_else(|| self.refuse(field, "missing", expected))
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
    let mut reading = Reading { folder, named: HashMap::new(), views: Vec::new(), points: None };
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
        let (_, lists) = reading.add(&file)?;
        reading.split(&file, lists)?
    };
    reading.finish(split)
}

/// The lists of file names that nerfstudio knows: for training, validation and testing.
type SplitLists = [Field<Vec<String>>; 3];

/// The JSON fields of those lists.
const LISTS: [&str; 3] = ["train_filenames", "val_filenames", "test_filenames"];

/// The capture as read so far.
struct Reading<'a> {
    folder: &'a Path,
    /// The view of a name, by its picture's name and by its name in the file.
    named: HashMap<String, usize>,
    /// The views, with their masks where they name one.
    views: Vec<(View, Option<PathBuf>)>,
    points: Option<PathBuf>,
}

impl Reading<'_> {
    /// Reads a file and adds its frames. Returns the number of views so far and the file's lists.
    fn add(&mut self, path: &Path) -> Result<(usize, SplitLists), CaptureError> {
        let whole = TransformsEntry { file: path, frame: None };
        let File { frames, lenses, points, lists } = json::parse(path, &read(path)?)?;
        whole.required("frames", &frames, "a list of frames")?;
        let Field::Is(frames) = frames else { return Err(CaptureError::NoViews { file: path.to_owned() }) };
        if frames.is_empty() {
            return Err(CaptureError::NoViews { file: path.to_owned() });
        }
        for (index, frame) in frames.into_iter().enumerate() {
            self.add_frame(path, index, &frame, &lenses)?;
        }
        if let Some(points) = whole.optional("ply_file_path", &points, "the path of a PLY file")? {
            self.points = Some(self.folder.join(whole.path("ply_file_path", points)?));
        }
        Ok((self.views.len(), lists))
    }

    fn add_frame(
        &mut self,
        file: &Path,
        index: usize,
        frame: &TransformsFrame,
        of_file: &json::LensFields,
    ) -> Result<(), CaptureError> {
        let place = TransformsEntry { file, frame: Some((index, "")) };
        let stated = place.required("file_path", &frame.path, "the path of a picture")?;
        let place = TransformsEntry { file, frame: Some((index, stated)) };
        let matrix = place.required("transform_matrix", &frame.matrix, json::MATRIX)?;
        let cam_from_world = camera::pose(&place, matrix)?;
        let stated = place.path("file_path", stated)?;
        let name = self.picture(&stated)?;
        let image_path = self.folder.join(&name);
        let intrinsics = Lenses { place, frame: frame.lens.as_deref(), file: of_file }.intrinsics(&image_path)?;
        let mask = match place.optional("mask_path", &frame.mask, "the path of a picture")? {
            Some(path) => Some(self.folder.join(place.path("mask_path", path)?)),
            None => None,
        };
        let view = self.views.len();
        if self.named.insert(name.clone(), view).is_some() {
            return Err(place.refuse(
                "file_path",
                format!("{} again", quoted(&name)),
                "a picture of its own for each frame",
            ));
        }
        self.named.entry(stated).or_insert(view);
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
    fn split(&self, file: &Path, lists: SplitLists) -> Result<Option<Split>, CaptureError> {
        let place = TransformsEntry { file, frame: None };
        let mut listed: [Option<BTreeSet<usize>>; 3] = [None, None, None];
        for ((field, list), views) in LISTS.into_iter().zip(&lists).zip(&mut listed) {
            let Some(list) = place.optional(field, list, "a list of paths")? else { continue };
            let view = |path: &String| {
                let named = place.path(field, path)?;
                let unknown = || place.refuse(field, quoted(path), "the `file_path` of a frame");
                self.named.get(&named).copied().ok_or_else(unknown)
            };
            *views = Some(list.iter().map(view).collect::<Result<_, _>>()?);
        }
        let [train, val, test] = listed;
        if train.is_none() && val.is_none() && test.is_none() {
            return Ok(None);
        }
        let filled = |set: &Option<BTreeSet<usize>>| set.as_ref().is_some_and(|set| !set.is_empty());
        let all = || (0..self.views.len()).collect::<BTreeSet<usize>>();
        let none = BTreeSet::new();
        let others = |of: [&Option<BTreeSet<usize>>; 2]| {
            all()
                .into_iter()
                .filter(|view| !of.iter().any(|set| set.as_ref().unwrap_or(&none).contains(view)))
                .collect()
        };
        let held_out = match (filled(&test), val.is_none() && test.is_none()) {
            (true, _) => test.clone().unwrap_or_default(),
            (false, false) => val.clone().unwrap_or_default(),
            (false, true) => others([&train, &None]),
        };
        let train = train.unwrap_or_else(|| others([&val, &test]));
        if let Some(&both) = train.intersection(&held_out).next() {
            let found = format!("{}, which is held out too", quoted(&self.views[both].0.name));
            return Err(place.refuse(LISTS[0], found, "names that are in no other list"));
        }
        Ok(Some(Split { train: train.into_iter().collect(), test: held_out.into_iter().collect() }))
    }

    /// The capture, its views in order of name.
    fn finish(self, split: Option<Split>) -> Result<Capture, CaptureError> {
        let Self { folder, mut views, points, .. } = self;
        let (positions, colours) = match points {
            Some(file) => {
                check_regular(&file)?;
                ply::read_points(&file).map_err(CaptureError::Points)?
            }
            None => Default::default(),
        };
        let mut order: Vec<usize> = (0..views.len()).collect();
        order.sort_by(|&a, &b| views[a].0.name.cmp(&views[b].0.name));
        let mut ranks = vec![0; views.len()];
        order.iter().enumerate().for_each(|(rank, &view)| ranks[view] = rank);
        let split = split.map(|mut split| {
            for list in [&mut split.train, &mut split.test] {
                list.iter_mut().for_each(|view| *view = ranks[*view]);
                list.sort_unstable();
            }
            split
        });
        views.sort_by(|a, b| a.0.name.cmp(&b.0.name));
        let (mut views, masks): (Vec<View>, Vec<Option<PathBuf>>) = views.into_iter().unzip();
        let poses: Vec<DAffine3> = views.iter().map(|view| view.cam_from_world).collect();
        let origin = origin::choose(&poses);
        for view in &mut views {
            view.cam_from_world = origin::moved(&view.cam_from_world, origin);
        }
        let positions = positions.iter().map(|&position| (position - origin).as_vec3().to_array()).collect();
        let points = PointCloud { positions, colours };
        Ok(Capture {
            folder: folder.to_owned(),
            views,
            points,
            tracks: Default::default(),
            origin,
            split,
            masks,
            remarks: Vec::new(),
        })
    }
}

/// The size of a regular file in bytes. A pipe would never end.
fn check_regular(file: &Path) -> Result<u64, CaptureError> {
    let fail = |reason| cannot_read(file, reason);
    let metadata = fs::metadata(file).map_err(fail)?;
    match metadata.is_file() {
        true => Ok(metadata.len()),
        false => Err(fail(io::Error::new(io::ErrorKind::InvalidInput, "not a regular file"))),
    }
}

fn cannot_read(file: &Path, reason: io::Error) -> CaptureError {
    CaptureError::Read { file: file.to_owned(), reason, fix: "Check that it is an ordinary file which you may read" }
}

fn read(file: &Path) -> Result<Vec<u8>, CaptureError> {
    let bytes = check_regular(file)?;
    if bytes > MAX_BYTES {
        let reason =
            io::Error::new(io::ErrorKind::FileTooLarge, format!("it has {bytes} bytes, expected at most {MAX_BYTES}"));
        return Err(cannot_read(file, reason));
    }
    fs::read(file).map_err(|reason| cannot_read(file, reason))
}

//! Cameras in JSON: `transforms.json` of instant-ngp and nerfstudio, `transforms_train.json` and its siblings of
//! NeRF-synthetic (Mildenhall et al. 2020).
//!
//! Formats: <https://docs.nerf.studio/quickstart/data_conventions.html>, and instant-ngp's `docs/nerf_dataset_tips.md`. Each of `frames`
//! has a `file_path` and a `transform_matrix`, which takes the camera's coordinates to the world's, with OpenGL's axes: +x right, +y up, +z
//! back (see [`camera::pose`]). Lens parameters stand beside `frames` or in a frame, where they apply to that frame alone; pixel centres
//! are at +0.5. The world is that of the file: `applied_transform`, `applied_scale`, `scale`, `offset` and `aabb_scale`, which record how
//! it was made or how one program frames it, are ignored, and so are depth maps (`depth_file_path`).
//!
//! A name in JSON is a path relative to the file's folder and may not leave it. A `file_path` without an extension
//! means the `.png`, `.jpg` or `.jpeg` that exists, and one that exists only with a second extension or in another letter case means that
//! (see [`Names`]). Where `w` and `h` are missing, they come from the picture's header.

pub(super) mod camera;
mod json;
mod keyframes;

#[cfg(test)]
mod tests;

use std::collections::{BTreeSet, HashMap};
use std::io;
use std::path::{Path, PathBuf};

use serde::de::DeserializeOwned;

use self::camera::Lenses;
pub(super) use self::json::Fields;
pub use self::keyframes::read_keyframes;
use super::names::{Names, PICTURES, below, entries, missing_photographs, parent};
use super::read::{Place, PlaceInFile, quoted, read, regular_size, unreadable};
use super::{Capture, CaptureError, CaptureFormat, Pictures, Result, Split, View, colmap};
use crate::encoding::utf8;
use crate::ply;

/// NeRF-synthetic's file of training frames.
const TRAIN: &str = "transforms_train.json";
/// NeRF-synthetic's file of test frames, then its substitutes; the first that exists is read.
const HELD_OUT: [&str; 2] = ["transforms_test.json", "transforms_val.json"];
/// The file of instant-ngp and nerfstudio.
const SINGLE: &str = "transforms.json";

/// The largest accepted file. A frame takes about a kilobyte.
pub(super) const MAX_BYTES: u64 = 256 << 20;

/// The longest accepted path; messages name several on one screen.
const MAX_PATH_BYTES: usize = 400;

impl Place<'_> {
    /// The value of a required field.
    fn required<T>(&self, field: &'static str, value: Option<T>, expected: &str) -> Result<T> {
        value.ok_or_else(|| self.refuse(field, "missing", expected))
    }

    /// A path relative to the file's folder, without `.`. It must stay below that folder.
    fn path(&self, field: &'static str, path: &str) -> Result<String> {
        let refuse = || {
            self.refuse_with(
                field,
                quoted(path),
                "a path of at most 400 bytes below the folder of the file, neither absolute nor with `..`",
                "Move the file to the folder that holds the pictures, and correct its paths",
            )
        };
        let is_plain = path.len() <= MAX_PATH_BYTES && !path.contains(char::is_control);
        below(path).filter(|_| is_plain).ok_or_else(refuse)
    }
}

/// The format.
pub(super) struct Json;

impl CaptureFormat for Json {
    fn name(&self) -> &'static str {
        "JSON"
    }

    /// The file of NeRF-synthetic, or else of instant-ngp and nerfstudio.
    fn usual(&self, folder: &Path) -> Vec<PathBuf> {
        let files = [TRAIN, SINGLE].map(|name| folder.join(name));
        files.into_iter().find(|file| file.is_file()).into_iter().collect()
    }

    /// All files with frames.
    fn here(&self, folder: &Path) -> Vec<Vec<PathBuf>> {
        each(folder, has_frames)
    }

    fn of_file(&self, file: &Path) -> Vec<PathBuf> {
        if has_frames(file) { vec![file.to_owned()] } else { Vec::new() }
    }

    fn load(&self, files: &[PathBuf], _: &Pictures) -> Result<Capture> {
        load(&files[0])
    }
}

/// Whether a file is JSON with frames that have poses.
fn has_frames(file: &Path) -> bool {
    holds(file, "json", &["\"frames\"", "\"transform_matrix\""])
}

/// The files of a folder that are cameras, in order, each on its own.
pub(super) fn each(folder: &Path, is_cameras: impl Fn(&Path) -> bool) -> Vec<Vec<PathBuf>> {
    let mut files: Vec<PathBuf> = entries(folder).filter(|file| is_cameras(file)).collect();
    files.sort();
    files.into_iter().map(|file| vec![file]).collect()
}

/// Whether a file has an extension, if one is given, and holds some words.
pub(super) fn holds(file: &Path, extension: &str, words: &[&str]) -> bool {
    let is_kind = file.extension().unwrap_or_default().eq_ignore_ascii_case(extension);
    let is_small = is_kind && regular_size(file).is_ok_and(|bytes| bytes <= MAX_BYTES);
    let text = if is_small { read(file).map(utf8).unwrap_or_default() } else { Vec::new() };
    words.iter().all(|word| text.windows(word.len()).any(|part| part == word.as_bytes()))
}

/// Reads the text of a file of at most [`MAX_BYTES`].
pub(super) fn text(file: &Path) -> Result<Vec<u8>> {
    let bytes = regular_size(file).map_err(|reason| unreadable(file, reason))?;
    if bytes > MAX_BYTES {
        let reason = format!("it has {bytes} bytes, expected at most {MAX_BYTES}");
        return Err(unreadable(file, io::Error::new(io::ErrorKind::FileTooLarge, reason)));
    }
    read(file).map(utf8)
}

/// Reads a JSON file of at most [`MAX_BYTES`].
pub(super) fn read_json<T: DeserializeOwned>(file: &Path) -> Result<T> {
    json::parse(file, &text(file)?)
}

/// The capture of frames that `file` holds in a format of its own, with names below `folder`, and points of a PLY file beside.
pub(super) fn of_frames(folder: PathBuf, file: &Path, frames: Vec<Fields>, remarks: Vec<String>) -> Result<Capture> {
    let points = colmap::point_file([&parent(file), &folder]);
    let mut reading = Reading { folder, remarks, ..Reading::default() };
    reading.remarks.extend(points.iter().map(|points| format!("the points are read from {}", points.display())));
    reading.points = points;
    reading.add(file, &Fields { frames: Some(frames), ..Fields::default() })?;
    reading.finish(None)
}

/// Loads a JSON file: with its test frames if it is NeRF-synthetic's, and else with the split that it states.
pub(super) fn load(file: &Path) -> Result<Capture> {
    let mut reading = Reading { folder: parent(file), ..Reading::default() };
    let fields: Fields = read_json(file)?;
    reading.add(file, &fields)?;
    if !file.ends_with(TRAIN) {
        let split = reading.split(file, &fields)?;
        return reading.finish(split);
    }
    let count = reading.views.len();
    for file in HELD_OUT.map(|name| reading.folder.join(name)).iter().filter(|file| file.is_file()) {
        let fields: Fields = read_json(file)?;
        if reading.has_pictures(file, &fields)? {
            reading.add(file, &fields)?;
            let test = (count..reading.views.len()).collect();
            return reading.finish(Some(Split { train: (0..count).collect(), test }));
        }
    }
    reading.finish(None)
}

/// The capture as read so far.
#[derive(Default)]
struct Reading {
    folder: PathBuf,
    /// The view of a name, by its picture's name and by its name in the file.
    named: HashMap<String, usize>,
    /// The views, with their masks where they name one.
    views: Vec<(View, Option<PathBuf>)>,
    points: Option<PathBuf>,
    /// Files that were read.
    files: Vec<PathBuf>,
    names: Names,
    remarks: Vec<String>,
}

impl Reading {
    fn add(&mut self, file: &Path, fields: &Fields) -> Result<()> {
        let whole = Place::new(file, PlaceInFile::Whole);
        let frames = whole.required("frames", fields.frames.as_deref(), "a list of frames")?;
        if frames.is_empty() {
            return Err(CaptureError::no_views(file));
        }
        for (index, frame) in frames.iter().enumerate() {
            match self.add_frame(file, index, frame, fields) {
                // One picture that is missing may stand for many.
                Err(CaptureError::Missing { .. }) => return Err(self.missing(file, frames)),
                added => added?,
            }
        }
        if let Some(points) = &fields.ply_file_path {
            let points = whole.path("ply_file_path", points)?;
            self.points = Some(self.folder.join(self.names.find(&self.folder, &points, &[]).unwrap_or(points)));
        }
        self.files.push(file.to_owned());
        Ok(())
    }

    /// The names of a file's pictures, and whether each is there.
    fn pictures(&mut self, frames: &[Fields]) -> Vec<(String, bool)> {
        let stated = frames.iter().filter_map(|frame| below(frame.file_path.as_deref()?));
        let mut is_there = |name: &str| self.names.find(&self.folder, name, &PICTURES).is_some();
        stated.map(|name| (name.clone(), is_there(&name))).collect()
    }

    /// Whether any picture of the frames for testing is there: BlenderNeRF writes their poses alone.
    fn has_pictures(&mut self, file: &Path, fields: &Fields) -> Result<bool> {
        let Some(frames) = &fields.frames else { return Ok(true) };
        let pictures = self.pictures(frames);
        let Some((first, _)) = pictures.first().filter(|_| pictures.iter().all(|(_, is_there)| !is_there)) else {
            return Ok(true);
        };
        self.remarks.push(format!(
            "{} is left out, because none of its {} pictures is there, the first of them {first}; other photographs are held out",
            file.display(),
            pictures.len()
        ));
        self.files.push(file.to_owned());
        Ok(false)
    }

    /// The error for a file of whose pictures some are missing.
    fn missing(&mut self, file: &Path, frames: &[Fields]) -> CaptureError {
        let pictures = self.pictures(frames);
        let missing = pictures.iter().filter(|(_, is_there)| !is_there).map(|(name, _)| self.folder.join(name));
        missing_photographs(&missing.collect::<Vec<_>>(), pictures.len(), file)
    }

    fn add_frame(&mut self, file: &Path, index: usize, frame: &Fields, of_file: &Fields) -> Result<()> {
        let place = Place::new(file, PlaceInFile::Frame(index));
        let stated = place.required("file_path", frame.file_path.as_deref(), "the path of a picture")?;
        let place = Place { path: stated, ..place };
        let cam_from_world = camera::pose(&place, "transform_matrix", frame.matrix(&place)?)?;
        let stated = place.path("file_path", stated)?;
        let name = self.names.find(&self.folder, &stated, &PICTURES);
        let has_extension = Path::new(&stated).extension().and_then(|extension| extension.to_str());
        let has_extension = has_extension.is_some_and(|of| PICTURES.iter().any(|known| known.eq_ignore_ascii_case(of)));
        let name = name.or_else(|| has_extension.then(|| stated.clone())).ok_or_else(|| CaptureError::Missing {
            what: "picture",
            looked_for: vec![self.folder.join(&stated)],
            fix: "",
        })?;
        let image_path = self.folder.join(&name);
        let (intrinsics, cut) = Lenses { place, frame, file: of_file }.intrinsics(&image_path)?;
        let mask = frame.mask_path.as_deref().map(|path| place.path("mask_path", path)).transpose()?;
        let mask = mask.map(|path| self.names.find(&self.folder, &path, &[]).unwrap_or(path));
        let view = self.views.len();
        if self.named.insert(name.clone(), view).is_some() {
            let found = format!("{} again", quoted(&name));
            return Err(place.refuse("file_path", found, "a picture of its own for each frame"));
        }
        self.named.entry(stated).or_insert(view);
        let mask = mask.map(|path| self.folder.join(path));
        self.views.push((View { name, image_path, intrinsics, cam_from_world, cut }, mask));
        Ok(())
    }

    /// The split given by the lists, if there are any. Validation views replace missing test views. Views
    /// in no list are for training if there is no training list, and held out if that is the only list.
    fn split(&self, file: &Path, fields: &Fields) -> Result<Option<Split>> {
        let place = Place::new(file, PlaceInFile::Whole);
        let listed = |field, list: &Option<Vec<String>>| -> Result<Option<BTreeSet<usize>>> {
            let view = |path: &String| {
                let unknown = || place.refuse(field, quoted(path), "the `file_path` of a frame");
                let path = place.path(field, path)?;
                let found = self.named.get(&path).or_else(|| self.named.get(&path.replace('\\', "/")));
                found.copied().ok_or_else(unknown)
            };
            list.as_ref().map(|list| list.iter().map(view).collect()).transpose()
        };
        let train = listed("train_filenames", &fields.train_filenames)?;
        let val = listed("val_filenames", &fields.val_filenames)?;
        let test = listed("test_filenames", &fields.test_filenames)?;
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
            return Err(place.refuse("train_filenames", found, "names that are in no other list"));
        }
        Ok(Some(Split { train: train.into_iter().collect(), test: held_out.into_iter().collect() }))
    }

    /// The capture, its views in order of name.
    fn finish(mut self, split: Option<Split>) -> Result<Capture> {
        let (positions, colours) = match &self.points {
            Some(file) => {
                regular_size(file).map_err(|reason| unreadable(file, reason))?;
                self.files.push(file.clone());
                ply::read_points(file).map_err(|error| CaptureError::Content(error.to_string()))?
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
        let (files, remarks) = (self.files, self.remarks);
        Ok(Capture { split, masks, files, remarks, ..Capture::near_zero(&self.folder, views, &positions, colours) })
    }
}

//! The folder of a block: `block.json`, which names a capture and the part of it that the block is.

use std::collections::HashMap;
use std::io::Write;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use super::{Block, Bounds};
use crate::capture::read::{Place, PlaceInFile, quoted};
use crate::capture::strays::picked;
use crate::capture::{Capture, CaptureError, Result, Split};
use crate::json;
use crate::replace::replace;

/// The file's name.
pub const BLOCK: &str = "block.json";

/// The largest accepted file. A point takes at most 9 bytes.
const MAX_BYTES: u64 = 1 << 30;

const FIX: &str = "Plan the blocks again with `splat blocks plan`";

/// The contents of `block.json`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BlockFile {
    /// The capture's folder, absolute or relative to the folder of this file.
    pub capture: PathBuf,
    /// Numbers of photographs and of points that the capture had when it was cut.
    pub counts: [usize; 2],
    /// The part that is kept after training; positions are relative to the capture's origin.
    pub cell: Bounds,
    /// The cell with its margin.
    pub region: Bounds,
    /// Names of the photographs to train on.
    pub train: Vec<String>,
    /// Names of the photographs that are held out.
    pub test: Vec<String>,
    /// Indices of the points.
    pub points: Vec<u32>,
}

impl BlockFile {
    /// The file for a block of `capture`, which the file names as `path`.
    pub fn of(capture: &Capture, path: PathBuf, block: &Block) -> Self {
        let names = |views: &[usize]| views.iter().map(|&view| capture.views[view].name.clone()).collect();
        Self {
            capture: path,
            counts: [capture.views.len(), capture.points.positions.len()],
            cell: block.cell,
            region: block.region,
            train: names(&block.train),
            test: names(&block.test),
            // There are fewer than 2³² points.
            points: block.points.iter().map(|&point| point as u32).collect(),
        }
    }

    /// Writes the file into `folder`, which exists.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn write(&self, folder: &Path) -> Result<()> {
        let file = folder.join(BLOCK);
        let write = |out: &mut dyn Write| Ok::<_, std::io::Error>(serde_json::to_writer(out, self)?);
        replace(&file, |out| write(out)).map_err(|reason| CaptureError::unwritable(&file, &reason))
    }

    /// Reads the file of a block's folder.
    ///
    /// # Errors
    /// If it is missing, too large, or not such a file.
    pub fn read(folder: &Path) -> Result<Self> {
        let file = folder.join(BLOCK);
        let place = Place::new(&file, PlaceInFile::Whole);
        let refuse = |found: String| place.refuse_with("text", quoted(&found), "a block of at most 1 GiB", FIX);
        json::read(&file, MAX_BYTES, refuse)
    }

    /// The folder of the capture, for a file that lies in `folder`.
    pub fn capture_folder(&self, folder: &Path) -> PathBuf {
        folder.join(&self.capture)
    }

    /// The part of `capture` that the block is. `file` is named in errors.
    fn part(&self, file: &Path, capture: Capture) -> Result<Capture> {
        let place = Place::new(file, PlaceInFile::Whole);
        let refuse = |field, found: String, expected: &str| Err(place.refuse_with(field, found, expected, FIX));
        let counts = [capture.views.len(), capture.points.positions.len()];
        if counts != self.counts {
            let found = format!("{} photographs and {} points", self.counts[0], self.counts[1]);
            return refuse("counts", found, &format!("{} and {}, as the capture has now", counts[0], counts[1]));
        }
        let by_name: HashMap<&str, usize> =
            capture.views.iter().enumerate().map(|(i, view)| (view.name.as_str(), i)).collect();
        // For each view of the capture whether the block has it, and whether it is held out.
        let mut chosen = vec![None; capture.views.len()];
        for (field, names, held_out) in [("train", &self.train, false), ("test", &self.test, true)] {
            for name in names {
                match by_name.get(name.as_str()) {
                    Some(&view) if chosen[view].is_none() => chosen[view] = Some(held_out),
                    Some(_) => return refuse(field, format!("{} again", quoted(name)), "each photograph once"),
                    None => return refuse(field, quoted(name), "names of the capture's photographs"),
                }
            }
        }
        if let Some(point) = self.points.iter().find(|point| **point as usize >= counts[1]) {
            return refuse("points", point.to_string(), "indices of the capture's points");
        }
        let axes = self.region.box_from_world.as_flattened();
        if !axes.iter().all(|value| value.is_finite()) {
            return refuse("region", format!("{axes:?}"), "finite axes");
        }
        Ok(self.cut_out(capture, &chosen))
    }

    fn cut_out(&self, capture: Capture, chosen: &[Option<bool>]) -> Capture {
        let (mut split, mut place) = (Split::default(), vec![None; chosen.len()]);
        let views = (0..chosen.len()).filter(|&view| chosen[view].is_some());
        for (now, view) in views.enumerate() {
            place[view] = Some(now);
            if chosen[view] == Some(true) { &mut split.test } else { &mut split.train }.push(now);
        }
        let of_block = || self.points.iter().map(|&point| point as usize);
        let tracks = capture.tracks.picked(of_block(), &place);
        let (views, masks) = (picked(capture.views, &place), picked(capture.masks, &place));
        let (points, split, focus) = (capture.points.picked(of_block()), Some(split), Some(self.region));
        Capture { views, points, tracks, masks, split, focus, ..capture }
    }
}

pub(in crate::capture) fn is_there(folder: &Path) -> bool {
    folder.join(BLOCK).is_file()
}

pub(in crate::capture) fn load(folder: &Path) -> Result<Capture> {
    let block = BlockFile::read(folder)?;
    let (file, whole) = (folder.join(BLOCK), block.capture_folder(folder));
    if is_there(&whole) {
        let place = Place::new(&file, PlaceInFile::Whole);
        let found = format!("{}, which is a block", whole.display());
        return Err(place.refuse_with("capture", found, "a whole capture", FIX));
    }
    let mut part = block.part(&file, Capture::load(&whole)?)?;
    part.files.push(file);
    Ok(part)
}

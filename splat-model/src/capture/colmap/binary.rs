//! The binary encoding: little-endian and unpadded. Each file is a count followed by that many entries.
//!
//! Every count is compared with the bytes that follow it before anything is allocated, so that a damaged or hostile file
//! costs no more memory than its own size.

use std::path::Path;

use super::model::ColmapCameraModel;
use super::{CameraRecord, ImageRecord, PointRecord, TrackElement};
use crate::capture::read::{Place, PlaceInFile, quoted};
use crate::capture::{CaptureError, Result};

/// Bytes of the smallest camera: id, model, width, height, two parameters.
const CAMERA_BYTES: usize = 4 + 4 + 8 + 8 + 2 * 8;
/// Bytes of the smallest image: id, quaternion, translation, camera, an empty name's end, the number of keypoints.
const IMAGE_BYTES: usize = 4 + 4 * 8 + 3 * 8 + 4 + 1 + 8;
/// Bytes of a keypoint: x, y, id of its point (−1, all bits set, where it has none).
const KEYPOINT_BYTES: usize = 3 * 8;
/// Bytes of the smallest point: id, position, colour, reprojection error, length of its track.
const POINT_BYTES: usize = 8 + 3 * 8 + 3 + 8 + 8;
/// Bytes of an element of a track: image, keypoint.
const TRACK_BYTES: usize = 4 + 4;

pub(super) fn cameras(file: &Path, bytes: &[u8]) -> Result<Vec<CameraRecord>> {
    let mut reader = BinaryReader { file, kind: "camera", entry: 0, rest: bytes };
    let mut last = None;
    let cameras = reader.entries(CAMERA_BYTES, |input| {
        let id = u32::from_le_bytes(input.take("CAMERA_ID")?);
        let model = ColmapCameraModel::name(i32::from_le_bytes(input.take("MODEL")?));
        let model = input.place().model_by_name(&model)?;
        let size_px = [u64::from_le_bytes(input.take("WIDTH")?), u64::from_le_bytes(input.take("HEIGHT")?)];
        let parameters = &mut [0.0; ColmapCameraModel::MOST_PARAMETERS][..model.parameters()];
        if input.rest.len() < 8 * parameters.len() && input.rest.len().is_multiple_of(8) {
            return Err(input.damaged(format!(
                "{}: the camera model {} has {} parameters, and the file ends after {}. It is cut short, or the camera is of another \
                 model: copy or export it again",
                input.place(),
                model.own_name(),
                parameters.len(),
                input.rest.len() / 8
            )));
        }
        for parameter in parameters.iter_mut() {
            *parameter = f64::from_le_bytes(input.take("PARAMS")?);
        }
        let (intrinsics, cut) = input.place().intrinsics(model, size_px, parameters)?;
        last = Some((input.entry, model));
        Ok(CameraRecord { at: input.place().at, id, intrinsics, cut })
    });
    match (last, reader.rest.len()) {
        // All cameras were read, and what is left are numbers: the last has more than its model.
        (Some((entry, model)), left) if cameras.is_err() && entry == reader.entry && left.is_multiple_of(8) => {
            Err(reader.place().parameters(model, model.parameters() + left / 8))
        }
        _ => cameras,
    }
}

pub(super) fn images(file: &Path, bytes: &[u8]) -> Result<Vec<ImageRecord>> {
    BinaryReader { file, kind: "image", entry: 0, rest: bytes }.entries(IMAGE_BYTES, |input| {
        let id = u32::from_le_bytes(input.take("IMAGE_ID")?);
        let quaternion = input.numbers("QW QX QY QZ")?;
        let translation = input.numbers("TX TY TZ")?;
        let cam_from_world = input.place().pose(quaternion, translation)?;
        let camera_id = u32::from_le_bytes(input.take("CAMERA_ID")?);
        let name = input.name()?;
        let keypoints = input.list("POINTS2D", KEYPOINT_BYTES, |input| {
            let [x, y] = input.numbers("POINTS2D")?;
            // Skips the point's id, which the tracks repeat.
            input.take::<8>("POINTS2D")?;
            Ok([x as f32, y as f32])
        })?;
        Ok(ImageRecord { at: input.place().at, id, camera_id, name, cam_from_world, keypoints })
    })
}

pub(super) fn points(file: &Path, bytes: &[u8]) -> Result<Vec<PointRecord>> {
    BinaryReader { file, kind: "point", entry: 0, rest: bytes }.entries(POINT_BYTES, |input| {
        input.take::<8>("POINT3D_ID")?;
        let xyz = input.numbers("X Y Z")?;
        let position = input.place().vector(["X", "Y", "Z"], xyz)?;
        let colour = input.take("R G B")?;
        let [error_px] = input.numbers("ERROR")?;
        let track = input.list("TRACK", TRACK_BYTES, |input| {
            let image_id = u32::from_le_bytes(input.take("TRACK")?);
            Ok(TrackElement { image_id, keypoint: u32::from_le_bytes(input.take("TRACK")?) })
        })?;
        Ok(PointRecord { position, colour, error_px, track })
    })
}

/// The unread part of a file, and the entry being read.
struct BinaryReader<'a> {
    file: &'a Path,
    kind: &'static str,
    entry: usize,
    rest: &'a [u8],
}

impl<'a> BinaryReader<'a> {
    fn place(&self) -> Place<'a> {
        Place::new(self.file, PlaceInFile::Entry(self.kind, self.entry))
    }

    /// Reads a count and that many entries of at least `each` bytes, which must fill the file. Left-over bytes mean that the
    /// count and the entries disagree, so the entries may have been misread.
    fn entries<T>(&mut self, each: usize, mut read: impl FnMut(&mut Self) -> Result<T>) -> Result<Vec<T>> {
        let what = format!("{}s", self.kind);
        let count = self.count(&what, each)?;
        let mut entries = Vec::with_capacity(count);
        for entry in 1..=count {
            self.entry = entry;
            entries.push(read(self)?);
        }
        match self.rest.len() {
            0 => Ok(entries),
            left => Err(self.damaged(format!(
                "{left} bytes follow the last of {count} {what}, expected none. The file is damaged or of a newer format: \
                 export it again, for instance with `colmap model_converter`"
            ))),
        }
    }

    fn take<const N: usize>(&mut self, field: &'static str) -> Result<[u8; N]> {
        let Some((head, rest)) = self.rest.split_first_chunk::<N>() else {
            return Err(self.truncated(field, N));
        };
        self.rest = rest;
        Ok(*head)
    }

    fn numbers<const N: usize>(&mut self, field: &'static str) -> Result<[f64; N]> {
        let mut numbers = [0.0; N];
        for number in &mut numbers {
            *number = f64::from_le_bytes(self.take(field)?);
        }
        Ok(numbers)
    }

    /// Reads a count of items of at least `each` bytes, and checks that the file has room for them.
    fn count(&mut self, what: &str, each: usize) -> Result<usize> {
        let count = u64::from_le_bytes(self.take("count")?);
        let (needed, left) = (u128::from(count) * each as u128, self.rest.len());
        match usize::try_from(count) {
            Ok(count) if needed <= left as u128 => Ok(count),
            _ => Err(self.damaged(format!(
                "the number of {what} is {count}, which takes at least {needed} bytes, but only {left} bytes follow. The file \
                 is cut short or damaged: copy or export it again"
            ))),
        }
    }

    /// Reads a count and that many items of `each` bytes.
    fn list<T>(
        &mut self,
        what: &'static str,
        each: usize,
        mut read: impl FnMut(&mut Self) -> Result<T>,
    ) -> Result<Vec<T>> {
        let count = self.count(&format!("{what} in {}", self.place()), each)?;
        (0..count).map(|_| read(self)).collect()
    }

    fn name(&mut self) -> Result<String> {
        let Some(length) = self.rest.iter().position(|&byte| byte == 0) else {
            return Err(self.truncated("NAME", self.rest.len() + 1));
        };
        let (name, rest) = self.rest.split_at(length);
        self.rest = &rest[1..];
        match str::from_utf8(name) {
            Ok(name) => self.place().name(name),
            Err(_) => Err(self.place().refuse("NAME", quoted(&name.escape_ascii().to_string()), "UTF-8 text")),
        }
    }

    fn truncated(&self, field: &'static str, needed: usize) -> CaptureError {
        let place = if self.entry == 0 { "header".to_owned() } else { self.place().to_string() };
        self.damaged(format!(
            "{place}: the file ends in `{field}`, which takes {needed} bytes where {} are left. It is cut short: copy or \
             export it again",
            self.rest.len()
        ))
    }

    fn damaged(&self, detail: String) -> CaptureError {
        CaptureError::content(self.file, detail)
    }
}

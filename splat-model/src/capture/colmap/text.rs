//! The text encoding: one entry per line (two for an image), fields separated by blanks, comment lines starting with `#`.

use std::path::Path;
use std::str::FromStr;

use super::{CameraRecord, ImageRecord, PointRecord, TrackElement};
use crate::capture::Result;
use crate::capture::read::{Place, PlaceInFile, quoted};

pub(super) fn cameras(file: &Path, bytes: &[u8]) -> Result<Vec<CameraRecord>> {
    let entries = lines(file, "camera", bytes)?.filter(is_entry);
    entries
        .map(|mut line| {
            let id = line.parse("CAMERA_ID", "a whole number")?;
            let model = line.field("MODEL")?;
            let model = line.place.model_by_name(model)?;
            let size_px = [line.parse("WIDTH", "a whole number of px")?, line.parse("HEIGHT", "a whole number of px")?];
            let mut parameters = Vec::with_capacity(model.parameters());
            while !line.rest.is_empty() {
                parameters.push(line.parse("PARAMS", "a number")?);
            }
            let (intrinsics, cut) = line.place.intrinsics(model, size_px, &parameters)?;
            Ok(CameraRecord { at: line.place.at, id, intrinsics, cut })
        })
        .collect()
}

pub(super) fn images(file: &Path, bytes: &[u8]) -> Result<Vec<ImageRecord>> {
    let mut lines = lines(file, "image", bytes)?;
    let mut images = Vec::new();
    while let Some(mut line) = lines.find(is_entry) {
        let id = line.parse("IMAGE_ID", "a whole number")?;
        let quaternion = line.numbers(["QW", "QX", "QY", "QZ"])?;
        let translation = line.numbers(["TX", "TY", "TZ"])?;
        let cam_from_world = line.place.pose(quaternion, translation)?;
        let camera_id = line.parse("CAMERA_ID", "a whole number")?;
        // The rest of the line, because names may hold blanks.
        let name = line.place.name(line.rest)?;
        // The line after an image belongs to it whatever it holds; most often it is empty where there are no keypoints.
        let keypoints = lines.next().map_or(Ok(Vec::new()), keypoints)?;
        images.push(ImageRecord { at: line.place.at, id, camera_id, name, cam_from_world, keypoints });
    }
    Ok(images)
}

pub(super) fn points(file: &Path, bytes: &[u8]) -> Result<Vec<PointRecord>> {
    let entries = lines(file, "point", bytes)?.filter(is_entry);
    entries
        .map(|mut line| {
            line.parse::<u64>("POINT3D_ID", "a whole number")?;
            let xyz = line.numbers(["X", "Y", "Z"])?;
            let position = line.place.vector(["X", "Y", "Z"], xyz)?;
            let mut colour = [0; 3];
            for (channel, field) in colour.iter_mut().zip(["R", "G", "B"]) {
                *channel = line.parse(field, "a whole number from 0 to 255")?;
            }
            // Fields that serve as evidence only may be missing.
            let error_px = if line.rest.is_empty() { f64::NAN } else { line.parse("ERROR", "a number")? };
            let mut track = Vec::new();
            while !line.rest.is_empty() {
                let image_id = line.parse("TRACK", "whole numbers IMAGE_ID and POINT2D_IDX in turn")?;
                let keypoint = line.parse("TRACK", "whole numbers IMAGE_ID and POINT2D_IDX in turn")?;
                track.push(TrackElement { image_id, keypoint });
            }
            Ok(PointRecord { position, colour, error_px, track })
        })
        .collect()
}

/// The keypoints of a line. A line that cannot hold keypoints is the next image, in a file without keypoint lines: skipping
/// it would lose every second photograph.
fn keypoints(mut line: TextLine) -> Result<Vec<[f32; 2]>> {
    let count = line.rest.split_whitespace().count();
    let last_is_id = line.rest.split_whitespace().next_back().is_none_or(|last| last.parse::<i64>().is_ok());
    if !(count.is_multiple_of(3) && last_is_id) {
        let expected = "X, Y, POINT3D_ID for each keypoint, or an empty line, after the line of each image";
        return Err(line.place.refuse("POINTS2D", format!("a line of {count} fields"), expected));
    }
    let mut keypoints = Vec::with_capacity(count / 3);
    while !line.rest.is_empty() {
        let [x, y] = line.numbers(["POINTS2D"; 2])?;
        // Skips the point's id, which the tracks repeat.
        line.parse::<i64>("POINTS2D", "X, Y and a whole number POINT3D_ID in turn")?;
        keypoints.push([x as f32, y as f32]);
    }
    Ok(keypoints)
}

fn is_entry(line: &TextLine) -> bool {
    !line.rest.is_empty() && !line.rest.starts_with('#')
}

/// The lines of a file, trimmed and numbered from one.
fn lines<'a>(file: &'a Path, kind: &'static str, bytes: &'a [u8]) -> Result<impl Iterator<Item = TextLine<'a>>> {
    let place = move |line| Place::new(file, PlaceInFile::Line(kind, line));
    let text = str::from_utf8(bytes).map_err(|error| {
        let line = 1 + bytes[..error.valid_up_to()].iter().filter(|&&byte| byte == b'\n').count();
        place(line).refuse("text", "a byte that is not UTF-8", "UTF-8 text")
    })?;
    Ok(text.lines().zip(1..).map(move |(text, line)| TextLine { place: place(line), rest: text.trim() }))
}

/// The unread part of a line.
struct TextLine<'a> {
    place: Place<'a>,
    rest: &'a str,
}

impl<'a> TextLine<'a> {
    fn field(&mut self, field: &'static str) -> Result<&'a str> {
        if self.rest.is_empty() {
            return Err(self.place.refuse(field, "missing: the line ends before it", "a value"));
        }
        let (value, rest) = self.rest.split_once(char::is_whitespace).unwrap_or((self.rest, ""));
        self.rest = rest.trim_start();
        Ok(value)
    }

    fn parse<T: FromStr>(&mut self, field: &'static str, expected: &'static str) -> Result<T> {
        let value = self.field(field)?;
        value.parse().map_err(|_| self.place.refuse(field, quoted(value), expected))
    }

    fn numbers<const N: usize>(&mut self, fields: [&'static str; N]) -> Result<[f64; N]> {
        let mut numbers = [0.0; N];
        for (number, field) in numbers.iter_mut().zip(fields) {
            *number = self.parse(field, "a number")?;
        }
        Ok(numbers)
    }
}

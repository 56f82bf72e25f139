//! The readers of captures and scenes, and checks of their results.

use std::fs;
use std::path::{Path, PathBuf};

use glam::DVec3;
use splat_model::capture::Capture;
use splat_model::gaussians::GaussianRows;
use splat_model::ply;

use super::engine::{FuzzTarget, folder};
use super::seeds;
use super::split::{self, ModelFile};

/// Words with which a message says what to do.
const REMEDIES: [&str; 24] = [
    "Export",
    "Put the",
    "Correct",
    "Copy",
    "Move",
    "export",
    "copy",
    "correct",
    "remove",
    "Remove",
    "choose",
    "pass a",
    "Check",
    "Name",
    "Run",
    "Reconstruct",
    "make all",
    "is the path right",
    "Use the",
    "unpack",
    "convert",
    "develop",
    "fetch",
    "name the folder",
];

/// Checks that a message names a file of `folder` and says what to do, in printable text that fits a screen.
pub fn judge_message(message: &str, folder: &Path) -> Result<(), String> {
    let named = folder.to_str().is_some_and(|folder| message.contains(folder));
    match () {
        () if !named => Err(format!("the message names no file: {message}")),
        () if !REMEDIES.iter().any(|word| message.contains(word)) => {
            Err(format!("the message has no remedy: {message}"))
        }
        () if message.len() > 1_500 + 4 * folder.as_os_str().len() => {
            Err(format!("a message of {} bytes", message.len()))
        }
        () if message.chars().any(char::is_control) => Err(format!("control characters in the message {message:?}")),
        () => Ok(()),
    }
}

/// Returns a message without its variable parts: paths, unusual quoted text, and the digits of numbers except their count.
pub fn shape(message: &str, folder: &Path) -> String {
    let message = message.replace(folder.to_str().unwrap_or_default(), "");
    let mut shape = String::new();
    for (i, part) in message.split(['`', '"', '\'']).enumerate() {
        let plain = part.len() <= 14 && part.chars().all(|c| c.is_ascii_alphanumeric() || c == '_');
        let mut digits = 0;
        for c in if i % 2 == 0 || plain { part } else { "_" }.chars() {
            digits = if c.is_ascii_digit() { digits + 1 } else { 0 };
            match digits {
                0 => shape.push(c),
                1..=2 => shape.push('#'),
                _ => {}
            }
        }
    }
    shape.truncate(shape.char_indices().nth(200).map_or(shape.len(), |(at, _)| at));
    shape
}

/// Returns the order of magnitude of a count, to base 2.
pub fn bucket(count: usize) -> u32 {
    (count + 1).ilog2()
}

/// Scenes in PLY.
pub struct Ply {
    folder: PathBuf,
    bytes: usize,
}

impl Ply {
    pub fn new(name: &str) -> Self {
        Self { folder: folder(name), bytes: 0 }
    }

    fn path(&self) -> PathBuf {
        self.folder.join("scene.ply")
    }

    /// Checks rows that were read from `self.bytes` bytes.
    fn judge(&self, rows: &GaussianRows, origin: DVec3) -> Result<(), String> {
        rows.check().map_err(|error| error.to_string())?;
        if !origin.is_finite() {
            return Err(format!("the origin is {origin}"));
        }
        // A number takes at least one byte.
        if rows.len() * (14 + rows.rest_per_row()) > self.bytes {
            return Err(format!("{} rows of degree {} from {} bytes", rows.len(), rows.sh_degree, self.bytes));
        }
        Ok(())
    }
}

impl FuzzTarget for Ply {
    fn name(&self) -> &'static str {
        "ply"
    }

    fn seeds(&self) -> Vec<Vec<u8>> {
        seeds::scenes()
    }

    fn words(&self) -> &'static [&'static str] {
        &[
            "ply",
            "format",
            "ascii",
            "binary_little_endian",
            "binary_big_endian",
            "1.0",
            "\n",
            "\r\n",
            " ",
            "element",
            "vertex",
            "property",
            "float",
            "double",
            "uchar",
            "int",
            "char",
            "float64",
            "list",
            "property list uchar int i\n",
            "property list int double i\n",
            "end_header",
            "end_header\n",
            "comment",
            "comment splat origin 1e308 2 3\n",
            "comment splat origin ",
            "obj_info",
            "x",
            "f_rest_0",
            "f_rest_44",
            "f_rest_71",
            "f_rest_72",
            "f_dc_0",
            "rot_3",
            "element vertex 18446744073709551615\n",
            "element a 4294967295\n",
            "\u{feff}",
            "\0",
            "é",
        ]
    }

    fn split(&self, input: &[u8]) -> Vec<Vec<u8>> {
        split::ply(input)
    }

    fn place(&mut self, input: &[u8]) {
        self.bytes = input.len();
        fs::write(self.path(), input).expect("the target folder can be written to");
    }

    fn read(&mut self) -> Result<String, String> {
        match ply::read(&self.path()) {
            Ok((rows, origin)) => {
                self.judge(&rows, origin)?;
                let (count, unusable) = (bucket(rows.len()), rows.unusable() > 0);
                let far = origin != DVec3::ZERO;
                Ok(format!("accepted: 2^{count} rows of degree {}, unusable {unusable}, origin {far}", rows.sh_degree))
            }
            Err(error) => {
                let message = error.to_string();
                judge_message(&message, &self.folder)?;
                Ok(shape(&message, &self.folder))
            }
        }
    }
}

/// COLMAP models: one of three files is the input, the others are valid. The first byte of the input says which.
pub struct Colmap {
    name: &'static str,
    folder: PathBuf,
    valid: [Vec<u8>; 3],
    extension: &'static str,
    /// Index of the file that holds the input; 3 if all are valid.
    changed: usize,
}

const PARTS: [(ModelFile, &str); 3] =
    [(ModelFile::Cameras, "cameras"), (ModelFile::Images, "images"), (ModelFile::Points, "points3D")];

impl Colmap {
    pub fn binary(name: &'static str) -> Self {
        let folder = folder(name);
        Self { name, valid: seeds::model(&folder).binary, folder, extension: "bin", changed: 3 }
    }

    pub fn text(name: &'static str) -> Self {
        let folder = folder(name);
        let valid = seeds::model(&folder).text;
        // The readers prefer the binary encoding.
        fs::remove_dir_all(folder.join("sparse/0")).expect("written by the line above");
        fs::create_dir_all(folder.join("sparse/0")).expect("the target folder can be written to");
        for (i, (_, part)) in PARTS.iter().enumerate() {
            fs::write(folder.join(format!("sparse/0/{part}.txt")), &valid[i])
                .expect("the target folder can be written to");
        }
        Self { name, valid, folder, extension: "txt", changed: 3 }
    }

    fn part(input: &[u8]) -> usize {
        usize::from(input.first().copied().unwrap_or_default()) % 3
    }

    fn judge(capture: &Capture) -> Result<(), String> {
        let names = capture.views.windows(2).all(|pair| pair[0].name < pair[1].name);
        let poses = capture.views.iter().all(|view| view.cam_from_world.is_finite());
        let points = capture.points.positions.as_flattened().iter().all(|value| value.is_finite());
        let inside = capture.views.iter().all(|view| {
            let below = view.image_path.strip_prefix(&capture.folder);
            below.is_ok_and(|path| !path.components().any(|part| part == std::path::Component::ParentDir))
        });
        match () {
            () if capture.views.is_empty() => Err("no views".into()),
            () if !names => Err("names are not sorted, or not unique".into()),
            () if !(poses && points && capture.origin.is_finite()) => Err("a pose or point is not finite".into()),
            () if !inside => Err("a picture lies outside of the capture".into()),
            () if !(0..capture.points.positions.len()).flat_map(|point| capture.tracks.of(point)).all(
                |observation| {
                    observation.view < capture.views.len() && observation.at_px.iter().all(|px| px.is_finite())
                },
            ) =>
            {
                Err("a track leads nowhere".into())
            }
            () if !capture.tracks.of(capture.points.positions.len()).is_empty() => {
                Err("a track without a point".into())
            }
            () if capture.points.positions.len() != capture.points.colours.len() => {
                Err("points without colours".into())
            }
            () => Ok(()),
        }
    }
}

/// Lines of photographs around zero, and of one far away.
fn strays() -> String {
    let centre = |i: usize| if i == 9 { 1e6 } else { i as f64 };
    (0..10).map(|i| format!("{} 1 0 0 0 {} 0 4 1 stray{i}.png\n\n", 10 + i, centre(i))).collect()
}

impl FuzzTarget for Colmap {
    fn name(&self) -> &'static str {
        self.name
    }

    fn seeds(&self) -> Vec<Vec<u8>> {
        let whole = (0..3_u8).map(|part| (part, self.valid[usize::from(part)].clone()));
        let text = |part: u8, change: &dyn Fn(&str) -> Vec<u8>| {
            (part, change(std::str::from_utf8(&self.valid[usize::from(part)]).expect("text")))
        };
        // Files of Windows: a byte order mark, UTF-16, backslashes in names.
        let of_windows = match self.extension {
            "txt" => vec![
                text(0, &|text| format!("\u{feff}{text}").into_bytes()),
                text(1, &|text| format!("\u{feff}{text}").encode_utf16().flat_map(u16::to_le_bytes).collect()),
                text(1, &|text| text.replace("sub/", "sub\\").into_bytes()),
                text(2, &|text| text.encode_utf16().flat_map(u16::to_be_bytes).collect()),
                // A photograph far from the others among enough of them, and points several times at one place.
                text(1, &|text| [text, &strays()].concat().into_bytes()),
                text(2, &|text| [text, "3 5 5 5 1 2 3 0.1\n4 5 5 5 1 2 3 0.1\n"].concat().into_bytes()),
            ],
            _ => Vec::new(),
        };
        whole.chain(of_windows).map(|(part, bytes)| [vec![part], bytes].concat()).collect()
    }

    fn words(&self) -> &'static [&'static str] {
        &[
            "PINHOLE",
            "SIMPLE_PINHOLE",
            "OPENCV",
            "FULL_OPENCV",
            "SIMPLE_RADIAL",
            "OPENCV_FISHEYE",
            "THIN_PRISM_FISHEYE",
            "\u{1}\0\0\0",
            "\u{2}\0\0\0",
            "\u{7f}\0\0\0",
            "\0",
            "\0\0\0\0",
            "\0\0\0\0\0\0\0\0",
            "\u{1}\0\0\0\0\0\0\0",
            "\n",
            "\r\n",
            " ",
            "\t",
            "#",
            "# comment\n",
            "../",
            "../../etc/passwd",
            "/",
            "..",
            ".",
            "a/../../b.png",
            "00.png",
            "C:\\x.png",
            "é.png",
            "\u{feff}",
            "1",
            "-1",
            "nan",
            "40 30",
            "1 0 0 0 0 0 0 1",
        ]
    }

    fn split(&self, input: &[u8]) -> Vec<Vec<u8>> {
        let Some((first, rest)) = input.split_first() else { return Vec::new() };
        let fields = match self.extension {
            "bin" => split::colmap(PARTS[Self::part(input)].0, rest),
            _ => split::text(rest),
        };
        // The first byte is part of the first field.
        let mut fields = fields.into_iter();
        let head = [&[*first], &fields.next().unwrap_or_default()[..]].concat();
        std::iter::once(head).chain(fields).collect()
    }

    fn place(&mut self, input: &[u8]) {
        let write = |i: usize, bytes: &[u8]| {
            let path = self.folder.join(format!("sparse/0/{}.{}", PARTS[i].1, self.extension));
            fs::write(path, bytes).expect("the target folder can be written to");
        };
        let changed = Self::part(input);
        if self.changed != changed && self.changed < 3 {
            write(self.changed, &self.valid[self.changed]);
        }
        write(changed, input.get(1..).unwrap_or_default());
        self.changed = changed;
    }

    fn read(&mut self) -> Result<String, String> {
        match Capture::load(&self.folder) {
            Ok(capture) => {
                Self::judge(&capture)?;
                let (views, points) = (bucket(capture.views.len()), bucket(capture.points.positions.len()));
                let found = bucket(capture.tracks.observations());
                let far = capture.origin != DVec3::ZERO;
                Ok(format!("accepted: 2^{views} views, 2^{points} points, 2^{found} observations, origin {far}"))
            }
            Err(error) => {
                let message = error.to_string();
                judge_message(&message, &self.folder)?;
                Ok(shape(&message, &self.folder))
            }
        }
    }
}

#[test]
fn messages_are_held_to_the_rules() {
    let folder = Path::new("/somewhere");
    assert!(judge_message("/somewhere/a.ply: row 3 is short; export it again", folder).is_ok());
    for bad in
        ["a.ply: row 3 is short; export it again", "/somewhere/a.ply: row 3 is short", "/somewhere/a: \u{1b}[0m export"]
    {
        assert!(judge_message(bad, folder).is_err(), "{bad}");
    }
    assert!(judge_message(&format!("/somewhere/a: {} export", "x".repeat(2_000)), folder).is_err());
}

#[test]
fn shapes_forget_what_varies() {
    let folder = Path::new("/somewhere");
    let of = |message: &str| shape(message, folder);
    assert_eq!(of("/somewhere/a: row 3 of `x` is 12"), of("/somewhere/a: row 7 of `x` is 99"));
    assert_eq!(of("/a: `some odd thing!`"), of("/a: `another odd thing?`"));
    assert_ne!(of("/a: `x` is missing"), of("/a: `rot_3` is missing"));
    assert_ne!(of("/a: row 3"), of("/a: row 3333"));
}

//! The readers of compressed scenes, and checks of their results.

use std::fs;
use std::io::{Read, Write};
use std::path::PathBuf;

use flate2::Compression;
use flate2::read::GzDecoder;
use flate2::write::GzEncoder;
use splat_model::formats::{self, Format, SceneFile, SpzOptions, SpzVersion, WriteOptions};

use super::engine::{FuzzTarget, folder};
use super::seeds::rows;
use super::split;
use super::targets::{bucket, judge_message, shape};

/// Scenes of any format. The first byte of an input says whether the other bytes are the file or its content before gzip. Mutations of gzipped
/// bytes would fail at the checksum.
pub struct Scenes {
    folder: PathBuf,
}

const PLAIN: u8 = 0;
const GZIPPED: u8 = 1;

impl Scenes {
    pub fn new(name: &str) -> Self {
        Self { folder: folder(name) }
    }

    fn path(&self) -> PathBuf {
        self.folder.join("scene")
    }
}

impl FuzzTarget for Scenes {
    fn name(&self) -> &'static str {
        "scenes"
    }

    fn seeds(&self) -> Vec<Vec<u8>> {
        let mut seeds = Vec::new();
        for (count, sh_degree) in [(1, 0), (1, 1), (3, 0), (2, 3), (40, 0)] {
            let scene = SceneFile { rows: rows(count, sh_degree), ..SceneFile::default() };
            let path = self.path();
            let written = || fs::read(&path).expect("written before");
            for format in [Format::Spz, Format::Sog] {
                formats::write(&path, &scene, format).expect("the target folder can be written to");
                seeds.push([&[PLAIN], &written()[..]].concat());
            }
            let spz = SpzOptions { version: SpzVersion::Three, ..SpzOptions::default() };
            formats::write_with(&path, &scene, Format::Spz, WriteOptions { spz, ..WriteOptions::default() })
                .expect("the target folder can be written to");
            let mut plain = vec![GZIPPED];
            GzDecoder::new(&written()[..]).read_to_end(&mut plain).expect("written above");
            // Rotations of older versions are shorter, and the reader ignores the remaining bytes.
            for version in [1, 2, 3] {
                plain[5] = version;
                seeds.push(plain.clone());
            }
            seeds.push([&[PLAIN], &written()[..]].concat());
        }
        for theirs in [
            &include_bytes!("../../../splat-model/tests/scenes/splat-transform.v4.spz")[..],
            include_bytes!("../../../splat-model/tests/scenes/splat-transform.sog"),
        ] {
            seeds.push([&[PLAIN], theirs].concat());
        }
        seeds
    }

    fn words(&self) -> &'static [&'static str] {
        &[
            "ply\n",
            "element chunk 1\n",
            "element vertex 1\n",
            "element vertex 4294967295\n",
            "element sh 18446744073709551615\n",
            "element face 1\n",
            "property uint packed_position\n",
            "property float packed_scale\n",
            "property list uchar uint packed_color\n",
            "property uchar f_rest_45\n",
            "property float max_b\n",
            "packed_rotation",
            "end_header\n",
            "ascii",
            "binary_big_endian",
            "comment splat origin 1 2 3\n",
            "NGSP",
            "\u{1f}",
            "(\u{35}/",
            "\u{1}\0\0\0",
            "\u{4}\0\0\0",
            "\u{7f}\0\0\0",
            "\u{7f}\u{7f}\u{7f}\u{7f}",
            "\0\0\0\0\0\0\0\0",
            "\0",
            "\n",
            " ",
            "glTF",
            "PK\u{3}\u{4}",
            "{",
            "}",
            "[0]",
            "\"extras\":{\"origin\":[1e308,2,3]}",
        ]
    }

    fn split(&self, input: &[u8]) -> Vec<Vec<u8>> {
        match input.split_first() {
            Some((first, rest)) if rest.starts_with(b"ply") => {
                let mut fields = split::ply(rest);
                if let Some(head) = fields.first_mut() {
                    head.insert(0, *first);
                }
                fields
            }
            _ => input.chunks(4).map(<[u8]>::to_vec).collect(),
        }
    }

    fn place(&mut self, input: &[u8]) {
        let rest = input.get(1..).unwrap_or_default();
        let file = match input.first() {
            Some(&GZIPPED) => {
                let mut stream = GzEncoder::new(Vec::new(), Compression::none());
                stream.write_all(rest).and_then(|()| stream.finish()).expect("into memory")
            }
            _ => rest.to_vec(),
        };
        fs::write(self.path(), file).expect("the target folder can be written to");
    }

    fn read(&mut self) -> Result<String, String> {
        match formats::read(&self.path()) {
            Ok((SceneFile { rows, origin, metres_per_unit, trained, .. }, format)) => {
                rows.check().map_err(|error| error.to_string())?;
                let sized = metres_per_unit.is_none_or(|metres| metres.is_finite() && metres > 0.0);
                if !sized || !origin.is_finite() {
                    return Err(format!("origin {origin}, {metres_per_unit:?} m, {format}"));
                }
                let (count, unusable) = (bucket(rows.len()), rows.unusable() > 0);
                Ok(format!(
                    "accepted: {format}, 2^{count} of degree {}, {unusable}, {}",
                    rows.sh_degree, trained.antialias
                ))
            }
            Err(error) => {
                let message = error.to_string();
                judge_message(&message, &self.folder)?;
                // The bytes at which another file begins vary.
                match message.contains("not a scene: it begins with") {
                    true => Ok("unknown".into()),
                    false => Ok(shape(&message, &self.folder)),
                }
            }
        }
    }
}

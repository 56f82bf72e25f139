//! The document of a SOG scene and one of its pictures, side by side in a folder: mutations of an archive would fail at its checksums.

use std::fs;
use std::path::PathBuf;

use splat_model::formats::{self, Format, SceneFile};
use splat_model::ply::TrainedAs;

use super::engine::{FuzzTarget, folder};
use super::seeds::rows;
use super::split;
use super::targets::{bucket, judge_message, shape};

/// An input is the document, a zero, and the picture of the low bytes of positions. All other pictures are those of a valid scene.
pub struct Sog {
    folder: PathBuf,
}

const PICTURE: &str = "means_l.webp";

impl Sog {
    pub fn new(name: &str) -> Self {
        let folder = folder(name);
        let path = folder.join("scene.sog");
        let trained = TrainedAs { antialias: true, ..TrainedAs::default() };
        let scene = SceneFile { rows: rows(3, 3), origin: [1.0, 2.0, 3.0].into(), trained, ..SceneFile::default() };
        formats::write(&path, &scene, Format::Sog).expect("the folder can be written to");
        let file = fs::File::open(&path).expect("written above");
        let mut archive = zip::ZipArchive::new(file).expect("written above");
        archive.extract(&folder).expect("the folder can be written to");
        fs::remove_file(path).expect("written above");
        Self { folder }
    }
}

impl FuzzTarget for Sog {
    fn name(&self) -> &'static str {
        "sog"
    }

    fn seeds(&self) -> Vec<Vec<u8>> {
        let read = |name: &str| fs::read(self.folder.join(name)).expect("extracted before");
        vec![[read("meta.json"), vec![0], read(PICTURE)].concat()]
    }

    fn words(&self) -> &'static [&'static str] {
        &[
            "\"count\":3",
            "\"count\":4294967295",
            "\"bands\":1",
            "\"bands\":4",
            "\"version\":1",
            "\"files\":[\"means_u.webp\"]",
            "\"files\":[\"../meta.json\"]",
            "\"antialias\":true",
            "\"mins\":[-1e308,0,1e308]",
            "\"extras\":{\"origin\":[0,0,1e999]}",
            "RIFF",
            "WEBPVP8L",
            "VP8X",
            "\0",
            "\0\0\0\0",
            "[",
            "}",
        ]
    }

    fn split(&self, input: &[u8]) -> Vec<Vec<u8>> {
        split::text(input)
    }

    fn place(&mut self, input: &[u8]) {
        let end = input.iter().position(|byte| *byte == 0).unwrap_or(input.len());
        for (name, bytes) in [("meta.json", &input[..end]), (PICTURE, input.get(end + 1..).unwrap_or_default())] {
            fs::write(self.folder.join(name), bytes).expect("the target folder can be written to");
        }
    }

    fn read(&mut self) -> Result<String, String> {
        match formats::read(&self.folder.join("meta.json")) {
            Ok((scene, format)) => {
                scene.rows.check().map_err(|error| error.to_string())?;
                if format != Format::Sog || !scene.origin.is_finite() {
                    return Err(format!("origin {}, {format}", scene.origin));
                }
                Ok(format!("accepted: {format}, 2^{} of degree {}", bucket(scene.rows.len()), scene.rows.sh_degree))
            }
            Err(error) => {
                let message = error.to_string();
                judge_message(&message, &self.folder)?;
                Ok(shape(&message, &self.folder))
            }
        }
    }
}

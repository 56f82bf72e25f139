//! The document of a SOG scene and one of its pictures, which are packed after they are mutated: mutations of an archive would fail at its
//! checksums.

use std::collections::BTreeMap;
use std::fs;
use std::io::{Cursor, Read, Write};
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
    /// The files of the archive, by name.
    files: BTreeMap<String, Vec<u8>>,
}

const DOCUMENT: &str = "meta.json";
const PICTURE: &str = "means_l.webp";

impl Sog {
    pub fn new(name: &str) -> Self {
        let target = Self { folder: folder(name), files: BTreeMap::new() };
        let trained = TrainedAs { antialias: true, ..TrainedAs::default() };
        let scene = SceneFile { rows: rows(3, 3), origin: [1.0, 2.0, 3.0].into(), trained, ..SceneFile::default() };
        formats::write(&target.path(), &scene, Format::Sog).expect("the folder can be written to");
        let bytes = fs::read(target.path()).expect("written above");
        let mut archive = zip::ZipArchive::new(Cursor::new(bytes)).expect("written above");
        let names: Vec<String> = archive.file_names().map(|name| name.expect("ASCII").into_owned()).collect();
        let files = names.into_iter().map(|name| {
            let mut bytes = Vec::new();
            archive.by_name(&name).expect("listed").read_to_end(&mut bytes).expect("written above");
            (name, bytes)
        });
        Self { files: files.collect(), ..target }
    }

    fn path(&self) -> PathBuf {
        self.folder.join("scene.sog")
    }
}

impl FuzzTarget for Sog {
    fn name(&self) -> &'static str {
        "sog"
    }

    fn seeds(&self) -> Vec<Vec<u8>> {
        vec![[&self.files[DOCUMENT][..], &[0], &self.files[PICTURE]].concat()]
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
        self.files.insert(DOCUMENT.into(), input[..end].to_vec());
        self.files.insert(PICTURE.into(), input.get(end + 1..).unwrap_or_default().to_vec());
        let mut archive = zip::ZipWriter::new(Cursor::new(Vec::new()));
        let stored = zip::write::SimpleFileOptions::default().compression_method(zip::CompressionMethod::Stored);
        for (name, bytes) in &self.files {
            archive.start_file(name.as_str(), stored).expect("memory can be written to");
            archive.write_all(bytes).expect("memory can be written to");
        }
        let bytes = archive.finish().expect("memory can be written to").into_inner();
        fs::write(self.path(), bytes).expect("the target folder can be written to");
    }

    fn read(&mut self) -> Result<String, String> {
        match formats::read(&self.path()) {
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

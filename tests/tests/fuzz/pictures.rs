//! The reader of photographs, on JPEG: its decoder is another project's, and the check that its data are whole is ours.

use std::fs;
use std::path::PathBuf;

use splat_model::capture::{View, image};
use splat_op::Intrinsics;

use super::engine::{FuzzTarget, folder};
use super::targets::{judge_message, shape};

/// 40 × 27 px with restart markers, progressive and sequential.
const WHOLE: [&[u8]; 2] = [
    include_bytes!("../../../splat-model/src/capture/image/jpeg/progressive.jpg"),
    include_bytes!("../../../splat-model/src/capture/image/jpeg/sequential.jpg"),
];

pub struct Pictures {
    folder: PathBuf,
    view: View,
}

impl Pictures {
    pub fn new(name: &str) -> Self {
        let folder = folder(name);
        let (name, image_path) = ("photo.jpg".to_owned(), folder.join("photo.jpg"));
        let intrinsics = Intrinsics::centred(40, 27, 30.0);
        Self {
            view: View { name, image_path, intrinsics, cam_from_world: Default::default(), cut: Default::default() },
            folder,
        }
    }
}

impl FuzzTarget for Pictures {
    fn name(&self) -> &'static str {
        "pictures"
    }

    fn seeds(&self) -> Vec<Vec<u8>> {
        let whole = WHOLE.map(<[u8]>::to_vec);
        // A phone's video behind the picture.
        let followed = [&whole[1][..], b"\0\0\0\x18ftypmp42\0\0\0\0"].concat();
        whole.into_iter().chain([followed]).collect()
    }

    fn words(&self) -> &'static [&'static str] {
        // Bytes above 127 cannot be written here; splitting keeps those of the seeds whole.
        &["\0", "\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0", "\u{1}", "?", "ply\n", "Exif\0\0", "\u{8}\0\u{1b}\0(\u{3}"]
    }

    fn split(&self, input: &[u8]) -> Vec<Vec<u8>> {
        // Each segment begins with 255 and its marker.
        let mut fields: Vec<Vec<u8>> = Vec::new();
        for (at, &byte) in input.iter().enumerate() {
            let begins = byte == 255 && input.get(at + 1).is_some_and(|&next| next != 0);
            match fields.last_mut().filter(|_| !begins) {
                Some(field) => field.push(byte),
                None => fields.push(vec![byte]),
            }
        }
        fields
    }

    fn place(&mut self, input: &[u8]) {
        fs::write(&self.view.image_path, input).expect("the target folder can be written to");
    }

    fn read(&mut self) -> Result<String, String> {
        match image::load(&self.view, None) {
            Ok(photo) if photo.rgb.len() != 3 * 40 * 27 => Err(format!("{} values", photo.rgb.len())),
            Ok(photo) => Ok(format!("accepted: alpha {}", photo.alpha.is_some())),
            Err(error) => {
                let message = error.to_string();
                judge_message(&message, &self.folder)?;
                Ok(shape(&message, &self.folder))
            }
        }
    }
}

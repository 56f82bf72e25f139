//! Writing of an archive.

use std::io::{self, Cursor, Write};
use std::path::Path;

use image::codecs::webp::WebPEncoder;
use image::{ExtendedColorType, ImageEncoder};
use rayon::prelude::*;
use serde_json::{Value, json};
use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, DateTime, ZipWriter};

use super::codebook::{Quantised, quantise};
use super::meta::{Harmonics, Means, Meta, PictureFiles, ValueCodes};
use super::palette::palette;
use super::{LARGEST, META, PER_ROW, PLACES, compressed};
use crate::FileError;
use crate::formats::{SceneFile, extras, opacity, quaternion};
use crate::gaussians::GaussianRows;
use crate::replace::{WRITE, replace};

/// Largest number of palette entries: their indices have sixteen bits.
const ENTRIES_MAX: usize = 1 << 16;

/// Number of Gaussians for each palette entry of a scene too small for the largest palette; `docs/FORMATS.md` has what others cost.
const GAUSSIANS_PER_ENTRY: usize = 8;

/// Least number of entries without an option, where there are as many Gaussians: fewer would save little.
const ENTRIES_MIN: usize = 1_024;

/// The choices that SOG leaves to its writer.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SogOptions {
    /// Largest number of entries of the palette of higher harmonics, 1 to 65,536. By default one for eight Gaussians, and 1,024 at the least. More entries make a larger
    /// file that is closer to the scene.
    pub entries: Option<usize>,
}

/// Writes rows that fit the format. `scene` gives the origin and the mark of antialiasing.
pub fn write(path: &Path, rows: &GaussianRows, scene: &SceneFile, options: SogOptions) -> Result<(), FileError> {
    let archive = pack(rows, scene, options);
    let archive = archive.map_err(FileError::io(path, "code the pictures of the scene (write another format)"))?;
    replace(path, |out| out.write_all(&archive)).map_err(FileError::io(path, WRITE))
}

/// A picture of four channels, row by row.
struct WebpPicture {
    name: &'static str,
    width: usize,
    pixels: Vec<[u8; 4]>,
}

impl WebpPicture {
    /// A picture of about equal sides with a pixel per Gaussian, and opaque black behind the last.
    fn of(name: &'static str, count: usize, pixel: impl Fn(usize) -> [u8; 4] + Sync + Send) -> Self {
        let width = (count.max(1) as f64).sqrt().ceil() as usize;
        let mut pixels: Vec<[u8; 4]> = (0..count).into_par_iter().map(pixel).collect();
        pixels.resize(width * count.max(1).div_ceil(width), [0, 0, 0, 255]);
        Self { name, width, pixels }
    }

    fn encoded(&self) -> io::Result<Vec<u8>> {
        let mut file = Vec::new();
        let (width, height) = (self.width as u32, (self.pixels.len() / self.width) as u32);
        WebPEncoder::new_lossless(&mut file)
            .write_image(self.pixels.as_flattened(), width, height, ExtendedColorType::Rgba8)
            .map_err(io::Error::other)?;
        Ok(file)
    }
}

fn pack(rows: &GaussianRows, scene: &SceneFile, options: SogOptions) -> io::Result<Vec<u8>> {
    let count = rows.len();
    let ((means, scales), (colours, harmonics)) = rayon::join(
        || rayon::join(|| Places::of(rows), || quantise(rows.log_scales.as_flattened())),
        || rayon::join(|| quantise(rows.sh_dc.as_flattened()), || higher(rows, options)),
    );
    let three = |found: &Quantised, i: usize| [0, 1, 2].map(|axis| found.indices[3 * i + axis]);
    let mut pictures = vec![
        WebpPicture::of("means_l.webp", count, |i| rgb(means.place(rows.means[i]).map(|place| place as u8))),
        WebpPicture::of("means_u.webp", count, |i| rgb(means.place(rows.means[i]).map(|place| (place >> 8) as u8))),
        WebpPicture::of("scales.webp", count, |i| rgb(three(&scales, i))),
        WebpPicture::of("quats.webp", count, |i| rotation(rows.rotations[i])),
        WebpPicture::of("sh0.webp", count, |i| {
            let [r, g, b] = three(&colours, i);
            [r, g, b, opacity::level(rows.logit_opacities[i])]
        }),
    ];
    let name = |name: &str| name.to_owned();
    let sh_n = harmonics.map(|(harmonics, more)| {
        pictures.extend(more);
        harmonics
    });
    let meta = Meta {
        version: 2,
        asset: json!({ "generator": concat!("splat ", env!("CARGO_PKG_VERSION")) }),
        count,
        antialias: scene.trained.antialias,
        means: Means { mins: means.mins, maxs: means.maxs, files: ["means_l.webp", "means_u.webp"].map(name) },
        scales: ValueCodes { codebook: scales.codebook, files: [name("scales.webp")] },
        quats: PictureFiles { files: [name("quats.webp")] },
        sh0: ValueCodes { codebook: colours.codebook, files: [name("sh0.webp")] },
        sh_n,
        extras: Some(extras::of(scene.world())).filter(|extras| !extras.is_empty()).map(Value::Object),
    };
    let encoded = pictures.par_iter().map(|picture| Ok((picture.name, picture.encoded()?)));
    let mut files = encoded.collect::<io::Result<Vec<_>>>()?;
    files.insert(0, (META, serde_json::to_vec(&meta)?));
    archive(&files)
}

/// An archive of files as they are: WebP is compressed already.
fn archive(files: &[(&str, Vec<u8>)]) -> io::Result<Vec<u8>> {
    let mut archive = ZipWriter::new(Cursor::new(Vec::new()));
    // No time, so that the same scene gives the same file.
    let options = SimpleFileOptions::default()
        .compression_method(CompressionMethod::Stored)
        .last_modified_time(DateTime::default());
    for (name, bytes) in files {
        archive.start_file(*name, options)?;
        archive.write_all(bytes)?;
    }
    Ok(archive.finish()?.into_inner())
}

fn rgb([r, g, b]: [u8; 3]) -> [u8; 4] {
    [r, g, b, 255]
}

fn rotation(rotation: [f32; 4]) -> [u8; 4] {
    let (largest, three) = quaternion::smallest_three(rotation);
    let [r, g, b] = three.map(|value| (127.5 + 127.5 * std::f64::consts::SQRT_2 * value).round() as u8);
    [r, g, b, LARGEST + largest as u8]
}

/// Ranges of the compressed coordinates by axis.
struct Places {
    mins: [f64; 3],
    maxs: [f64; 3],
}

impl Places {
    fn of(rows: &GaussianRows) -> Self {
        let fold = |of: fn(f32, f32) -> f32| {
            let bound = rows.means.iter().copied().reduce(|a, b| [0, 1, 2].map(|axis| of(a[axis], b[axis])));
            bound.unwrap_or_default().map(compressed)
        };
        Self { mins: fold(f32::min), maxs: fold(f32::max) }
    }

    fn place(&self, mean: [f32; 3]) -> [u16; 3] {
        [0, 1, 2].map(|axis| {
            let range = self.maxs[axis] - self.mins[axis];
            let share = if range > 0.0 { (compressed(mean[axis]) - self.mins[axis]) / range } else { 0.0 };
            // The cast clamps.
            (PLACES * share).round() as u16
        })
    }
}

/// The palette of higher harmonics and its pictures; `None` at degree 0.
fn higher(rows: &GaussianRows, options: SogOptions) -> Option<(Harmonics, [WebpPicture; 2])> {
    let per_row = rows.rest_per_row();
    if per_row == 0 || rows.is_empty() {
        return None;
    }
    let usual = rows.len().div_ceil(GAUSSIANS_PER_ENTRY).max(ENTRIES_MIN);
    let entries = options.entries.unwrap_or(usual).clamp(1, ENTRIES_MAX);
    let found = palette(&rows.sh_rest, per_row, entries);
    let quantised = quantise(&found.entries);
    let count = found.entries.len() / per_row;
    let coefficients = per_row / 3;
    let mut pixels: Vec<[u8; 4]> = quantised.indices.as_chunks::<3>().0.iter().map(|&indices| rgb(indices)).collect();
    let width = PER_ROW * coefficients;
    pixels.resize(pixels.len().next_multiple_of(width), [0, 0, 0, 255]);
    let centroids = WebpPicture { name: "shN_centroids.webp", width, pixels };
    let labels = WebpPicture::of("shN_labels.webp", rows.len(), |i| {
        let [low, high, ..] = found.labels[i].to_le_bytes();
        rgb([low, high, 0])
    });
    let files = [centroids.name, labels.name].map(str::to_owned);
    let harmonics = Harmonics { count, bands: rows.sh_degree, codebook: quantised.codebook, files };
    Some((harmonics, [centroids, labels]))
}

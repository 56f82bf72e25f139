//! Reading of an archive.

use std::f64::consts::FRAC_1_SQRT_2;
use std::fs::File;
use std::io::{BufReader, Cursor, Read};
use std::path::Path;

use image::{ImageFormat, ImageReader, Limits};
use zip::ZipArchive;

use super::meta::{Harmonics, Meta};
use super::{DEGREE_MAX, LARGEST, LEVELS, META, PER_ROW, PLACES, expanded};
use crate::FileError;
use crate::formats::{Format, SceneFile, extras, opacity, quaternion};
use crate::gaussians::GaussianRows;
use crate::ply::{TrainedAs, WorldFrame, brief};

/// Largest number of Gaussians for each byte of an archive. Scenes have one for ten bytes; the limit bounds what a small file asks for.
const GAUSSIANS_PER_BYTE: u64 = 16;

/// Largest size of a file in an archive, as a multiple of the archive's: it may be deflated.
const EXPANSION_MAX: u64 = 16;

/// Pixels that a picture may have beyond twice those that are needed; writers fill the last row.
const PIXELS_MORE: usize = 4_096;

/// Reads an archive.
pub fn read(path: &Path) -> Result<SceneFile, FileError> {
    let file = File::open(path).map_err(FileError::io(path, "open the scene (is the path right?)"))?;
    let bytes = file.metadata().map_err(FileError::io(path, "read the size of the file"))?.len();
    let broken = |detail: String| FileError::broken(path, Format::Sog, detail);
    let mut archive = ZipArchive::new(BufReader::new(file))
        .map_err(|error| broken(format!("its archive: {}", brief(&error.to_string()))))?;
    if archive.index_for_name(META).is_none() {
        let first = archive.file_names().next().and_then(Result::ok);
        let first = first.map_or("nothing".into(), |name| format!("`{}`", brief(&name)));
        let what = format!("a ZIP archive without `{META}`, so not SOG; it holds {first}");
        return Err(FileError::foreign(path, what, "unpack it, and name the scene in it"));
    }
    let mut load = |name: &str| {
        let told = |error: String| format!("`{}` in its archive: {}", brief(name), brief(&error));
        let entry = archive.by_name(name).map_err(|error| told(error.to_string()))?;
        let mut found = Vec::new();
        let size = entry.take(EXPANSION_MAX * bytes).read_to_end(&mut found);
        size.map_err(|error| told(error.to_string()))?;
        Ok(found)
    };
    let meta = load(META).map_err(broken)?;
    scene(&meta, bytes, &mut load).map_err(broken)
}

/// Reads the scene of a document; `load` returns a file by its name, and `bytes` is the size of the archive.
fn scene(json: &[u8], bytes: u64, load: &mut dyn FnMut(&str) -> Result<Vec<u8>, String>) -> Result<SceneFile, String> {
    #[derive(serde::Deserialize)]
    struct Version {
        version: Option<u32>,
    }
    let told = |error: serde_json::Error| format!("`{META}`: {}", brief(&error.to_string()));
    let Version { version } = serde_json::from_slice(json).map_err(told)?;
    if version != Some(2) {
        return Err(format!(
            "`{META}` is of version {}, expected 2",
            version.map_or("1".into(), |version| version.to_string())
        ));
    }
    let meta: Meta = serde_json::from_slice(json).map_err(told)?;
    if meta.count as u64 > GAUSSIANS_PER_BYTE.saturating_mul(bytes) {
        return Err(format!("`{META}` claims {} Gaussians, more than {bytes} bytes can hold", meta.count));
    }
    let mut picture = |name: &str, at_least: usize| picture(name, &load(name)?, at_least);
    let count = meta.count;
    let mut rows = GaussianRows::default();

    let [low, high] = [&meta.means.files[0], &meta.means.files[1]].map(|name| picture(name, count));
    let (low, high) = (low?.pixels, high?.pixels);
    let ranges = [0, 1, 2].map(|axis| (meta.means.mins[axis], meta.means.maxs[axis] - meta.means.mins[axis]));
    let mean = |(low, high): (&[u8; 4], &[u8; 4])| {
        [0, 1, 2].map(|axis| {
            let place = f64::from(u16::from_le_bytes([low[axis], high[axis]]));
            expanded(ranges[axis].0 + ranges[axis].1 * (place / PLACES))
        })
    };
    rows.means = low.iter().zip(&high).take(count).map(mean).collect();
    drop((low, high));

    let levels = codebook("scales", &meta.scales.codebook)?;
    let pixels = picture(&meta.scales.files[0], count)?.pixels;
    rows.log_scales = of_codebook(&pixels[..count], levels).collect();

    let pixels = picture(&meta.quats.files[0], count)?.pixels;
    rows.rotations = pixels[..count].iter().map(rotation).collect();

    let levels = codebook("sh0", &meta.sh0.codebook)?;
    let pixels = picture(&meta.sh0.files[0], count)?.pixels;
    rows.sh_dc = of_codebook(&pixels[..count], levels).collect();
    rows.logit_opacities = pixels[..count].iter().map(|&[.., a]| opacity::logit(a)).collect();

    if let Some(harmonics) = &meta.sh_n {
        higher(harmonics, &mut rows, &mut picture)?;
    }
    let WorldFrame { origin, metres_per_unit, trained } = extras::world(&meta.extras.unwrap_or_default());
    Ok(SceneFile { rows, origin, metres_per_unit, trained: TrainedAs { antialias: meta.antialias, ..trained } })
}

fn higher(
    harmonics: &Harmonics,
    rows: &mut GaussianRows,
    picture: &mut impl FnMut(&str, usize) -> Result<DecodedPicture, String>,
) -> Result<(), String> {
    let Harmonics { count, bands, codebook: levels, files: [centroids, labels] } = harmonics;
    if !(1..=DEGREE_MAX).contains(bands) {
        return Err(format!("`shN.bands` is {bands}, expected 1 to {DEGREE_MAX}"));
    }
    let levels = codebook("shN", levels)?;
    let coefficients = (bands + 1) * (bands + 1) - 1;
    let palette = picture(centroids, count.saturating_mul(coefficients))?;
    let width = PER_ROW * coefficients;
    if palette.width != width {
        return Err(format!(
            "`{}` is {} pixels wide, expected {width} for harmonics of degree {bands}",
            brief(centroids),
            palette.width
        ));
    }
    let labels = picture(labels, rows.len())?.pixels;
    rows.sh_degree = *bands;
    rows.sh_rest = Vec::with_capacity(3 * coefficients * rows.len());
    for [low, high, ..] in &labels[..rows.len()] {
        let label = usize::from(u16::from_le_bytes([*low, *high]));
        if label >= *count {
            return Err(format!("an index {label} in a palette of {count} entries"));
        }
        // Rows of the picture are rows of whole entries, so that entries follow each other.
        let entry = &palette.pixels[coefficients * label..coefficients * (label + 1)];
        rows.sh_rest.extend(of_codebook(entry, levels).flatten());
    }
    Ok(())
}

fn codebook<'a>(name: &str, levels: &'a [f32]) -> Result<&'a [f32], String> {
    match levels.len() {
        LEVELS => Ok(levels),
        found => Err(format!("`{name}.codebook` has {found} values, expected {LEVELS}")),
    }
}

/// The values of three channels.
fn of_codebook(pixels: &[[u8; 4]], levels: &[f32]) -> impl Iterator<Item = [f32; 3]> {
    pixels.iter().map(|&[r, g, b, _]| [r, g, b].map(|index| levels[usize::from(index)]))
}

fn rotation(&[r, g, b, a]: &[u8; 4]) -> [f32; 4] {
    let three = [r, g, b].map(|value| FRAC_1_SQRT_2 * (f64::from(value) / 127.5 - 1.0));
    // Programs take other values of alpha for the identity.
    match a.checked_sub(LARGEST) {
        Some(largest) => quaternion::from_smallest_three(usize::from(largest), three),
        None => [1.0, 0.0, 0.0, 0.0],
    }
}

/// A picture of four channels, row by row.
struct DecodedPicture {
    width: usize,
    pixels: Vec<[u8; 4]>,
}

/// Decodes a picture of at least `needed` pixels, and not many more.
fn picture(name: &str, file: &[u8], needed: usize) -> Result<DecodedPicture, String> {
    let told = |error: &dyn std::fmt::Display| format!("`{}`: {}", brief(name), brief(&error.to_string()));
    // The format allows every lossless format, and its writers write WebP.
    let kind = image::guess_format(file).map_err(|error| told(&error))?;
    if !matches!(kind, ImageFormat::WebP | ImageFormat::Png) {
        return Err(format!("`{}` is {kind:?}, expected WebP or PNG", brief(name)));
    }
    let reader = || ImageReader::with_format(Cursor::new(file), kind);
    let (width, height) = reader().into_dimensions().map_err(|error| told(&error))?;
    let found = u64::from(width) * u64::from(height);
    let most = needed.saturating_mul(2).saturating_add(PIXELS_MORE) as u64;
    if found < needed as u64 || found > most {
        return Err(format!("`{}` has {width} × {height} pixels, expected {needed} to {most}", brief(name)));
    }
    let mut limits = Limits::default();
    limits.max_alloc = Some(16 * found + (1 << 20));
    let mut reader = reader();
    reader.limits(limits);
    let rgba = reader.decode().map_err(|error| told(&error))?.into_rgba8();
    Ok(DecodedPicture { width: width as usize, pixels: rgba.into_raw().as_chunks().0.to_vec() })
}

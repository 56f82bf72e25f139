//! Formats of scene files as a dial: bytes a splat against the error of the pictures.

use std::fmt::Write;
use std::fs;
use std::path::Path;

use anyhow::{Context, Result};
use splat_model::formats::{self, Format, SceneFile, SpzOptions};
use splat_model::gaussians::{GaussianRows, Gaussians};
use splat_op::{Splats, render_view};

use super::errors::PictureError;
use super::measure::Bench;
use super::plot::{Chart, Dot, DotMark};
use super::quartiles::{Quartiles, decibels, frontier};
use super::subject::host;
use crate::{input, progress};

/// Bits of SPZ's harmonics that are measured besides those of the format's reference.
const SPZ_BITS: [u8; 2] = [6, 8];

/// A scene in one format.
pub struct StoredScene {
    pub name: String,
    sh_degree: usize,
    /// Size of the file, bytes.
    bytes: u64,
    bytes_each: f64,
    /// PSNR against the render of the scene as it was given, over all views, dB.
    pub error_db: f64,
    /// PSNR, dB, and SSIM against the photographs.
    scores: (f64, f64),
}

/// One way to store a scene: a format, a degree and, for SPZ, bits.
type StoredWay = (Format, usize, Option<u8>);

/// Every format with all harmonics, then SPZ with other numbers of bits, then with lower degrees.
fn ways(sh_degree: usize) -> Vec<StoredWay> {
    let all = Format::READ.into_iter().map(|format| (format, sh_degree, None));
    let bits = SPZ_BITS.into_iter().filter(|_| sh_degree > 0).map(|bits| (Format::Spz, sh_degree, Some(bits)));
    let degrees = (0..sh_degree).rev().map(|degree| (Format::Spz, degree, Some(SPZ_BITS[0]).filter(|_| degree > 0)));
    all.chain(bits).chain(degrees).collect()
}

/// Writes the scene to `file`, in a temporary folder, in every way, reads it again, and compares its renders with those of the scene itself.
///
/// # Errors
/// If the file cannot be written or read, or the operation refuses the scene.
pub fn measure(
    bench: &Bench,
    rows: &GaussianRows,
    file: &Path,
    score: impl Fn(&Splats) -> Result<(f64, f64)>,
) -> Result<Vec<StoredScene>> {
    let ways = ways(rows.sh_degree);
    let counter = progress::counter("writing formats", ways.len());
    let of_scene: Vec<Vec<f64>> = pictures(bench, &Gaussians::from_rows(rows, &bench.place.device)?.splats())?;
    let stored = ways.into_iter().map(|(format, sh_degree, bits)| {
        let rows = input::selected(rows, 0..rows.len(), sh_degree);
        let scene = SceneFile { rows, ..SceneFile::default() };
        match bits {
            Some(bits) => formats::write_spz(file, &scene, SpzOptions { sh_bits: [bits; 2], ..SpzOptions::default() }),
            None => formats::write(file, &scene, format),
        }?;
        let bytes = fs::metadata(file).with_context(|| format!("cannot read the size of {}", file.display()))?.len();
        let read = formats::read(file)?.0.rows;
        let splats = Gaussians::from_rows(&read, &bench.place.device)?.splats();
        let found = pictures(bench, &splats)?;
        let error = found.iter().zip(&of_scene).map(|(found, scene)| PictureError::between(found, scene));
        counter.inc(1);
        Ok(StoredScene {
            name: bits.map_or(format.to_string(), |bits| format!("{format}, {bits} bits")),
            sh_degree: read.sh_degree,
            bytes,
            bytes_each: bytes as f64 / read.len().max(1) as f64,
            error_db: decibels(error.fold(PictureError::default(), PictureError::and).rms()),
            scores: score(&splats)?,
        })
    });
    let stored = stored.collect::<Result<Vec<_>>>().context("the scene cannot be measured in other formats");
    counter.finish_and_clear();
    stored
}

fn pictures(bench: &Bench, splats: &Splats) -> Result<Vec<Vec<f64>>> {
    let render = |camera| Ok(host(render_view(splats, camera, &bench.place.extras, &bench.base)?.colour));
    bench.place.cameras.iter().map(render).collect()
}

/// The scenes that no other beats in both bytes and error.
fn members(stored: &[StoredScene]) -> Vec<usize> {
    let point = |scene: &StoredScene| {
        let [lower, median, upper] = [scene.bytes_each; 3];
        (scene.error_db, Quartiles { lower, median, upper })
    };
    frontier(&stored.iter().map(point).collect::<Vec<_>>())
}

/// Returns the section of the page.
pub fn section(stored: &[StoredScene]) -> String {
    let mut text = String::from(
        "\n## Formats\n\nThe scene as `splat convert` writes it, with `--sh-bits` and `--sh-degree`, rendered by the standard. *Error* is the \
         PSNR against the renders of the scene as it is, in dB. Rows in bold are smaller than every row that is as accurate.\n\n\
         ![Bytes a splat against error](pareto_formats.svg)\n\n\
         | format | degree | bytes | bytes a splat | error, dB | PSNR, dB | SSIM |\n|---|---|---|---|---|---|---|\n",
    );
    let members = members(stored);
    for (i, scene) in stored.iter().enumerate() {
        let StoredScene { name, sh_degree, bytes, bytes_each, scores: (psnr, ssim), .. } = scene;
        let name = if members.contains(&i) { format!("**{name}**") } else { name.clone() };
        let error = if scene.is_exact() { "–".into() } else { format!("{:.1}", scene.error_db) };
        _ = writeln!(text, "| {name} | {sh_degree} | {bytes} | {bytes_each:.1} | {error} | {psnr:.2} | {ssim:.4} |");
    }
    text
}

/// Returns the plot of bytes a splat against error. A format without loss has no place in it.
pub fn chart(stored: &[StoredScene], title: String) -> Chart {
    let members = members(stored);
    let dot = |(i, scene): (usize, &StoredScene)| Dot {
        name: format!("{}, degree {}", scene.name, scene.sh_degree),
        mark: if i < Format::READ.len() { DotMark::Preset } else { DotMark::Dial },
        x: [scene.bytes_each; 3],
        y: scene.error_db,
        member: members.contains(&i),
    };
    let dots = stored.iter().enumerate().filter(|(_, scene)| !scene.is_exact()).map(dot).collect();
    Chart { title, x: "bytes a splat", y: "PSNR against the scene's own render, dB", dots }
}

impl StoredScene {
    /// Whether the file holds the scene without loss.
    fn is_exact(&self) -> bool {
        self.error_db >= decibels(0.0)
    }
}

#[cfg(test)]
mod tests;

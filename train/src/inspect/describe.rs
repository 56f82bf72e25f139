//! Scenes and captures in numbers, and what is odd about them.

use std::fs;
use std::path::Path;

use anyhow::{Context, Result};
use serde::Serialize;
use splat_model::capture::{Capture, PointsSeen, Split};
use splat_model::cleanup::Bulk;
use splat_model::effects::masks;
use splat_model::formats;
use splat_model::ply::TrainedAs;
use splat_model::quantile::quantile;
use splat_op::RenderOptions;

use crate::input;
use crate::output::short;

/// Smallest and largest of some positions, in the coordinates of the file, scene units.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
struct BoundingBox {
    low: [f64; 3],
    high: [f64; 3],
}

/// A scene in numbers.
#[derive(Debug, Serialize)]
pub struct SceneInfo {
    kind: &'static str,
    format: String,
    bytes: u64,
    splats: usize,
    sh_degree: usize,
    /// Further groups of parameters: name and numbers per Gaussian.
    groups: Vec<(String, usize)>,
    /// Origin that positions are relative to.
    origin: [f64; 3],
    trained: TrainedAs,
    /// Bounds of all centres, and of 90% of them along each axis; null without splats that can be rendered.
    bounds: Option<BoundingBox>,
    bulk: Option<BoundingBox>,
    /// The longest standard deviation of each Gaussian, scene units: the values below which 5%, 50% and 95% of the Gaussians lie.
    sigma: [f64; 3],
    /// The same of the longest standard deviation divided by the shortest.
    needle: [f64; 3],
    opacity: [f64; 3],
    /// Memory of the parameters in f32, and with the gradients and moments of training, MiB.
    parameters_mib: f64,
    training_mib: f64,
    warnings: Vec<String>,
}

/// A capture in numbers.
#[derive(Debug, Serialize)]
pub struct CaptureInfo {
    kind: &'static str,
    format: &'static str,
    views: usize,
    held_out: usize,
    /// Whether the files themselves say which views are held out.
    own_split: bool,
    cameras: Vec<CameraInfo>,
    /// Bounds of the camera centres, and of the sparse points.
    camera_bounds: Option<BoundingBox>,
    /// About the radius of the room that the cameras fill, scene units.
    extent: f64,
    points: usize,
    point_bounds: Option<BoundingBox>,
    masks: usize,
    /// Offset that was subtracted from every position.
    origin: [f64; 3],
    /// Memory of all decoded photographs, MiB.
    photographs_mib: f64,
    warnings: Vec<String>,
}

/// Views with pictures of one size and one camera model.
#[derive(Debug, Serialize)]
struct CameraInfo {
    model: String,
    width: usize,
    height: usize,
    /// Smallest and largest focal length along x, px.
    focal_px: [f64; 2],
    views: usize,
}

pub fn of_scene(path: &Path) -> Result<SceneInfo> {
    let (scene, format) = formats::read(path).context("cannot read the scene")?;
    let rows = &scene.rows;
    rows.check()?;
    let usable: Vec<usize> = (0..rows.len()).filter(|&row| rows.is_usable(row)).collect();
    let means: Vec<[f32; 3]> = usable.iter().map(|&row| rows.means[row]).collect();
    let of = |value: &dyn Fn(usize) -> f64| quantiles(usable.iter().map(|&row| value(row)).collect());
    let longest = |row: usize| rows.log_scales[row].into_iter().fold(f32::NEG_INFINITY, f32::max);
    let shortest = |row: usize| rows.log_scales[row].into_iter().fold(f32::INFINITY, f32::min);
    let opacity = |row: usize| 1.0 / (1.0 + (-f64::from(rows.logit_opacities[row])).exp());
    let needle = |row: usize| f64::from(longest(row) - shortest(row)).exp();
    let bulk = Bulk::of(&means);

    let mut warnings = Vec::new();
    let mut warn = |count: usize, what: &str| {
        if count > 0 {
            warnings.push(format!("{count} splats {what}"));
        }
    };
    let alpha_min = RenderOptions::standard().alpha_min;
    let count = |odd: &dyn Fn(usize) -> bool| usable.iter().filter(|&&row| odd(row)).count();
    warn(rows.len() - usable.len(), "cannot be rendered: `splat clean` and `splat convert` drop them");
    warn(count(&|row| opacity(row) < alpha_min), "are never drawn, because their opacity is below 1/255");
    warn(count(&|row| needle(row) > 1e3), "are needles, more than 1,000 times as long as wide");
    let far = |row: usize| bulk.as_ref().is_some_and(|bulk| !bulk.holds(&rows.means[row]));
    warn(count(&far), "are outliers, more than 16 times the scene's width outside it");
    if rows.is_empty() {
        warnings.push("there are no splats".into());
    }
    if rows.sh_degree > 3 {
        warnings.push("many readers support harmonics to degree 3 only: `splat convert --sh-degree 3`".into());
    }
    let further = rows.groups.iter().map(|group| group.width).sum::<usize>();
    let parameters_mib = (4 * rows.len() * (14 + rows.rest_per_row() + further)) as f64 / f64::from(1 << 20);
    Ok(SceneInfo {
        kind: "scene",
        format: format.to_string(),
        bytes: fs::metadata(path).with_context(|| format!("cannot read the size of {}", path.display()))?.len(),
        splats: rows.len(),
        sh_degree: rows.sh_degree,
        groups: rows.groups.iter().map(|group| (group.name.clone(), group.width)).collect(),
        origin: scene.origin.to_array(),
        trained: scene.trained,
        bounds: bounds(means.iter().map(|mean| mean.map(f64::from))),
        bulk: bulk.map(|bulk| BoundingBox { low: bulk.low, high: bulk.high }),
        sigma: of(&|row| f64::from(longest(row)).exp()),
        needle: of(&needle),
        opacity: of(&opacity),
        parameters_mib,
        training_mib: 4.0 * parameters_mib,
        warnings,
    })
}

/// Describes a capture, `seen` being its points.
pub fn of_capture(capture: &Capture, seen: &PointsSeen) -> CaptureInfo {
    let mut cameras: Vec<CameraInfo> = Vec::new();
    for view in &capture.views {
        let lens = &view.intrinsics;
        let model = format!("{:?}", lens.model);
        let same = |camera: &&mut CameraInfo| {
            (&camera.model, camera.width, camera.height) == (&model, lens.width, lens.height)
        };
        if let Some(camera) = cameras.iter_mut().find(same) {
            camera.views += 1;
            camera.focal_px = [camera.focal_px[0].min(lens.fx), camera.focal_px[1].max(lens.fx)];
        } else {
            let (width, height, focal_px) = (lens.width, lens.height, [lens.fx; 2]);
            cameras.push(CameraInfo { model, width, height, focal_px, views: 1 });
        }
    }
    let mut warnings = capture.remarks.clone();
    let all: Vec<usize> = (0..capture.views.len()).collect();
    warnings.extend(capture.check_photographs(&all).err().map(|error| error.to_string()));
    if capture.points.positions.is_empty() {
        warnings.push("there are no sparse points: training starts from random splats".into());
    } else {
        // A few points beyond all photographs are usual.
        warnings.extend((2 * seen.unseen > seen.points).then(|| seen.unseen_said()));
    }
    let pixels: f64 = capture.views.iter().map(|view| (view.intrinsics.width * view.intrinsics.height) as f64).sum();
    let split = Split::of(capture, capture.split.is_none().then_some(Split::USUAL));
    CaptureInfo {
        kind: "capture",
        format: capture.format,
        views: capture.views.len(),
        held_out: split.test.len(),
        own_split: capture.split.is_some(),
        cameras,
        camera_bounds: bounds(capture.views.iter().map(|view| view.cam_from_world.inverse().translation.to_array())),
        extent: input::extent(capture),
        points: capture.points.positions.len(),
        point_bounds: bounds(capture.points.positions.iter().map(|point| point.map(f64::from))),
        masks: masks::find(capture).iter().flatten().count(),
        origin: capture.origin.to_array(),
        photographs_mib: 3.0 * pixels / f64::from(1 << 20),
        warnings,
    }
}

fn bounds(positions: impl Iterator<Item = [f64; 3]>) -> Option<BoundingBox> {
    positions.fold(None, |bounds, position| {
        let BoundingBox { low, high } = bounds.unwrap_or(BoundingBox { low: position, high: position });
        let of = |pick: fn(f64, f64) -> f64, with: [f64; 3]| [0, 1, 2].map(|axis| pick(with[axis], position[axis]));
        Some(BoundingBox { low: of(f64::min, low), high: of(f64::max, high) })
    })
}

fn quantiles(mut values: Vec<f64>) -> [f64; 3] {
    [0.05, 0.5, 0.95].map(|share| quantile(&mut values, share).unwrap_or_default())
}

pub fn scene_text(info: &SceneInfo) -> String {
    let SceneInfo { format, splats, sh_degree, bytes, .. } = info;
    let mut lines = vec![format!("{format}, {splats} splats of degree {sh_degree}, {bytes} bytes")];
    if !info.groups.is_empty() {
        let groups = info.groups.iter().map(|(name, width)| format!("{name} [{width}]"));
        lines.push(format!("further groups: {}", groups.collect::<Vec<_>>().join(", ")));
    }
    lines.extend(info.bounds.map(|bounds| line("centres", &bounds.to_string())));
    lines.extend(info.bulk.map(|bounds| line("90% of centres", &bounds.to_string())));
    lines.push(line("origin", &position(&info.origin)));
    if info.trained != TrainedAs::default() {
        lines.extend(serde_json::to_string(&info.trained).ok().map(|trained| line("trained as", &trained)));
    }
    lines.push(line("", "5%, 50% and 95% of the splats are below"));
    let three = |values: [f64; 3]| values.map(|value| short(value, 4)).join(", ");
    lines.push(line("sigma", &format!("{} scene units, the longest", three(info.sigma))));
    lines.push(line("longest / shortest", &three(info.needle)));
    lines.push(line("opacity", &three(info.opacity)));
    let (alone, trained) = (info.parameters_mib, info.training_mib);
    lines.push(line("memory", &format!("{alone:.1} MiB of parameters, {trained:.1} MiB with gradients and moments")));
    with_warnings(lines, &info.warnings)
}

pub fn capture_text(info: &CaptureInfo) -> String {
    let CaptureInfo { format, views, held_out, points, .. } = info;
    let own = if info.own_split { ", as its files say" } else { "" };
    let mut lines = vec![format!("{format}, {views} photographs ({held_out} held out{own}), {points} points")];
    for CameraInfo { model, width, height, focal_px: [least, most], views } in &info.cameras {
        lines.push(line(
            "cameras",
            &format!("{views} of {width} x {height} px, {model}, focal length {least:.1} to {most:.1} px"),
        ));
    }
    lines.extend(info.camera_bounds.map(|bounds| line("camera centres", &bounds.to_string())));
    lines.push(line("extent", &format!("{:.4}", info.extent)));
    lines.extend(info.point_bounds.map(|bounds| line("points", &bounds.to_string())));
    lines.push(line("origin", &position(&info.origin)));
    lines.push(line("masks", &info.masks.to_string()));
    lines.push(line("memory", &format!("{:.1} MiB of decoded photographs", info.photographs_mib)));
    with_warnings(lines, &info.warnings)
}

fn with_warnings(mut lines: Vec<String>, warnings: &[String]) -> String {
    lines.extend(warnings.iter().map(|warning| line("warning", warning)));
    lines.join("\n")
}

fn line(name: &str, value: &str) -> String {
    format!("  {name:18}  {value}")
}

fn position(values: &[f64; 3]) -> String {
    values.map(|value| short(value, 4)).join(" ")
}

impl std::fmt::Display for BoundingBox {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{} to {}", position(&self.low), position(&self.high))
    }
}

#[cfg(test)]
mod tests;

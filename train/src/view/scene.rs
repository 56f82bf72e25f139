//! A scene for the browser: a PLY file in memory, of limited size, and viewpoints.

use anyhow::{Context, Result};
use glam::{DAffine3, DVec3, Vec3};
use serde::Serialize;
use splat_model::capture::Photograph;
use splat_model::cleanup::Bulk;
use splat_model::gaussians::GaussianRows;
use splat_model::ply;
use splat_op::Intrinsics;

use crate::input::selected;

/// Highest degree of the spherical harmonics that the viewer's library reads.
const DEGREE_MAX: usize = 3;

/// Vertical field of view without a camera of a capture, degrees.
const FOV_Y_DEGREES: f64 = 50.0;

/// A scene to show, possibly reduced.
#[derive(Clone, Debug)]
pub struct ShownScene {
    /// Content of a PLY file.
    pub ply: Vec<u8>,
    /// Number of Gaussians in it.
    pub splats: usize,
    /// Number of Gaussians in the scene that can be drawn.
    pub of: usize,
    /// Degree of the spherical harmonics in it.
    pub sh_degree: usize,
    /// Degree of the spherical harmonics in the scene.
    pub of_sh_degree: usize,
    /// Position and size of the scene.
    pub extent: Extent,
}

/// Position and size of a scene, scene units, in the frame of its rows. Single Gaussians far away do not count.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Extent {
    /// Median of the centres, by axis.
    pub centre: DVec3,
    /// Radius around the centre that contains nine tenths of the Gaussians.
    pub radius: f64,
}

impl ShownScene {
    /// Prepares a scene in at most `most_bytes`, if necessary with spherical harmonics of a lower degree, and then only
    /// with the Gaussians that cover the most. Gaussians that cannot be drawn are left out. An error if the rows do not
    /// fit together, or none of them can be drawn.
    pub fn new(rows: &GaussianRows, most_bytes: usize) -> Result<Self> {
        rows.check()?;
        let usable: Vec<usize> = (0..rows.len()).filter(|&i| rows.is_usable(i)).collect();
        let extent = Extent::of(rows, &usable).context("the scene holds no splat that can be drawn")?;
        let fits = |degree: &usize| usable.len().saturating_mul(bytes_per_row(*degree)) <= most_bytes;
        let sh_degree = (0..=rows.sh_degree.min(DEGREE_MAX)).rev().find(fits).unwrap_or(0);
        let kept = largest(rows, usable.clone(), most_bytes / bytes_per_row(sh_degree));
        let mut ply = Vec::new();
        // The viewer draws no further groups.
        let shown = GaussianRows { groups: Vec::new(), ..selected(rows, kept.iter().copied(), sh_degree) };
        ply::write_to(&mut ply, &shown, DVec3::ZERO)?;
        Ok(Self { ply, splats: kept.len(), of: usable.len(), sh_degree, of_sh_degree: rows.sh_degree, extent })
    }

    /// Describes the parts of the scene that are not shown; empty if all are.
    pub fn omissions(&self) -> String {
        let mut text = String::new();
        if self.splats < self.of {
            text = format!("The {} splats of {} that cover the most. ", self.splats, self.of);
        }
        if self.sh_degree < self.of_sh_degree {
            let (shown, all) = (self.sh_degree, self.of_sh_degree);
            text.push_str(&format!("Colours with spherical harmonics to degree {shown} of {all}. "));
        }
        text
    }
}

/// Returns the bytes of a Gaussian in a file: centre, normal, opacity, scales, rotation, and spherical harmonics of three channels.
fn bytes_per_row(sh_degree: usize) -> usize {
    4 * (3 + 3 + 1 + 3 + 4 + 3 * (sh_degree + 1) * (sh_degree + 1))
}

/// Returns the `most` rows with the largest product of opacity and area, in their original order.
fn largest(rows: &GaussianRows, mut of: Vec<usize>, most: usize) -> Vec<usize> {
    if of.len() <= most {
        return of;
    }
    // The logarithm of sigmoid(logit) times the two larger standard deviations, which neither over- nor underflows.
    let cover = |i: usize| {
        let logit = f64::from(rows.logit_opacities[i]);
        let log_opacity = if logit < 0.0 { logit - logit.exp().ln_1p() } else { -(-logit).exp().ln_1p() };
        let scales = rows.log_scales[i].map(f64::from);
        let smallest = scales.into_iter().fold(f64::INFINITY, f64::min);
        log_opacity + scales.into_iter().sum::<f64>() - smallest
    };
    of.sort_by(|&a, &b| cover(b).total_cmp(&cover(a)).then(a.cmp(&b)));
    of.truncate(most);
    of.sort_unstable();
    of
}

impl Extent {
    /// Returns the extent of the Gaussians `which`; `None` if there are none.
    fn of(rows: &GaussianRows, which: &[usize]) -> Option<Self> {
        let centre = DVec3::from(Bulk::of(which.iter().map(|&i| &rows.means[i]))?.middle);
        let mut distances: Vec<f64> =
            which.iter().map(|&i| Vec3::from(rows.means[i]).as_dvec3().distance(centre)).collect();
        let at = distances.len() * 9 / 10;
        let (_, radius, _) = distances.select_nth_unstable_by(at, f64::total_cmp);
        // All Gaussians may be in one place, which must not lead to a division by zero.
        let radius = if *radius > 0.0 { *radius } else { 1.0 };
        Some(Self { centre, radius })
    }
}

#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Viewpoint {
    /// Name of the photograph.
    pub name: String,
    /// Camera centre, in the frame of the scene's rows.
    pub position: [f64; 3],
    /// Unit vector along the optical axis.
    pub forward: [f64; 3],
    /// Unit vector upwards in the picture.
    #[serde(skip)]
    pub up: DVec3,
    /// Vertical field of view, degrees.
    pub fov_y_degrees: f64,
}

impl Viewpoint {
    /// Returns the viewpoint of a camera.
    pub fn of(name: &str, intrinsics: &Intrinsics, cam_from_world: &DAffine3) -> Self {
        let world_from_cam = cam_from_world.inverse();
        Self {
            name: name.to_owned(),
            position: world_from_cam.translation.to_array(),
            forward: world_from_cam.matrix3.z_axis.to_array(),
            up: -world_from_cam.matrix3.y_axis,
            fov_y_degrees: 2.0 * (0.5 * intrinsics.height as f64 / intrinsics.fy).atan().to_degrees(),
        }
    }

    /// Returns the viewpoints of photographs.
    pub fn all(photos: &[Photograph]) -> Vec<Self> {
        photos.iter().map(|photo| Self::of(&photo.name, &photo.intrinsics, &photo.cam_from_world)).collect()
    }

    /// Returns a viewpoint outside the scene, with +y down as in most captures.
    pub fn outside(extent: &Extent) -> Self {
        let forward = DVec3::new(0.0, 0.3, 1.0).normalize();
        Self {
            name: "from outside".into(),
            position: (extent.centre - 2.5 * extent.radius * forward).to_array(),
            forward: forward.to_array(),
            up: DVec3::NEG_Y,
            fov_y_degrees: FOV_Y_DEGREES,
        }
    }
}

#[cfg(test)]
mod tests;

//! Search for the stage that goes wrong first, after a step whose loss or gradients are not finite. Slow, because it reads all
//! outputs.

use std::fmt;

use burn::tensor::Tensor;
use splat_op::{Intersections, Projected, Rendered, SplatError, colours_up_to, intersect, rasterize};

use crate::effects::RenderInput;
use crate::gaussians::values_of;

/// The stages of a render, in the order in which they are computed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum RenderStage {
    /// Gaussians to ellipses.
    Project,
    /// Spherical harmonics to colours.
    Sh,
    /// Ellipses to tile lists.
    Intersect,
    /// Tile lists to a picture.
    Rasterize,
}

impl fmt::Display for RenderStage {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.write_str(&format!("{self:?}").to_lowercase())
    }
}

/// An output that is not valid: the stage, and the field, its position, the found and the expected value.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Wrong {
    pub stage: RenderStage,
    pub detail: String,
}

impl fmt::Display for Wrong {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(out, "the stage `{}` is the first to go wrong: {}", self.stage, self.detail)
    }
}

/// [`RenderInput::render`] stage by stage, until an output is not valid. A render that is refused tells nothing.
pub(super) fn first_wrong(input: &RenderInput) -> Option<Wrong> {
    let rendered = || -> Result<Option<Wrong>, SplatError> {
        let features = colours_up_to(&input.splats, &input.camera, input.options.sh_degree)?;
        let projected = input.project()?;
        let opacities = match check_projected(&projected) {
            Ok(opacities) => opacities,
            Err(wrong) => return Ok(Some(wrong)),
        };
        let intersections = intersect(&projected, &input.options)?;
        let before =
            check_colours(&features, &opacities).and_then(|()| check_intersections(&intersections, projected.len()));
        if let Err(wrong) = before {
            return Ok(Some(wrong));
        }
        let picture = rasterize(&projected, &features, &intersections, &input.extras, &input.options)?;
        Ok(check_picture(&picture).err())
    };
    rendered().ok().flatten()
}

/// Checks that ellipses are finite, have an area, and have opacities from 0 to 1. Returns the opacities.
fn check_projected(projected: &Projected) -> Result<Vec<f32>, Wrong> {
    let ellipses = projected.ellipses();
    let look = |field, values: &[f32], columns, expected, good: fn(f32) -> bool| {
        look(RenderStage::Project, field, (values, columns, "Gaussian"), expected, good)
    };
    let positive = |value: f32| value > 0.0 && value.is_finite();
    look("mean2d", &host(ellipses.mean2d), 2, "a finite number", f32::is_finite)?;
    look("sigma_u", &host(ellipses.sigma_u), 1, "a positive, finite number", positive)?;
    look("shear", &host(ellipses.shear), 1, "a finite number", f32::is_finite)?;
    look("sigma_v", &host(ellipses.sigma_v), 1, "a positive, finite number", positive)?;
    look("depth", &host(ellipses.depth), 1, "a finite number of at least 0", |z| z >= 0.0 && z.is_finite())?;
    let opacities = host(ellipses.opacity);
    look("opacity", &opacities, 1, "0 to 1", |value| (0.0..=1.0).contains(&value))?;
    Ok(opacities)
}

/// Checks that the colours of visible Gaussians are finite. Colours of masked Gaussians may have any value.
fn check_colours(colours: &Tensor<2>, opacities: &[f32]) -> Result<(), Wrong> {
    let columns = colours.dims()[1];
    let mut values = host(colours.clone());
    for (row, opacity) in values.chunks_exact_mut(columns).zip(opacities) {
        if *opacity == 0.0 {
            row.fill(0.0);
        }
    }
    look(RenderStage::Sh, "colour", (&values, columns, "Gaussian"), "a finite number", f32::is_finite)
}

/// Checks that no tile lists more Gaussians than exist.
fn check_intersections(intersections: &Intersections, splats: usize) -> Result<(), Wrong> {
    let counts = host(intersections.counts.clone().float());
    let wrong = counts.iter().position(|count| !(*count >= 0.0 && *count <= splats as f32));
    let Some(at) = wrong else { return Ok(()) };
    let detail = format!("tile {at} lists {} Gaussians, expected 0 to {splats}", counts[at]);
    Err(Wrong { stage: RenderStage::Intersect, detail })
}

fn check_picture(picture: &Rendered<3>) -> Result<(), Wrong> {
    let channels = picture.colour.dims()[2];
    let (colour, alpha) = (host(picture.colour.clone()), host(picture.alpha.clone()));
    look(RenderStage::Rasterize, "colour", (&colour, channels, "pixel"), "a finite number", f32::is_finite)?;
    look(RenderStage::Rasterize, "alpha", (&alpha, 1, "pixel"), "0 to 1", |value| (0.0..=1.0).contains(&value))
}

/// Returns an error for the first value for which `good` is false.
fn look(
    stage: RenderStage,
    field: &str,
    (values, columns, row): (&[f32], usize, &str),
    expected: &str,
    good: fn(f32) -> bool,
) -> Result<(), Wrong> {
    let Some(at) = values.iter().position(|value| !good(*value)) else { return Ok(()) };
    let (of, bad) = (at / columns.max(1), values.iter().filter(|value| !good(**value)).count());
    let detail = format!(
        "`{field}` of {row} {of} is {}, expected {expected}; {bad} of {} values are not",
        values[at],
        values.len()
    );
    Err(Wrong { stage, detail })
}

fn host<const D: usize>(tensor: Tensor<D>) -> Vec<f32> {
    values_of(tensor.inner())
}

#[cfg(test)]
mod tests;

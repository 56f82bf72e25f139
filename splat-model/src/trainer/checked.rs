//! A step that checks the output of every stage, for `splat train --check`. Slow, because it reads all outputs.

use std::fmt;

use burn::tensor::Tensor;
use splat_op::{Intersections, Projected, Rendered, colours_up_to, intersect, rasterize};

use super::TrainError;
use crate::density::rows::Gradients;
use crate::effects::RenderInput;
use crate::gaussians::{GaussianRows, values_of};

/// The stages of a step, in the order in which they are computed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Stage {
    /// Gaussians to ellipses.
    Project,
    /// Spherical harmonics to colours.
    Sh,
    /// Ellipses to tile lists.
    Intersect,
    /// Tile lists to a picture.
    Rasterize,
    /// The picture to a number.
    Loss,
    /// The gradients of the parameters.
    Gradients,
    /// The parameters after the optimiser's step.
    Parameters,
}

impl fmt::Display for Stage {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.write_str(&format!("{self:?}").to_lowercase())
    }
}

/// An invalid output: the stage, and the field, its position, the found and the expected value.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Wrong {
    pub stage: Stage,
    pub detail: String,
}

/// [`RenderInput::render`] stage by stage, with a check of each output before the next stage runs.
pub(super) fn render_checked(
    input: &RenderInput,
    error: impl Fn(Wrong) -> TrainError,
) -> Result<Rendered<3>, TrainError> {
    let features = colours_up_to(&input.splats, &input.camera, input.options.sh_degree)?;
    let projected = input.project()?;
    let opacities = check_projected(&projected).map_err(&error)?;
    check_colours(&features, &opacities).map_err(&error)?;
    let intersections = intersect(&projected, &input.options)?;
    check_intersections(&intersections, projected.len()).map_err(&error)?;
    let picture = rasterize(&projected, &features, &intersections, &input.extras, &input.options)?;
    check_picture(&picture).map_err(&error)?;
    Ok(picture)
}

/// Checks that ellipses are finite, have an area, and have opacities from 0 to 1. Returns the opacities.
fn check_projected(projected: &Projected) -> Result<Vec<f32>, Wrong> {
    let ellipses = projected.ellipses();
    let look = |field, values: &[f32], columns, expected, good: fn(f32) -> bool| {
        look(Stage::Project, field, (values, columns, "Gaussian"), expected, good)
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
    look(Stage::Sh, "colour", (&values, columns, "Gaussian"), "a finite number", f32::is_finite)
}

/// Checks that no tile lists more Gaussians than exist.
fn check_intersections(intersections: &Intersections, splats: usize) -> Result<(), Wrong> {
    let counts = host(intersections.counts.clone().float());
    let wrong = counts.iter().position(|count| !(*count >= 0.0 && *count <= splats as f32));
    let Some(at) = wrong else { return Ok(()) };
    let detail = format!("tile {at} lists {} Gaussians, expected 0 to {splats}", counts[at]);
    Err(Wrong { stage: Stage::Intersect, detail })
}

fn check_picture(picture: &Rendered<3>) -> Result<(), Wrong> {
    let channels = picture.colour.dims()[2];
    let (colour, alpha) = (host(picture.colour.clone()), host(picture.alpha.clone()));
    look(Stage::Rasterize, "colour", (&colour, channels, "pixel"), "a finite number", f32::is_finite)?;
    look(Stage::Rasterize, "alpha", (&alpha, 1, "pixel"), "0 to 1", |value| (0.0..=1.0).contains(&value))
}

pub(super) fn check_loss(loss: &Tensor<1>) -> Result<(), Wrong> {
    let value = host(loss.clone());
    look(Stage::Loss, "the loss", (&value, 1, "value"), "a finite number", f32::is_finite)
}

pub(super) fn check_gradients(gradients: &Gradients) -> Result<(), Wrong> {
    fn one<'a, const D: usize>(
        field: &str,
        blocks: impl IntoIterator<Item = &'a Tensor<D>> + Clone,
    ) -> Result<(), Wrong> {
        let Some(first) = blocks.clone().into_iter().next() else { return Ok(()) };
        let columns = first.dims()[1..].iter().product();
        let values: Vec<f32> = blocks.into_iter().flat_map(|block| host(block.clone())).collect();
        look(Stage::Gradients, field, (&values, columns, "Gaussian"), "a finite number", f32::is_finite)
    }
    one("means", &gradients.means)?;
    one("rotations", &gradients.rotations)?;
    one("log_scales", &gradients.log_scales)?;
    one("logit_opacities", &gradients.logit_opacities)?;
    one("sh", gradients.sh.iter().chain(gradients.sh_more.iter().flatten()))
}

/// Checks that no Gaussian became unusable. `before` and `after` are the same Gaussians.
pub(super) fn check_parameters(before: &GaussianRows, after: &GaussianRows) -> Result<(), Wrong> {
    let spoilt = (0..after.len()).find(|&i| before.is_usable(i) && !after.is_usable(i));
    let Some(i) = spoilt else { return Ok(()) };
    let rest = after.rest_per_row();
    let detail = format!(
        "Gaussian {i} became unusable: mean {:?}, rotation {:?}, log_scale {:?}, logit_opacity {}, sh_dc {:?}, sh_rest {:?}",
        after.means[i],
        after.rotations[i],
        after.log_scales[i],
        after.logit_opacities[i],
        after.sh_dc[i],
        &after.sh_rest[rest * i..rest * (i + 1)],
    );
    Err(Wrong { stage: Stage::Parameters, detail })
}

/// Returns an error for the first value for which `good` is false.
fn look(
    stage: Stage,
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

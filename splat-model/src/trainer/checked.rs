//! Search for the stage whose output is not finite first, after a step whose loss or gradients are not. Slow: it reads all outputs.

use burn::tensor::Tensor;
use splat_op::{SplatError, colours_up_to, intersect, rasterize};

use crate::effects::RenderInput;
use crate::gaussians::values_of;

/// [`RenderInput::render`] stage by stage. Says which output is not finite first, if one is. A render that is refused tells nothing.
pub(super) fn first_wrong(input: &RenderInput) -> Option<String> {
    rendered(input).ok().flatten()
}

fn rendered(input: &RenderInput) -> Result<Option<String>, SplatError> {
    let projected = input.project()?;
    let ellipses = projected.ellipses();
    let fields = [
        ("mean2d", ellipses.mean2d),
        ("sigma_u", ellipses.sigma_u.unsqueeze_dim(1)),
        ("shear", ellipses.shear.unsqueeze_dim(1)),
        ("sigma_v", ellipses.sigma_v.unsqueeze_dim(1)),
        ("depth", ellipses.depth.unsqueeze_dim(1)),
        ("opacity", ellipses.opacity.clone().unsqueeze_dim(1)),
    ];
    let wrong = fields.into_iter().find_map(|(field, values)| look("project", field, "Gaussian", values));
    if wrong.is_some() {
        return Ok(wrong);
    }
    // Colours of Gaussians that are not drawn may have any value.
    let features = colours_up_to(&input.splats, &input.camera, input.options.sh_degree)?;
    let hidden = projected.visible().bool_not().unsqueeze_dim::<2>(1).expand(features.dims());
    let wrong = look("sh", "colour", "Gaussian", features.clone().mask_fill(hidden, 0.0));
    if wrong.is_some() {
        return Ok(wrong);
    }
    let picture =
        rasterize(&projected, &features, &intersect(&projected, &input.options)?, &input.extras, &input.options)?;
    let [height, width, channels] = picture.colour.dims();
    let wrong = look("rasterize", "colour", "pixel", picture.colour.reshape([height * width, channels]));
    Ok(wrong.or_else(|| look("rasterize", "alpha", "pixel", picture.alpha.reshape([height * width, 1]))))
}

/// Names the first value that is not finite.
fn look(stage: &str, field: &str, row: &str, values: Tensor<2>) -> Option<String> {
    let columns = values.dims()[1].max(1);
    let values = values_of(values.inner());
    let at = values.iter().position(|value| !value.is_finite())?;
    let bad = values.iter().filter(|value| !value.is_finite()).count();
    Some(format!(
        "the stage `{stage}` is the first to go wrong: `{field}` of {row} {} is {}; {bad} of {} values are not finite",
        at / columns,
        values[at],
        values.len()
    ))
}

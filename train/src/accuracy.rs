//! Choice of the function that a render computes, and of its accuracy.

use clap::ValueEnum;
use serde::{Deserialize, Serialize};
use splat_model::accuracy::{Preset, Setting};
use splat_model::ply::TrainedAs;
use splat_model::trainer::TrainConfig;
use splat_op::{Projection, RenderOptions};

/// Model choices: the function that a scene's parameters define. A scene is rendered with those of its training.
#[derive(Clone, Debug, Default, clap::Args, Serialize, Deserialize)]
pub struct ModelArgs {
    /// Dim splats smaller than a pixel, so that the scene also looks right from further away [default: as the scene was trained, or no]
    #[arg(long, value_name = "BOOL", num_args = 0..=1, require_equals = true, default_missing_value = "true")]
    pub antialias: Option<bool>,
    /// How a splat contributes to a pixel [default: as the scene was trained, or affine]
    #[arg(long, value_enum, value_name = "WHAT")]
    pub projection: Option<ProjectionArg>,
}

/// [`Projection`] on the command line.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum ProjectionArg {
    /// Projected ellipse: the projection is taken as affine around the splat's centre
    #[default]
    Affine,
    /// Largest value along the pixel's ray; takes half as long again
    RayMax,
}

impl ModelArgs {
    /// Returns the default configuration of a run with these model choices.
    pub fn config(&self) -> TrainConfig {
        let antialias = self.antialias.unwrap_or_default();
        let projection = match self.projection.unwrap_or_default() {
            ProjectionArg::Affine => Projection::Affine,
            ProjectionArg::RayMax => Projection::RayMax,
        };
        let standard = RenderOptions::standard();
        let dials = Setting::between(&standard, &standard.with_projection(projection));
        TrainConfig { antialias, dials, ..TrainConfig::default() }
    }

    /// Returns these choices, and where there is none, that of a scene's training.
    pub fn or(&self, trained: &TrainedAs) -> Self {
        let projection = if trained.ray_max { ProjectionArg::RayMax } else { ProjectionArg::Affine };
        Self { antialias: self.antialias.or(Some(trained.antialias)), projection: self.projection.or(Some(projection)) }
    }
}

/// Accuracy of renders.
#[derive(Clone, Copy, Debug, Default, clap::Args, Serialize, Deserialize)]
pub struct AccuracyArgs {
    /// Accuracy preset: fast, standard or exact
    #[arg(long, value_name = "PRESET", default_value_t)]
    pub accuracy: Preset,
}

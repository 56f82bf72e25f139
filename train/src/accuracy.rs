//! Choice of the function that a render computes, and of its accuracy.

use clap::ValueEnum;
use serde::{Deserialize, Serialize};
use splat_model::accuracy::{Preset, Setting};
use splat_model::trainer::TrainConfig;
use splat_op::{Order, Projection, RenderOptions};

/// Model choices: the function that a scene's parameters define. A scene is rendered with the choices it was trained
/// with.
#[derive(Clone, Debug, Default, clap::Args, Serialize, Deserialize)]
pub struct ModelArgs {
    /// Dim splats smaller than a pixel, so that the scene also looks right from further away. Evaluate and render a
    /// scene with the setting it was trained with
    #[arg(long)]
    pub antialias: bool,
    /// How a splat contributes to a pixel. Evaluate and render a scene with the setting it was trained with
    #[arg(long, value_enum, value_name = "WHAT", default_value_t)]
    pub projection: ProjectionArg,
    /// How splats are sorted by depth. Evaluate and render a scene with the setting it was trained with
    #[arg(long, value_enum, value_name = "WHAT", default_value_t)]
    pub order: OrderArg,
}

/// [`Projection`] on the command line.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum, Serialize, Deserialize)]
pub enum ProjectionArg {
    /// Projected ellipse: the projection is taken as affine around the splat's centre
    #[default]
    Affine,
    /// Largest value along the pixel's ray; about twice as slow
    RayMax,
}

/// [`Order`] on the command line.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum, Serialize, Deserialize)]
pub enum OrderArg {
    /// One global sort by the depths of the splats' centres
    #[default]
    CentreDepth,
    /// Sort for each pixel, so that nothing pops as the camera turns; about three times as slow
    PerPixelSort,
}

impl ModelArgs {
    /// Returns the default configuration of a run with these model choices.
    pub fn config(&self) -> TrainConfig {
        TrainConfig { antialias: self.antialias, dials: self.dials(), ..TrainConfig::default() }
    }

    /// The dials turned from the standard setting, apart from [`Self::antialias`].
    fn dials(&self) -> Setting {
        let projection = match self.projection {
            ProjectionArg::Affine => Projection::Affine,
            ProjectionArg::RayMax => Projection::RayMax,
        };
        let order = match self.order {
            OrderArg::CentreDepth => Order::CentreDepth,
            OrderArg::PerPixelSort => Order::PerPixelSort,
        };
        let standard = RenderOptions::standard();
        Setting::between(&standard, &standard.with_projection(projection).with_order(order))
    }
}

/// Accuracy of renders.
#[derive(Clone, Copy, Debug, Default, clap::Args, Serialize, Deserialize)]
pub struct AccuracyArgs {
    /// Accuracy preset: fast, standard or exact
    #[arg(long, value_name = "PRESET", default_value_t)]
    pub accuracy: Preset,
}

//! Implementations of the stages on Burn's CPU and GPU backends, with fusion and autodiff. Kernels and twins know none of
//! them.
//!
//! There is a trait for each group of operations that a backend implements. No method has a default body, so a backend that lacks
//! one does not compile. `cpu.rs` implements the stages for [`Flex`](burn::backend::Flex) and
//! [`NdArray`](burn::backend::NdArray), and `cube.rs` for every CubeCL runtime; `autodiff.rs` holds their backward nodes, and
//! `fusion.rs` states the output shapes and types. Users call the functions of this crate, which take tensors and check them; the
//! methods here take backend primitives of the documented shapes and one float type.

pub(crate) mod activate;
#[cfg(feature = "cube")]
pub(crate) mod adam;
pub(crate) mod argsort;
mod autodiff;
pub(crate) mod bilateral;
pub(crate) mod colour_map;
mod cpu;
#[cfg(feature = "cube")]
mod cube;
pub(crate) mod custom_grad;
pub(crate) mod depth_miss;
pub(crate) mod environment;
#[cfg(feature = "fusion")]
mod fusion;
mod host;
pub(crate) mod loss;
pub(crate) mod optics;
pub(crate) mod penalty;
pub(crate) mod pose;
pub(crate) mod smooth;
pub(crate) mod stages;
#[cfg(feature = "cube")]
pub(crate) mod tally;
pub(crate) mod tensors;

pub use activate::{ActivateBackend, Activated};
#[cfg(feature = "cube")]
pub use adam::{AdamBackend, AdamInputs, AdamState, SceneGradientTensors, SceneInputs, SceneState, SceneStates};
pub use argsort::ArgsortBackend;
pub use bilateral::BilateralBackend;
pub use colour_map::ColourMapBackend;
pub use custom_grad::CustomGradBackend;
pub use depth_miss::DepthMissBackend;
pub use environment::EnvironmentBackend;
pub use loss::{Photometric, PhotometricBackend};
pub use optics::OpticsBackend;
pub use penalty::{Penalty, PenaltyBackend};
pub use pose::PoseBackend;
pub use smooth::SmoothBackend;
pub use stages::SplatBackend;
#[cfg(feature = "cube")]
pub use tally::{TalliedTensors, TallyBackend, TallyTensors};
pub use tensors::{
    ComparedTensors, CorrectedTensors, DepthsGrads, DepthsTensors, ExposedGrads, ExposedTensors, GeometryGrads,
    GeometryTensors, InputTensor, LayerGrads, LayerTensors, MappedGrads, MappedTensors, OptionalIntTensor,
    OptionalTensor, PlaneGrads, RawTensors, RayLayerGrads, RayLayerTensors, ShadingGrads, ShadingTensors,
    SightedTensors, SkyGrads, SkyTensors, SliceGrads, SliceTensors, SmoothGrads, SmoothTensors,
};

pub use crate::activate::rule::Raw;
pub use crate::bilateral::Sliced;
pub use crate::colour_map::Mapped;
pub use crate::depth_miss::Depths;
pub use crate::environment::Sky;
pub use crate::intersect::IntersectionCell;
pub use crate::loss::taps::Compared;
pub use crate::optics::{Exposed, OpticsSpec};
pub use crate::pose::{Corrected, Sighted};
pub use crate::project::{Geometry, ProjectSpec};
pub use crate::rasterize::{Layers, PartsCell, PlaneParts, RasterizeSpec, TraceCell};
pub use crate::rasterize_rays::RayLayers;
pub use crate::sh::Shading;
pub use crate::smooth::Smooth;

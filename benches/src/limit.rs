//! The least work of each pass of a training step, and the shortest time in which a machine could do it.
//!
//! Bytes: each input is read once and each output written once, for the Gaussians that need it, in f32. Operations: each
//! addition, multiplication, division, root and comparison of the formulas in the stages' headers counts as one, a fused
//! multiply-add as two. Shared terms are computed once, and guards against overflow are not counted. `benches/README.md`
//! explains the derivation.
//!
//! The time is a limit, not a goal: divisions take longer than additions, no list is sorted in one pass, and not every lane
//! of a vector of pixels does useful work.

mod machine;
#[cfg(test)]
mod tests;

pub use machine::Machine;

use splat_op::Intrinsics;

use crate::Load;

/// Number of channels of a picture.
const CHANNELS: f64 = 3.0;

/// Number of parameters of a Gaussian without its harmonics: centre, rotation, scales, opacity.
const GEOMETRY: f64 = 3.0 + 4.0 + 3.0 + 1.0;

/// Number of columns of `project`'s output.
const PACKED: f64 = 7.0;

/// Operations of an exponential or a logarithm at f32 precision: two fused steps of range reduction, seven fused steps of a
/// polynomial, two operations of scaling.
const EXP: f64 = 2.0 * (2.0 + 7.0) + 2.0;

/// Operations of a dot product, also of a squared length, and of a cross product, with three components.
const DOT: f64 = 5.0;
const CROSS: f64 = 9.0;

/// Operations of a 3 × 3 matrix times a vector and times a matrix.
const MATVEC: f64 = 3.0 * DOT;
const MATMUL: f64 = 9.0 * DOT;

/// Operations of `stages/sh/basis.rs` by degree, each including the lower degrees.
const BASIS: [f64; 5] = [0.0, 3.0, 18.0, 43.0, 69.0];
const BASIS_BACKWARD: [f64; 5] = [0.0, 3.0, 33.0, 105.0, 183.0];

/// A pass of a training step.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum PassKind {
    Activate,
    Project,
    Sh,
    Intersect,
    Rasterize,
    Loss,
    LossBackward,
    RasterizeBackward,
    ShBackward,
    ProjectBackward,
    ActivateBackward,
    Observe,
    Guard,
    Adam,
    Step,
}

impl PassKind {
    /// The passes of a step, in order.
    pub const PARTS: [Self; 14] = [
        Self::Activate,
        Self::Project,
        Self::Sh,
        Self::Intersect,
        Self::Rasterize,
        Self::Loss,
        Self::LossBackward,
        Self::RasterizeBackward,
        Self::ShBackward,
        Self::ProjectBackward,
        Self::ActivateBackward,
        Self::Observe,
        Self::Guard,
        Self::Adam,
    ];

    /// Name in the tables.
    pub fn name(self) -> &'static str {
        match self {
            Self::Activate => "activate",
            Self::Project => "project",
            Self::Sh => "sh",
            Self::Intersect => "intersect",
            Self::Rasterize => "rasterize",
            Self::Loss => "loss with derivative",
            Self::LossBackward => "loss backward",
            Self::RasterizeBackward => "rasterize backward",
            Self::ShBackward => "sh backward",
            Self::ProjectBackward => "project backward",
            Self::ActivateBackward => "activate backward",
            Self::Observe => "density statistics",
            Self::Guard => "finiteness check",
            Self::Adam => "Adam",
            Self::Step => "training step",
        }
    }
}

/// Sizes that determine the work of a pass.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sizes {
    /// Number of Gaussians, N.
    pub splats: f64,
    /// Number of visible Gaussians, V.
    pub visible: f64,
    /// Number of pixels, P.
    pub pixels: f64,
    /// Number of intersections, pairs of a tile and a Gaussian, H.
    pub intersections: f64,
    /// Number of contributions, pairs of a pixel and a Gaussian that contributes to it, K.
    pub contributions: f64,
    /// SH degree, 0 to 4.
    pub degree: usize,
}

/// Least work of a pass.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LeastWork {
    pub bytes: f64,
    pub operations: f64,
}

impl LeastWork {
    /// Returns the limit in seconds: the longer of the times for memory and arithmetic, each at its measured rate. Without a
    /// measured arithmetic rate, only the bandwidth counts.
    pub fn seconds(&self, machine: &Machine) -> f64 {
        let computing = machine.operations.map_or(0.0, |rate| self.operations / rate);
        (self.bytes / machine.bandwidth).max(computing)
    }
}

impl Sizes {
    /// Creates the sizes of a view from its counted load.
    pub fn new(load: &Load, intrinsics: &Intrinsics, degree: usize) -> Self {
        let pixels = (intrinsics.width * intrinsics.height) as f64;
        Self {
            splats: load.splats as f64,
            visible: load.visible as f64,
            pixels,
            intersections: load.intersections as f64,
            contributions: load.layers * pixels,
            degree,
        }
    }

    /// Number of SH coefficients per Gaussian, over all channels.
    fn harmonics(&self) -> f64 {
        CHANNELS * ((self.degree + 1) * (self.degree + 1)) as f64
    }

    /// Returns the least work of a pass. The work of a step is the sum over its parts.
    pub fn work(&self, kind: PassKind) -> LeastWork {
        if kind == PassKind::Step {
            return PassKind::PARTS.into_iter().map(|part| self.work(part)).fold(LeastWork::default(), |sum, part| {
                LeastWork { bytes: sum.bytes + part.bytes, operations: sum.operations + part.operations }
            });
        }
        LeastWork { bytes: size_of::<f32>() as f64 * self.floats(kind), operations: self.operations(kind) }
    }

    /// Returns the limit of a pass in seconds. The limit of a step is the sum over its parts, each bound by memory or by
    /// arithmetic.
    pub fn limit(&self, kind: PassKind, machine: &Machine) -> f64 {
        match kind {
            PassKind::Step => PassKind::PARTS.into_iter().map(|part| self.work(part).seconds(machine)).sum(),
            part => self.work(part).seconds(machine),
        }
    }

    /// Returns the number of f32 values read and written.
    fn floats(&self, kind: PassKind) -> f64 {
        let Self { splats, visible, pixels, intersections, .. } = *self;
        let (harmonics, picture) = (self.harmonics(), CHANNELS * pixels);
        // The centre is enough to tell that a Gaussian is not visible.
        let centres = 3.0 * (splats - visible);
        // The ellipse and colour of each visible Gaussian, and the index of each intersection.
        let blended = (PACKED + CHANNELS) * visible + intersections;
        let planes = (CHANNELS + 1.0) * pixels;
        match kind {
            // Scales and opacity, read and written.
            PassKind::Activate => 2.0 * 4.0 * splats,
            PassKind::Project => centres + (GEOMETRY + PACKED) * visible,
            PassKind::Sh => (harmonics + 3.0 + CHANNELS) * visible,
            PassKind::Intersect => PACKED * visible + intersections,
            PassKind::Rasterize => blended + planes,
            // Picture, photograph and derivative.
            PassKind::Loss => 3.0 * picture,
            // The derivative is read, scaled by the incoming gradient and written.
            PassKind::LossBackward => 2.0 * picture,
            PassKind::RasterizeBackward => blended + planes + (PACKED + CHANNELS) * visible,
            PassKind::ShBackward => (CHANNELS + 2.0 * (harmonics + 3.0)) * visible,
            PassKind::ProjectBackward => (PACKED + 2.0 * GEOMETRY) * visible,
            // Gradients read and written, and the slopes, which are functions of the outputs.
            PassKind::ActivateBackward => 3.0 * 4.0 * visible,
            // The gradient of the centre, and two sums, read and written.
            PassKind::Observe => (2.0 + 4.0) * visible,
            PassKind::Guard => (GEOMETRY + harmonics) * visible,
            // Parameters and two moments, read and written: the moments of an invisible Gaussian decay and move it.
            PassKind::Adam => (GEOMETRY + harmonics) * (6.0 * splats + visible),
            PassKind::Step => unreachable!("a sum of the others"),
        }
    }

    fn operations(&self, kind: PassKind) -> f64 {
        let Self { splats, visible, pixels, intersections, contributions, degree, .. } = *self;
        let harmonics = self.harmonics();
        match kind {
            // Three exponentials, and the logistic function: an exponential, a sum and a division.
            PassKind::Activate => (3.0 * EXP + EXP + 2.0) * splats,
            // The transform to the camera frame for all Gaussians, the rest for visible ones.
            PassKind::Project => (MATVEC + 3.0) * splats + (PROJECT - MATVEC - 3.0) * visible,
            PassKind::Sh => (DIRECTION + BASIS[degree] + 2.0 * harmonics + CHANNELS) * visible,
            // The comparisons of a sort, a bounding box, and one test of an ellipse against a rectangle per intersection.
            PassKind::Intersect => (visible.max(2.0).log2() + BOX) * visible + RECTANGLE * intersections,
            PassKind::Rasterize => (LAYER + 2.0 * CHANNELS + 1.0) * contributions,
            PassKind::Loss => LOSS * CHANNELS * pixels,
            PassKind::LossBackward => CHANNELS * pixels,
            PassKind::RasterizeBackward => LAYER_BACKWARD * contributions + ELLIPSE_BACKWARD * visible,
            PassKind::ShBackward => {
                // The colours again, for clamped channels, their harmonics, and the direction if the degree is above 0.
                let colours = DIRECTION + BASIS[degree] + 2.0 * harmonics;
                let direction = if degree == 0 {
                    0.0
                } else {
                    DOT / CHANNELS * harmonics + BASIS_BACKWARD[degree] + DOT + 6.0 + 3.0
                };
                (colours + harmonics + direction) * visible
            }
            PassKind::ProjectBackward => PROJECT_BACKWARD * visible,
            // The derivative of an exponential is the exponential, and that of the logistic function takes two operations.
            PassKind::ActivateBackward => (4.0 + 2.0) * visible,
            // Two scaled components, squared and added, a root, a comparison and two sums.
            PassKind::Observe => (2.0 + 3.0 + 1.0 + 1.0 + 2.0) * visible,
            PassKind::Guard => (GEOMETRY + harmonics) * visible,
            // Both moments decay and grow, then a root, a sum, a division, a product and a difference.
            PassKind::Adam => (GEOMETRY + harmonics) * (2.0 + 3.0 + 5.0) * splats,
            PassKind::Step => unreachable!("a sum of the others"),
        }
    }
}

/// Operations of `stages/project/mod.rs`: centre to the camera frame; slopes; unit quaternion (length, root, four divisions) and its
/// matrix (nine products, nine sums, nine doublings, three differences); axes to the camera frame; two rows of the Jacobian's
/// product (lean, scale), times the scales; `sigma_u`; `n`, `m1/sigma_u`; `n × m1` and its square; `sigma_v`; shear; the centre
/// in px.
const PROJECT: f64 = (MATVEC + 3.0)
    + 2.0
    + (7.0 + 1.0 + 4.0)
    + (9.0 + 9.0 + 9.0 + 3.0)
    + MATMUL
    + 2.0 * (3.0 + 3.0 + 1.0 + 3.0)
    + 2.0 * 3.0
    + (DOT + 1.0 + 1.0)
    + (1.0 + 3.0 + 3.0)
    + (CROSS + DOT)
    + (DOT + 1.0 + 2.0 + 1.0)
    + DOT
    + 4.0;

/// Operations of `project` backward: `project` again except the centre; the gradient through the factor (`∂along`, `∂p`, `∂n`,
/// `∂sigma_u`, `∂m0`, `∂m1`); for both axes the scales, the Jacobian, the slope and the centre in the camera frame; the rotation
/// and the centre in the world frame; the quaternion through its matrix and its length.
const PROJECT_BACKWARD: f64 = (PROJECT - 4.0)
    + (3.0 + 1.0 + 3.0 + 7.0)
    + (3.0 + CROSS + 3.0)
    + (1.0 + 2.0 * DOT + 3.0)
    + (3.0 + 3.0 + 3.0)
    + (CROSS + 3.0 + 3.0)
    + (1.0 + 2.0 * (1.0 + 6.0 + 3.0 + 3.0 + 6.0 + (DOT + 2.0) + 1.0 + (DOT + 1.0) + 1.0 + 3.0))
    + 3.0 * MATVEC
    + MATVEC
    + (6.0 + 6.0 + 3.0 * 10.0 + 7.0 + 12.0);

/// Operations of the unit vector from the camera to a centre.
const DIRECTION: f64 = 3.0 + DOT + 1.0 + 1.0 + 3.0;

/// Operations of a Gaussian's extent: a logarithm and its factors, a root, the half extents, and four borders in tiles.
const BOX: f64 = EXP + 3.0 + 1.0 + (1.0 + 3.0 + 1.0 + 2.0) + 4.0 * 2.0;

/// Operations of the least `u² + v²` over a tile: the tile's sides, the nearest point on them, and `u² + v²` there.
const RECTANGLE: f64 = 4.0 + 4.0 + 7.0 + 1.0;

/// Operations of a Gaussian at a pixel: the offset (dy once per row, not counted), `u`, `v`, the exponent, alpha, its two bounds,
/// the transmittance behind the Gaussian and its bound.
const LAYER: f64 = 1.0 + 1.0 + (2.0 + 1.0) + (1.0 + 2.0 + 1.0) + (EXP + 1.0) + 2.0 + 2.0 + 1.0;

/// Operations of a layer backward: the layer again; `g·c`; `∂α = g·c − ρ`, `ρ`; the weight and `h`; `h u, h v`; six moments; the
/// gradient of the colours.
const LAYER_BACKWARD: f64 = LAYER + 2.0 * CHANNELS + 1.0 + 2.0 + 2.0 + 2.0 + (3.0 + 3.0 * 2.0) + 2.0 * CHANNELS;

/// Operations from six moments to the gradient of the ellipse, see `stages/rasterize/cpu.rs`.
const ELLIPSE_BACKWARD: f64 = 1.0 + 3.0 + 1.0 + 2.0 + 1.0 + 1.0;

/// Operations of a symmetric window of 11 taps along one axis: six products, ten sums.
const WINDOW: f64 = 6.0 + 10.0;

/// Operations of the loss for one channel of a pixel: `x², xy`; three windowed maps, each along both axes; the index and its three
/// derivatives; the windows of the derivatives and their sum; the absolute difference, its sign and share.
const LOSS: f64 = 2.0 + 3.0 * 2.0 * WINDOW + (12.0 + 10.0) + 3.0 * 2.0 * WINDOW + 4.0 + 4.0;

//! The least work of each pass of a training step, and the time in which a machine could do it.
//!
//! Bytes: each input read once, each output written once, of the Gaussians that need it, in f32. Operations: additions,
//! multiplications, divisions, roots and comparisons of the formulas in the stages' headers, one each, a fused multiply-add
//! two; what they share is computed once, and guards against overflow are left out. What is derived here stands in words in
//! `benches/README.md`.
//!
//! It is a limit, not a goal: divisions take longer than additions, no list is sorted in one pass, and not every lane of a
//! vector of pixels is of use.

mod machine;
#[cfg(test)]
mod tests;

pub use machine::Machine;

use splat_op::Intrinsics;

use crate::Load;

/// Channels of a picture.
const CHANNELS: f64 = 3.0;

/// Parameters of a Gaussian without its harmonics: centre, rotation, scales, opacity.
const GEOMETRY: f64 = 3.0 + 4.0 + 3.0 + 1.0;

/// Columns of `project`'s output.
const PACKED: f64 = 7.0;

/// An exponential or a logarithm to f32's precision: two fused steps to reduce the range, seven of a polynomial, two
/// operations to scale.
const EXP: f64 = 2.0 * (2.0 + 7.0) + 2.0;

/// A dot product, the length's square, and a cross product of three components.
const DOT: f64 = 5.0;
const CROSS: f64 = 9.0;

/// A matrix times a vector, a matrix times a matrix, 3 × 3.
const MATVEC: f64 = 3.0 * DOT;
const MATMUL: f64 = 9.0 * DOT;

/// `shade/basis.rs`, by degree, each with the degrees below it.
const BASIS: [f64; 5] = [0.0, 3.0, 18.0, 43.0, 69.0];
const BASIS_BACKWARD: [f64; 5] = [0.0, 3.0, 33.0, 105.0, 183.0];

/// A pass of a training step.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Kind {
    Activate,
    Project,
    Shade,
    Tile,
    Blend,
    Loss,
    LossBackward,
    BlendBackward,
    ShadeBackward,
    ProjectBackward,
    ActivateBackward,
    Observe,
    Guard,
    Adam,
    Step,
}

impl Kind {
    /// The passes of a step, in order.
    pub const PARTS: [Self; 14] = [
        Self::Activate,
        Self::Project,
        Self::Shade,
        Self::Tile,
        Self::Blend,
        Self::Loss,
        Self::LossBackward,
        Self::BlendBackward,
        Self::ShadeBackward,
        Self::ProjectBackward,
        Self::ActivateBackward,
        Self::Observe,
        Self::Guard,
        Self::Adam,
    ];

    /// As the tables have it.
    pub fn name(self) -> &'static str {
        match self {
            Self::Activate => "activate",
            Self::Project => "project",
            Self::Shade => "shade",
            Self::Tile => "tile",
            Self::Blend => "blend",
            Self::Loss => "loss with derivative",
            Self::LossBackward => "loss backward",
            Self::BlendBackward => "blend backward",
            Self::ShadeBackward => "shade backward",
            Self::ProjectBackward => "project backward",
            Self::ActivateBackward => "activate backward",
            Self::Observe => "density control looks",
            Self::Guard => "guard looks",
            Self::Adam => "Adam",
            Self::Step => "training step",
        }
    }
}

/// What a pass is asked to do.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sizes {
    /// Gaussians, N.
    pub splats: f64,
    /// Those that show, V.
    pub visible: f64,
    /// Pixels, P.
    pub pixels: f64,
    /// Pairs of a tile and a Gaussian, H.
    pub hits: f64,
    /// Pairs of a pixel and a Gaussian that contributes to it, K.
    pub contributions: f64,
    /// Degree of the harmonics, 0 to 4.
    pub degree: usize,
}

/// Least work.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Work {
    pub bytes: f64,
    pub operations: f64,
}

impl Work {
    /// Seconds: the longer of moving and computing, each at its measured rate. A device whose arithmetic was not measured is
    /// held to its bandwidth alone.
    pub fn seconds(&self, machine: &Machine) -> f64 {
        let computing = machine.operations.map_or(0.0, |rate| self.operations / rate);
        (self.bytes / machine.bandwidth).max(computing)
    }
}

impl Sizes {
    /// Sizes of a view, by its counted load.
    pub fn new(load: &Load, intrinsics: &Intrinsics, degree: usize) -> Self {
        let pixels = (intrinsics.width * intrinsics.height) as f64;
        Self {
            splats: load.splats as f64,
            visible: load.visible as f64,
            pixels,
            hits: load.hits as f64,
            contributions: load.layers * pixels,
            degree,
        }
    }

    /// Harmonics per Gaussian, of all channels.
    fn harmonics(&self) -> f64 {
        CHANNELS * ((self.degree + 1) * (self.degree + 1)) as f64
    }

    /// Least work of a pass. That of a step is the sum of its parts.
    pub fn work(&self, kind: Kind) -> Work {
        if kind == Kind::Step {
            return Kind::PARTS.into_iter().map(|part| self.work(part)).fold(Work::default(), |sum, part| Work {
                bytes: sum.bytes + part.bytes,
                operations: sum.operations + part.operations,
            });
        }
        Work { bytes: size_of::<f32>() as f64 * self.floats(kind), operations: self.operations(kind) }
    }

    /// Seconds: for a step the sum over its parts, each of which is bound by memory or by arithmetic.
    pub fn limit(&self, kind: Kind, machine: &Machine) -> f64 {
        match kind {
            Kind::Step => Kind::PARTS.into_iter().map(|part| self.work(part).seconds(machine)).sum(),
            part => self.work(part).seconds(machine),
        }
    }

    /// Numbers of four bytes that are read and written.
    fn floats(&self, kind: Kind) -> f64 {
        let Self { splats, visible, pixels, hits, .. } = *self;
        let (harmonics, picture) = (self.harmonics(), CHANNELS * pixels);
        // Where a Gaussian does not show its centre says so.
        let centres = 3.0 * (splats - visible);
        // Of a blended Gaussian the ellipse and the colour; per hit its number.
        let blended = (PACKED + CHANNELS) * visible + hits;
        let planes = (CHANNELS + 1.0) * pixels;
        match kind {
            // Scales and opacity, there and back.
            Kind::Activate => 2.0 * 4.0 * splats,
            Kind::Project => centres + (GEOMETRY + PACKED) * visible,
            Kind::Shade => (harmonics + 3.0 + CHANNELS) * visible,
            Kind::Tile => PACKED * visible + hits,
            Kind::Blend => blended + planes,
            // Picture, photograph, derivative.
            Kind::Loss => 3.0 * picture,
            // The derivative, scaled by the gradient that arrives.
            Kind::LossBackward => 2.0 * picture,
            Kind::BlendBackward => blended + planes + (PACKED + CHANNELS) * visible,
            Kind::ShadeBackward => (CHANNELS + 2.0 * (harmonics + 3.0)) * visible,
            Kind::ProjectBackward => (PACKED + 2.0 * GEOMETRY) * visible,
            // Gradients there and back, and the slopes, which are functions of the outputs.
            Kind::ActivateBackward => 3.0 * 4.0 * visible,
            // The gradient at the centre; two sums, there and back.
            Kind::Observe => (2.0 + 4.0) * visible,
            Kind::Guard => (GEOMETRY + harmonics) * visible,
            // Parameters and two moments, there and back: those of a Gaussian that does not show decay and move it.
            Kind::Adam => (GEOMETRY + harmonics) * (6.0 * splats + visible),
            Kind::Step => unreachable!("a sum of the others"),
        }
    }

    fn operations(&self, kind: Kind) -> f64 {
        let Self { splats, visible, pixels, hits, contributions, degree, .. } = *self;
        let harmonics = self.harmonics();
        match kind {
            // Three exponentials; the logistic function is one, a sum and a division.
            Kind::Activate => (3.0 * EXP + EXP + 2.0) * splats,
            // To the camera's frame, to tell what is in front of it; the rest where something shows.
            Kind::Project => (MATVEC + 3.0) * splats + (PROJECT - MATVEC - 3.0) * visible,
            Kind::Shade => (DIRECTION + BASIS[degree] + 2.0 * harmonics + CHANNELS) * visible,
            // As many comparisons as a sort takes, a bounding box, and one test of an ellipse against a rectangle per hit.
            Kind::Tile => (visible.max(2.0).log2() + BOX) * visible + RECTANGLE * hits,
            Kind::Blend => (LAYER + 2.0 * CHANNELS + 1.0) * contributions,
            Kind::Loss => LOSS * CHANNELS * pixels,
            Kind::LossBackward => CHANNELS * pixels,
            Kind::BlendBackward => LAYER_BACKWARD * contributions + ELLIPSE_BACKWARD * visible,
            Kind::ShadeBackward => {
                // The colours again, for what is held at zero; their harmonics; the direction, where there is any use of it.
                let colours = DIRECTION + BASIS[degree] + 2.0 * harmonics;
                let direction = if degree == 0 {
                    0.0
                } else {
                    DOT / CHANNELS * harmonics + BASIS_BACKWARD[degree] + DOT + 6.0 + 3.0
                };
                (colours + harmonics + direction) * visible
            }
            Kind::ProjectBackward => PROJECT_BACKWARD * visible,
            // The slopes of exponentials are themselves, that of the logistic function takes two operations.
            Kind::ActivateBackward => (4.0 + 2.0) * visible,
            // Two scaled components, squared and added; the root; a comparison; two sums.
            Kind::Observe => (2.0 + 3.0 + 1.0 + 1.0 + 2.0) * visible,
            Kind::Guard => (GEOMETRY + harmonics) * visible,
            // Both moments decay and grow; a root, a sum, a division, a product, a difference.
            Kind::Adam => (GEOMETRY + harmonics) * (2.0 + 3.0 + 5.0) * splats,
            Kind::Step => unreachable!("a sum of the others"),
        }
    }
}

/// `project/mod.rs`: into the camera's frame; slopes; unit quaternion (length, root, four divisions) and its matrix (nine
/// products, nine sums, nine doublings, three differences); into the camera's frame; two rows of the Jacobian's product (lean,
/// scale), times the scales; `sigma_u`; `n`, `m1/sigma_u`; `n × m1` and its square; `sigma_v`; shear; the centre in px.
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

/// `project` again but for the centre; through the factor (`∂along`, `∂p`, `∂n`, `∂sigma_u`, `∂m0`, `∂m1`); for both axes
/// the scales, the Jacobian, the slope and the centre in the camera's frame; the rotation in the world's frame, the centre in
/// the world's frame, and the quaternion through its matrix and its length.
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

/// The unit vector from the camera to a centre.
const DIRECTION: f64 = 3.0 + DOT + 1.0 + 1.0 + 3.0;

/// How far a Gaussian reaches: a logarithm and its factors, a root, the half extents, and four borders in tiles.
const BOX: f64 = EXP + 3.0 + 1.0 + (1.0 + 3.0 + 1.0 + 2.0) + 4.0 * 2.0;

/// The least `u² + v²` over a tile: the tile's sides, the nearest place on them, and `u² + v²` there.
const RECTANGLE: f64 = 4.0 + 4.0 + 7.0 + 1.0;

/// A Gaussian at a pixel: the offset (dy once per row, not counted), `u`, `v`, the exponent, alpha, its two bounds, the
/// transmittance behind it and its bound.
const LAYER: f64 = 1.0 + 1.0 + (2.0 + 1.0) + (1.0 + 2.0 + 1.0) + (EXP + 1.0) + 2.0 + 2.0 + 1.0;

/// The layer again; `g·c`; `∂α = g·c − ρ`, `ρ`; the weight and `h`; `h u, h v`; six moments; the colours' gradient.
const LAYER_BACKWARD: f64 = LAYER + 2.0 * CHANNELS + 1.0 + 2.0 + 2.0 + 2.0 + (3.0 + 3.0 * 2.0) + 2.0 * CHANNELS;

/// From six moments to the ellipse, see `blend/cpu.rs`.
const ELLIPSE_BACKWARD: f64 = 1.0 + 3.0 + 1.0 + 2.0 + 1.0 + 1.0;

/// A symmetric window of 11 taps along one axis: six products, ten sums.
const WINDOW: f64 = 6.0 + 10.0;

/// One channel of a pixel: `x², xy`; three windowed maps, along both axes each; the index and its three derivatives; these
/// windowed and added; the absolute difference, its sign and share.
const LOSS: f64 = 2.0 + 3.0 * 2.0 * WINDOW + (12.0 + 10.0) + 3.0 * 2.0 * WINDOW + 4.0 + 4.0;

//! The tally as an extension of Burn's GPU backend. Not differentiable.

use burn::backend::tensor::FloatTensor;
use burn::backend::{Backend, ExtensionType, TensorMetadata, backend_extension};
use burn::tensor::DType;
use burn_cubecl::CubeBackend;

use super::cube::{buffer, owned, tensor};
#[cfg(feature = "fusion")]
use super::fusion::float;
use crate::gpu::{Buffer, Gpu};
use crate::tally::launch::launch_tally;

/// A tally before a step.
#[derive(Clone, Debug, ExtensionType)]
#[extension_type(fusion: cfg(feature = "fusion"))]
pub enum TallyTensors<B: Backend> {
    /// No step has been added.
    Empty,
    /// Sums of norms and numbers of steps, `[N]` each.
    Begun {
        /// Sums of norms.
        sums: FloatTensor<B>,
        /// Numbers of steps with a gradient.
        counts: FloatTensor<B>,
    },
}

/// A tally after a step.
#[derive(Clone, Debug, ExtensionType)]
#[extension_type(fusion: cfg(feature = "fusion"))]
pub struct TalliedTensors<B: Backend> {
    /// `[N]`: sums of norms.
    pub sums: FloatTensor<B>,
    /// `[N]`: numbers of steps with a gradient.
    pub counts: FloatTensor<B>,
}

/// The tally, on GPU backends only; see `tally/`.
#[backend_extension(Cube, Fusion: cfg(feature = "fusion"))]
pub trait TallyBackend: Backend {
    /// Adds the gradients of one step, `[N, 2]`.
    #[fusion(meta = tally_meta)]
    fn tally(
        #[extension_type] before: TallyTensors<Self>,
        grad: FloatTensor<Self>,
        per_axis: [f32; 2],
    ) -> TalliedTensors<Self>;
}

#[cfg(feature = "fusion")]
fn tally_meta(
    _: &TallyTensorsMetadata,
    grad: &burn::backend::fusion::custom::TensorSpec,
    _: &[f32; 2],
) -> TalliedTensorsMetadata {
    let rows = || float([grad.shape[0]], grad);
    TalliedTensorsMetadata { sums: rows(), counts: rows() }
}

impl TallyBackend for CubeBackend {
    fn tally(before: TallyTensors<Self>, grad: FloatTensor<Self>, per_axis: [f32; 2]) -> TalliedTensors<Self> {
        let gpu = Gpu::new(&grad.client);
        let count = grad.shape()[0];
        let (begins, [sums, counts]) = match before {
            TallyTensors::Begun { sums, counts } => (false, [sums, counts].map(owned)),
            TallyTensors::Empty => {
                (true, [(); 2].map(|()| tensor(Buffer::<f32>::new(&gpu, count), [count], DType::F32, &grad)))
            }
        };
        launch_tally(&gpu, &buffer(grad), &buffer(sums.clone()), &buffer(counts.clone()), per_axis, begins);
        TalliedTensors { sums, counts }
    }
}

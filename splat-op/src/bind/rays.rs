//! `tilt` and `rays` on Burn's backends.

#![allow(deprecated, reason = "burn-ndarray is deprecated in favour of burn-flex; this project supports both")]

use burn::backend::tensor::{FloatTensor, IntTensor};
use burn::backend::{Backend, Flex, NdArray, TensorMetadata, backend_extension};

use super::cpu::{ProjectHost, hit_lists_by, project_grads, slot};
#[cfg(feature = "fusion")]
use super::fusion;
use super::host::{Host, HostBackend, by_type};
use crate::blend::{BlendSpec, PartsCell};
use crate::project::{COLUMNS, ProjectGrads, ProjectInputs, ProjectNeeds, ProjectSpec};
use crate::rays::{self, RaysGrads, RaysInputs, RaysNeeds};
use crate::real::Real;
use crate::tile::cpu::tile_cpu;
use crate::tile::{Cut, HitCell};
use crate::tilt::cpu::{tilt_backward_cpu, tilt_cpu};
use crate::tilt::{TILT, outline_cpu};

/// The stages of renders whose pixels look along their rays. No method has a default body: a backend that lacks one does not
/// compile.
#[backend_extension(Cube: cfg(feature = "cube"), Flex, NdArray, Autodiff, Fusion: cfg(feature = "fusion"))]
pub trait RaysBackend: Backend {
    /// See `tilt/`. Returns `[N, 3]`.
    #[fusion(meta = fusion::tilt)]
    fn tilt(#[extension_type] inputs: ProjectInputs<Self>, spec: ProjectSpec) -> FloatTensor<Self>;

    /// Gradients of `tilt` from that of its output. Opacities and projected centres have none to ask for.
    #[fusion(meta = fusion::tilt_backward)]
    fn tilt_backward(
        #[extension_type] inputs: ProjectInputs<Self>,
        grad: FloatTensor<Self>,
        spec: ProjectSpec,
        needs: ProjectNeeds,
    ) -> ProjectGrads<Self>;

    /// See `tilt/`. Rows `[N, 7]` for `tile`, from packed ellipses `[N, 7]` and tilts `[N, 3]`. Not differentiable.
    #[fusion(dtype = projected, shape = projected)]
    fn outline(projected: FloatTensor<Self>, tilt: FloatTensor<Self>, spec: BlendSpec) -> FloatTensor<Self>;

    /// See `rays/`. Returns planes as `blend` does; `mean2d_abs_probe`, `tile_counts` and `parts` as there.
    #[fusion(meta = fusion::rays)]
    fn rays(
        #[extension_type] inputs: RaysInputs<Self>,
        mean2d_abs_probe: FloatTensor<Self>,
        tile_counts: IntTensor<Self>,
        spec: BlendSpec,
        hits: HitCell,
        parts: PartsCell,
    ) -> FloatTensor<Self>;

    /// Gradients of `rays` from that of all its planes. `planes` is what `rays` returned, and orders the two; not read.
    #[fusion(meta = fusion::rays_backward)]
    fn rays_backward(
        #[extension_type] inputs: RaysInputs<Self>,
        planes: FloatTensor<Self>,
        grad: FloatTensor<Self>,
        spec: BlendSpec,
        needs: RaysNeeds,
        hits: HitCell,
    ) -> RaysGrads<Self>;
}

struct RaysHost<F: Real>([Host<F>; 4]);

impl<F: Real> RaysHost<F> {
    fn read<B: HostBackend>(inputs: &RaysInputs<B>) -> Self {
        let RaysInputs { projected, tilt, features, background } = inputs;
        Self([projected, tilt, features, background].map(|tensor| B::host(tensor.clone())))
    }

    fn inputs(&self) -> rays::cpu::Inputs<'_, F> {
        let [projected, tilt, features, background] = &self.0;
        rays::cpu::Inputs { projected, tilt, features, background }
    }
}

/// The lists in the cell, computed now if nobody has yet.
fn lists<'a, F: Real>(hits: &'a HitCell, inputs: rays::cpu::Inputs<F>, spec: &BlendSpec) -> &'a crate::tile::HitLists {
    hit_lists_by(hits, || {
        let rows = |packed: &[F]| tile_cpu(packed, &spec.intrinsics, Cut::of(&spec.options));
        match spec.options.reaches_by_outline() {
            true => rows(&outline_cpu(inputs.projected, inputs.tilt, spec)),
            false => rows(inputs.projected),
        }
    })
}

fn rays<B: HostBackend, F: Real>(inputs: RaysInputs<B>, spec: &BlendSpec, hits: &HitCell) -> FloatTensor<B> {
    let host = RaysHost::<F>::read(&inputs);
    let planes = rays::cpu::rays_cpu(host.inputs(), spec, lists(hits, host.inputs(), spec));
    let count = spec.planes(host.inputs().background.len());
    B::from_host(planes, &[count, spec.intrinsics.height, spec.intrinsics.width], &inputs.projected)
}

fn rays_backward<B: HostBackend, F: Real>(
    inputs: RaysInputs<B>,
    grad: FloatTensor<B>,
    spec: &BlendSpec,
    needs: RaysNeeds,
    hits: &HitCell,
) -> RaysGrads<B> {
    let host = RaysHost::<F>::read(&inputs);
    let lists = lists(hits, host.inputs(), spec);
    let g = rays::cpu::rays_backward_cpu(host.inputs(), &B::host(grad), spec, lists, needs);
    let (channels, like) = (host.inputs().background.len(), &inputs.projected);
    let count = host.inputs().projected.len() / COLUMNS;
    RaysGrads {
        projected: slot(needs.projected, g.projected, &[count, COLUMNS], like),
        tilt: slot(needs.tilt, g.tilt, &[count, TILT], like),
        features: slot(needs.features, g.features, &[count, channels], like),
        background: slot(needs.background, g.background, &[channels], like),
        mean2d_abs: slot(needs.mean2d_abs, g.mean2d_abs, &[count, 2], like),
    }
}

macro_rules! cpu_backend {
    ($backend:ty) => {
        impl RaysBackend for $backend {
            fn tilt(inputs: ProjectInputs<Self>, spec: ProjectSpec) -> FloatTensor<Self> {
                by_type!(inputs.means, F => {
                    let tilts = tilt_cpu(ProjectHost::<F>::read(&inputs).inputs(), &spec);
                    let count = tilts.len() / TILT;
                    Self::from_host(tilts, &[count, TILT], &inputs.means)
                })
            }

            fn tilt_backward(
                inputs: ProjectInputs<Self>,
                grad: FloatTensor<Self>,
                spec: ProjectSpec,
                needs: ProjectNeeds,
            ) -> ProjectGrads<Self> {
                by_type!(inputs.means, F => {
                    let host = ProjectHost::<F>::read(&inputs);
                    let g = tilt_backward_cpu(host.inputs(), &Self::host(grad), &spec, needs);
                    project_grads(g, needs, host.inputs().opacities.len(), &inputs.means)
                })
            }

            fn outline(projected: FloatTensor<Self>, tilt: FloatTensor<Self>, spec: BlendSpec) -> FloatTensor<Self> {
                by_type!(projected, F => {
                    let like = projected.clone();
                    let rows = outline_cpu::<F>(&Self::host(projected), &Self::host(tilt), &spec);
                    let count = rows.len() / COLUMNS;
                    Self::from_host(rows, &[count, COLUMNS], &like)
                })
            }

            fn rays(
                inputs: RaysInputs<Self>,
                _: FloatTensor<Self>,
                _: IntTensor<Self>,
                spec: BlendSpec,
                hits: HitCell,
                _: PartsCell,
            ) -> FloatTensor<Self> {
                by_type!(inputs.projected, F => rays::<Self, F>(inputs, &spec, &hits))
            }

            fn rays_backward(
                inputs: RaysInputs<Self>,
                _: FloatTensor<Self>,
                grad: FloatTensor<Self>,
                spec: BlendSpec,
                needs: RaysNeeds,
                hits: HitCell,
            ) -> RaysGrads<Self> {
                by_type!(inputs.projected, F => rays_backward::<Self, F>(inputs, grad, &spec, needs, &hits))
            }
        }
    };
}

cpu_backend!(Flex);
cpu_backend!(NdArray);

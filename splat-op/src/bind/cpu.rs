//! The stages on Burn's CPU backends: each method reads its tensors, picks the float type and calls the twin.

#![allow(deprecated, reason = "burn-ndarray is deprecated in favour of burn-flex; this project supports both")]

use burn::backend::ops::FloatTensorOps;
use burn::backend::tensor::{FloatTensor, IntTensor};
use burn::backend::{Flex, NdArray, TensorMetadata};
use burn::tensor::{Shape, Slice, TensorData};

use super::host::{Host, HostBackend, HostCoefficients, by_type};
use crate::blend::{self, BlendGrads, BlendInputs, BlendNeeds, BlendSpec, PartsCell, TraceCell};
use crate::op::{Slot, SplatBackend};
use crate::project::{self, COLUMNS, ProjectGrads, ProjectInputs, ProjectNeeds, ProjectSpec};
use crate::real::Real;
use crate::shade::cpu::Visible;
use crate::shade::{self, ShadeGrads, ShadeInputs, ShadeNeeds};
use crate::tile::cpu::tile_cpu;
use crate::tile::{Cut, HitCell, HitLists, Lists, tile_grid};

/// A gradient as a tensor of the given shape, or nothing if it was not needed.
pub(super) fn slot<B: HostBackend, F: Real>(
    needed: bool,
    elements: Vec<F>,
    shape: &[usize],
    like: &FloatTensor<B>,
) -> Slot<B> {
    if needed { Slot::Have(B::from_host(elements, shape, like)) } else { Slot::Skip }
}

pub(super) struct ProjectHost<F: Real>([Host<F>; 5]);

impl<F: Real> ProjectHost<F> {
    pub fn read<B: HostBackend>(inputs: &ProjectInputs<B>) -> Self {
        let ProjectInputs { means, rotations, scales, opacities, cam_from_world } = inputs;
        Self([means, rotations, scales, opacities, cam_from_world].map(|tensor| B::host(tensor.clone())))
    }

    pub fn inputs(&self) -> project::cpu::Inputs<'_, F> {
        let [means, rotations, scales, opacities, cam_from_world] = &self.0;
        project::cpu::Inputs { means, rotations, scales, opacities, cam_from_world }
    }
}

fn project<B: HostBackend, F: Real>(inputs: ProjectInputs<B>, spec: &ProjectSpec) -> FloatTensor<B> {
    let host = ProjectHost::<F>::read(&inputs);
    let packed = project::cpu::project_cpu(host.inputs(), spec);
    let count = packed.len() / COLUMNS;
    B::from_host(packed, &[count, COLUMNS], &inputs.means)
}

fn project_backward<B: HostBackend, F: Real>(
    inputs: ProjectInputs<B>,
    grad: FloatTensor<B>,
    spec: &ProjectSpec,
    needs: ProjectNeeds,
) -> ProjectGrads<B> {
    let host = ProjectHost::<F>::read(&inputs);
    let g = project::cpu::project_backward_cpu(host.inputs(), &B::host(grad), spec, needs);
    project_grads(g, needs, host.inputs().opacities.len(), &inputs.means)
}

/// The gradients of `count` Gaussians as tensors.
pub(super) fn project_grads<B: HostBackend, F: Real>(
    g: project::cpu::Grads<F>,
    needs: ProjectNeeds,
    count: usize,
    like: &FloatTensor<B>,
) -> ProjectGrads<B> {
    ProjectGrads {
        means: slot(needs.means, g.means, &[count, 3], like),
        rotations: slot(needs.rotations, g.rotations, &[count, 4], like),
        scales: slot(needs.scales, g.scales, &[count, 3], like),
        opacities: slot(needs.opacities, g.opacities, &[count], like),
        cam_from_world: slot(needs.cam_from_world, g.cam_from_world, &[3, 4], like),
        mean2d: slot(needs.mean2d, g.mean2d, &[count, 2], like),
    }
}

struct ShadeHost<F: Real> {
    sh: HostCoefficients<F>,
    tensors: [Host<F>; 2],
    coefficients: usize,
}

impl<F: Real> ShadeHost<F> {
    fn read<B: HostBackend>(inputs: &ShadeInputs<B>) -> Self {
        let ShadeInputs { sh, means, cam_from_world } = inputs;
        Self {
            sh: B::host_coefficients(sh.clone()),
            tensors: [means, cam_from_world].map(|tensor| B::host(tensor.clone())),
            coefficients: sh.shape()[1],
        }
    }

    fn inputs(&self) -> shade::cpu::Inputs<'_, F> {
        let [means, cam_from_world] = &self.tensors;
        shade::cpu::Inputs { sh: self.sh.view(), means, cam_from_world, coefficients: self.coefficients }
    }
}

fn shade<B: HostBackend, F: Real>(inputs: ShadeInputs<B>, visible: Slot<B>, spec: &ProjectSpec) -> FloatTensor<B> {
    let ellipses = visible.as_ref().map(|ellipses| B::host(ellipses.clone()));
    let visible = ellipses.as_deref().map(|ellipses| Visible::new(ellipses, spec));
    let colours = shade::cpu::shade_cpu(ShadeHost::<F>::read(&inputs).inputs(), visible.as_ref());
    let count = colours.len() / 3;
    B::from_host(colours, &[count, 3], &inputs.means)
}

fn shade_backward<B: HostBackend, F: Real>(
    inputs: ShadeInputs<B>,
    visible: Slot<B>,
    grad: FloatTensor<B>,
    spec: &ProjectSpec,
    needs: ShadeNeeds,
) -> ShadeGrads<B> {
    let host = ShadeHost::<F>::read(&inputs);
    let ellipses = visible.as_ref().map(|ellipses| B::host(ellipses.clone()));
    let visible = ellipses.as_deref().map(|ellipses| Visible::new(ellipses, spec));
    let g = shade::cpu::shade_backward_cpu(host.inputs(), visible.as_ref(), &B::host(grad), needs);
    let (count, like) = (host.inputs().means.len() / 3, &inputs.means);
    ShadeGrads {
        sh: slot(needs.sh, g.sh, &[count, host.coefficients, 3], like),
        means: slot(needs.means, g.means, &[count, 3], like),
        cam_from_world: slot(needs.cam_from_world, g.cam_from_world, &[3, 4], like),
    }
}

/// The lists in the cell, computed now if nobody has yet.
fn hit_lists<'a, F: Real>(cell: &'a HitCell, projected: &[F], spec: &BlendSpec) -> &'a HitLists {
    hit_lists_by(cell, || tile_cpu(projected, &spec.intrinsics, Cut::of(&spec.options)))
}

/// The lists in the cell, or those that `compute` makes.
pub(super) fn hit_lists_by(cell: &HitCell, compute: impl FnOnce() -> HitLists) -> &HitLists {
    match cell.0.get_or_init(|| Lists::Host(compute())) {
        Lists::Host(lists) => lists,
        #[cfg(feature = "cube")]
        Lists::Device(_) => unreachable!("the public functions check that lists and ellipses are on one device"),
    }
}

fn tile<B: HostBackend, F: Real>(projected: FloatTensor<B>, spec: &BlendSpec, cell: &HitCell) -> IntTensor<B> {
    let device = projected.device();
    let lists = hit_lists(cell, &B::host::<F>(projected), spec);
    let counts: Vec<i32> = lists.tile_start.windows(2).map(|w| (w[1] - w[0]) as i32).collect();
    let [tiles_x, tiles_y] = tile_grid(spec.intrinsics.width, spec.intrinsics.height);
    B::int_from_data(TensorData::new(counts, [tiles_y, tiles_x]), &device)
}

struct BlendHost<F: Real>([Host<F>; 3]);

impl<F: Real> BlendHost<F> {
    fn read<B: HostBackend>(inputs: &BlendInputs<B>) -> Self {
        let BlendInputs { projected, features, background } = inputs;
        Self([projected, features, background].map(|tensor| B::host(tensor.clone())))
    }

    fn inputs(&self) -> blend::cpu::Inputs<'_, F> {
        let [projected, features, background] = &self.0;
        blend::cpu::Inputs { projected, features, background }
    }
}

fn blend<B: HostBackend, F: Real>(
    inputs: BlendInputs<B>,
    spec: &BlendSpec,
    hits: &HitCell,
    trace: Option<TraceCell>,
) -> FloatTensor<B> {
    let host = BlendHost::<F>::read(&inputs);
    let lists = hit_lists(hits, host.inputs().projected, spec);
    let (planes, kept) = blend::cpu::blend_cpu(host.inputs(), spec, lists, trace.is_some());
    if let (Some(cell), Some(kept)) = (trace, kept) {
        // A cell that is filled already holds the same trace.
        let _ = cell.0.set(Box::new(kept));
    }
    let count = spec.planes(host.inputs().background.len());
    B::from_host(planes, &[count, spec.intrinsics.height, spec.intrinsics.width], &inputs.projected)
}

/// The gradient of all planes, where it may be that of the first `channels` alone.
fn all_planes<B: HostBackend>(grad: FloatTensor<B>, spec: &BlendSpec, channels: usize) -> FloatTensor<B> {
    let [given, height, width] = grad.shape().dims();
    match spec.planes(channels) - given {
        0 => grad,
        missing => {
            let shape = Shape::from([missing, height, width]);
            let zeros = B::float_zeros(shape, &grad.device(), grad.dtype().into());
            B::float_cat(vec![grad, zeros], 0)
        }
    }
}

fn blend_backward<B: HostBackend, F: Real>(
    inputs: BlendInputs<B>,
    grad: FloatTensor<B>,
    spec: &BlendSpec,
    needs: BlendNeeds,
    (hits, trace): (&HitCell, &TraceCell),
) -> BlendGrads<B> {
    let host = BlendHost::<F>::read(&inputs);
    let lists = hit_lists(hits, host.inputs().projected, spec);
    let trace = trace.0.get().and_then(|kept| kept.downcast_ref::<blend::cpu::Trace<F>>());
    let g = blend::cpu::blend_backward_cpu(host.inputs(), &B::host(grad), spec, (lists, trace), needs);
    let channels = host.inputs().background.len();
    let (count, like) = (host.inputs().projected.len() / COLUMNS, &inputs.projected);
    BlendGrads {
        projected: slot(needs.projected, g.projected, &[count, COLUMNS], like),
        features: slot(needs.features, g.features, &[count, channels], like),
        background: slot(needs.background, g.background, &[channels], like),
        mean2d_abs: slot(needs.mean2d_abs, g.mean2d_abs, &[count, 2], like),
    }
}

macro_rules! cpu_backend {
    ($backend:ty) => {
        impl SplatBackend for $backend {
            fn project(inputs: ProjectInputs<Self>, _: FloatTensor<Self>, spec: ProjectSpec) -> FloatTensor<Self> {
                by_type!(inputs.means, F => project::<Self, F>(inputs, &spec))
            }

            fn project_backward(
                inputs: ProjectInputs<Self>,
                grad: FloatTensor<Self>,
                spec: ProjectSpec,
                needs: ProjectNeeds,
            ) -> ProjectGrads<Self> {
                by_type!(inputs.means, F => project_backward::<Self, F>(inputs, grad, &spec, needs))
            }

            fn shade(inputs: ShadeInputs<Self>, visible: Slot<Self>, spec: ProjectSpec) -> FloatTensor<Self> {
                by_type!(inputs.means, F => shade::<Self, F>(inputs, visible, &spec))
            }

            fn shade_backward(
                inputs: ShadeInputs<Self>,
                visible: Slot<Self>,
                grad: FloatTensor<Self>,
                spec: ProjectSpec,
                needs: ShadeNeeds,
            ) -> ShadeGrads<Self> {
                by_type!(inputs.means, F => shade_backward::<Self, F>(inputs, visible, grad, &spec, needs))
            }

            fn tile(projected: FloatTensor<Self>, spec: BlendSpec, hits: HitCell) -> IntTensor<Self> {
                by_type!(projected, F => tile::<Self, F>(projected, &spec, &hits))
            }

            fn blend(
                inputs: BlendInputs<Self>,
                _: FloatTensor<Self>,
                _: IntTensor<Self>,
                spec: BlendSpec,
                hits: HitCell,
                trace: Option<TraceCell>,
                _: PartsCell,
            ) -> FloatTensor<Self> {
                by_type!(inputs.projected, F => blend::<Self, F>(inputs, &spec, &hits, trace))
            }

            fn part(planes: FloatTensor<Self>, from: usize, to: usize, _: PartsCell) -> FloatTensor<Self> {
                let [_, height, width] = planes.shape().dims();
                Self::float_slice(planes, &[from..to, 0..height, 0..width].map(Slice::from))
            }

            fn blend_backward(
                inputs: BlendInputs<Self>,
                _: FloatTensor<Self>,
                grad: FloatTensor<Self>,
                spec: BlendSpec,
                needs: BlendNeeds,
                hits: HitCell,
                trace: TraceCell,
            ) -> BlendGrads<Self> {
                let grad = all_planes::<Self>(grad, &spec, inputs.background.shape().num_elements());
                by_type!(inputs.projected, F => blend_backward::<Self, F>(inputs, grad, &spec, needs, (&hits, &trace)))
            }
        }
    };
}

cpu_backend!(Flex);
cpu_backend!(NdArray);

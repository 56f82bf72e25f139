//! The order of the launches on Burn's GPU backend, for every CubeCL runtime.

use burn::backend::TensorMetadata;
use burn::backend::ops::FloatTensorOps;
use burn::backend::tensor::{FloatTensor, IntTensor};
use burn::tensor::{DType, Shape, Slice};
use burn_cubecl::CubeBackend;
use burn_cubecl::kernel::into_contiguous;
use burn_cubecl::tensor::CubeTensor;

use crate::blend::launch::{DeviceTrace, launch_blend, launch_blend_backward};
use crate::blend::{self, BlendGrads, BlendInputs, BlendNeeds, BlendSpec, PartsCell, TraceCell};
use crate::gpu::{Buffer, Gpu, launch_scale};
use crate::op::{Slot, SplatBackend};
use crate::project::launch::{launch_project, launch_project_backward};
use crate::project::{self, COLUMNS, ProjectGrads, ProjectInputs, ProjectNeeds, ProjectSpec};
use crate::shade::launch::{Coefficients, launch_shade, launch_shade_backward};
use crate::shade::{self, ShadeGrads, ShadeInputs, ShadeNeeds};
use crate::tile::launch::{DeviceLists, launch_tile};
use crate::tile::{Cut, HitCell, Lists, tile_grid};

/// A tensor's elements, row-major.
pub(crate) fn buffer(tensor: CubeTensor) -> Buffer<f32> {
    debug_assert_eq!(tensor.dtype, DType::F32, "the public functions check it");
    let tensor = into_contiguous(tensor);
    let len = tensor.meta.num_elements();
    Buffer::from_handle(tensor.handle, len)
}

/// Coefficients of spherical harmonics, row-major: those of half precision in words of two.
fn coefficients(tensor: CubeTensor) -> Coefficients {
    if tensor.dtype != DType::F16 {
        return buffer(tensor).into();
    }
    let tensor = into_contiguous(tensor);
    let len = tensor.meta.num_elements();
    Coefficients::halves(Buffer::from_handle(tensor.handle, len.div_ceil(2)), len)
}

/// Elements as a tensor, on the device of `like`.
pub(crate) fn tensor<T>(buffer: Buffer<T>, shape: impl Into<Shape>, dtype: DType, like: &CubeTensor) -> CubeTensor {
    let (client, device) = (like.client.clone(), like.device.clone());
    CubeTensor::new_contiguous(client, device, shape.into(), buffer.handle, dtype)
}

/// The tensor itself if nobody else holds its memory, else a copy.
pub(crate) fn owned(tensor: CubeTensor) -> CubeTensor {
    let tensor = into_contiguous(tensor);
    if tensor.can_mut() { tensor } else { tensor.copy() }
}

/// `values` times `factor`, `[1]`; tensor code would read both with all their dimensions.
pub(crate) fn scaled(values: CubeTensor, factor: CubeTensor) -> CubeTensor {
    if values.dtype != DType::F32 {
        return CubeBackend::float_mul(
            values.clone(),
            CubeBackend::float_reshape(factor, vec![1; values.rank()].into()),
        );
    }
    let values = owned(values);
    launch_scale(&Gpu::new(&values.client), &buffer(values.clone()), &buffer(factor));
    values
}

pub(super) fn slot(grad: Option<Buffer<f32>>, shape: impl Into<Shape>, like: &CubeTensor) -> Slot<CubeBackend> {
    match grad {
        None => Slot::Skip,
        Some(grad) => Slot::Have(tensor(grad, shape, DType::F32, like)),
    }
}

impl ProjectInputs<CubeBackend> {
    pub(super) fn on_device(&self) -> project::launch::DeviceInputs {
        project::launch::DeviceInputs {
            means: buffer(self.means.clone()),
            rotations: buffer(self.rotations.clone()),
            scales: buffer(self.scales.clone()),
            opacities: buffer(self.opacities.clone()),
            cam_from_world: buffer(self.cam_from_world.clone()),
        }
    }
}

/// The gradients of `count` Gaussians as tensors.
pub(super) fn project_grads(
    g: project::launch::DeviceGrads,
    count: usize,
    like: &CubeTensor,
) -> ProjectGrads<CubeBackend> {
    ProjectGrads {
        means: slot(g.means, [count, 3], like),
        rotations: slot(g.rotations, [count, 4], like),
        scales: slot(g.scales, [count, 3], like),
        opacities: slot(g.opacities, [count], like),
        cam_from_world: slot(g.cam_from_world, [3, 4], like),
        mean2d: slot(g.mean2d, [count, 2], like),
    }
}

impl ShadeInputs<CubeBackend> {
    fn on_device(&self) -> shade::launch::DeviceInputs {
        shade::launch::DeviceInputs {
            sh: coefficients(self.sh.clone()),
            means: buffer(self.means.clone()),
            cam_from_world: buffer(self.cam_from_world.clone()),
        }
    }
}

impl BlendInputs<CubeBackend> {
    fn on_device(&self) -> blend::launch::DeviceInputs {
        blend::launch::DeviceInputs {
            projected: buffer(self.projected.clone()),
            features: buffer(self.features.clone()),
            background: buffer(self.background.clone()),
        }
    }
}

/// The lists in the cell, computed now if nobody has yet.
fn lists<'a>(gpu: &Gpu, cell: &'a HitCell, projected: &Buffer<f32>, spec: &BlendSpec) -> &'a DeviceLists {
    lists_by(cell, || launch_tile(gpu, projected, &spec.intrinsics, Cut::of(&spec.options)))
}

/// The lists in the cell, or those that `compute` makes.
pub(super) fn lists_by(cell: &HitCell, compute: impl FnOnce() -> DeviceLists) -> &DeviceLists {
    match cell.0.get_or_init(|| Lists::Device(Box::new(compute()))) {
        Lists::Device(lists) => lists,
        Lists::Host(_) => unreachable!("the public functions check that lists and ellipses are on one device"),
    }
}

impl SplatBackend for CubeBackend {
    fn project(inputs: ProjectInputs<Self>, _: FloatTensor<Self>, spec: ProjectSpec) -> FloatTensor<Self> {
        let gpu = Gpu::new(&inputs.means.client);
        let packed = launch_project(&gpu, &inputs.on_device(), &spec);
        tensor(packed, [inputs.means.shape()[0], COLUMNS], DType::F32, &inputs.means)
    }

    fn project_backward(
        inputs: ProjectInputs<Self>,
        grad: FloatTensor<Self>,
        spec: ProjectSpec,
        needs: ProjectNeeds,
    ) -> ProjectGrads<Self> {
        let gpu = Gpu::new(&inputs.means.client);
        let g = launch_project_backward(&gpu, &inputs.on_device(), &buffer(grad), &spec, needs);
        project_grads(g, inputs.means.shape()[0], &inputs.means)
    }

    fn shade(inputs: ShadeInputs<Self>, visible: Slot<Self>, spec: ProjectSpec) -> FloatTensor<Self> {
        let gpu = Gpu::new(&inputs.means.client);
        let visible = visible.as_ref().map(|ellipses| buffer(ellipses.clone()));
        let visible = visible.as_ref().map(|ellipses| (ellipses, &spec));
        let colours = launch_shade(&gpu, &inputs.on_device(), visible, inputs.sh.shape()[1]);
        tensor(colours, [inputs.means.shape()[0], 3], DType::F32, &inputs.means)
    }

    fn shade_backward(
        inputs: ShadeInputs<Self>,
        visible: Slot<Self>,
        grad: FloatTensor<Self>,
        spec: ProjectSpec,
        needs: ShadeNeeds,
    ) -> ShadeGrads<Self> {
        let gpu = Gpu::new(&inputs.means.client);
        let coefficients = inputs.sh.shape()[1];
        let visible = visible.as_ref().map(|ellipses| buffer(ellipses.clone()));
        let (on_device, grad) = (inputs.on_device(), buffer(grad));
        let visible = visible.as_ref().map(|ellipses| (ellipses, &spec));
        let g = launch_shade_backward(&gpu, &on_device, visible, coefficients, &grad, needs);
        let (count, like) = (inputs.means.shape()[0], &inputs.means);
        ShadeGrads {
            sh: slot(g.sh, [count, coefficients, 3], like),
            means: slot(g.means, [count, 3], like),
            cam_from_world: slot(g.cam_from_world, [3, 4], like),
        }
    }

    fn tile(projected: FloatTensor<Self>, spec: BlendSpec, hits: HitCell) -> IntTensor<Self> {
        let gpu = Gpu::new(&projected.client);
        let counts = lists(&gpu, &hits, &buffer(projected.clone()), &spec).counts.clone();
        let [tiles_x, tiles_y] = tile_grid(spec.intrinsics.width, spec.intrinsics.height);
        tensor(counts, [tiles_y, tiles_x], DType::I32, &projected)
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
        let gpu = Gpu::new(&inputs.projected.client);
        let on_device = inputs.on_device();
        let lists = lists(&gpu, &hits, &on_device.projected, &spec);
        let (planes, kept) = launch_blend(&gpu, &on_device, lists, &spec, trace.is_some());
        if let (Some(cell), Some(kept)) = (trace, kept) {
            // A cell that is filled already holds the same trace.
            let _ = cell.0.set(Box::new(kept));
        }
        let count = spec.planes(on_device.background.len);
        let shape = [count, spec.intrinsics.height, spec.intrinsics.width];
        tensor(planes, shape, DType::F32, &inputs.projected)
    }

    fn part(planes: FloatTensor<Self>, from: usize, to: usize, _: PartsCell) -> FloatTensor<Self> {
        let [count, height, width] = planes.shape().dims();
        if from > 0 {
            let slices = [from..to, 0..height, 0..width].map(Slice::from);
            return Self::float_slice(planes, &slices);
        }
        let planes = into_contiguous(planes);
        let behind = (count - to) * height * width * size_of::<f32>();
        let first = Buffer::<f32>::from_handle(planes.handle.clone().offset_end(behind as u64), to * height * width);
        tensor(first, [to, height, width], DType::F32, &planes)
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
        let gpu = Gpu::new(&inputs.projected.client);
        let on_device = inputs.on_device();
        let lists = lists(&gpu, &hits, &on_device.projected, &spec);
        let kept = trace.0.get().and_then(|kept| kept.downcast_ref::<DeviceTrace>()).cloned();
        let kept = kept
            .unwrap_or_else(|| launch_blend(&gpu, &on_device, lists, &spec, true).1.expect("a trace was asked for"));
        let g = launch_blend_backward(&gpu, &on_device, &buffer(grad), lists, &kept, &spec, needs);
        let (count, channels) = (inputs.projected.shape()[0], on_device.background.len);
        let like = &inputs.projected;
        BlendGrads {
            projected: slot(g.projected, [count, COLUMNS], like),
            features: slot(g.features, [count, channels], like),
            background: slot(g.background, [channels], like),
            mean2d_abs: slot(g.mean2d_abs, [count, 2], like),
        }
    }
}

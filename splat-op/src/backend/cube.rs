//! Order of the kernel launches on Burn's GPU backend, for every CubeCL runtime.

use burn::backend::TensorMetadata;
use burn::backend::ops::FloatTensorOps;
use burn::backend::tensor::{FloatTensor, IntTensor};
use burn::tensor::{DType, Shape, Slice};
use burn_cubecl::CubeBackend;
use burn_cubecl::kernel::into_contiguous;
use burn_cubecl::tensor::CubeTensor;

use super::stages::SplatBackend;
use super::tensors::{
    GeometryGrads, GeometryTensors, InputTensor, LayerGrads, LayerTensors, OptionalTensor, PlaneGrads, RayLayerGrads,
    RayLayerTensors, ShadingGrads, ShadingTensors,
};
use crate::gpu::{Buffer, Gpu, launch_scale};
use crate::intersect::launch::{DeviceIntersections, launch_intersect};
use crate::intersect::{Cut, IntersectionCell, StoredIntersections, tile_grid};
use crate::project::launch::{launch_project, launch_project_backward};
use crate::project::{COLUMNS, Geometry, ProjectSpec};
use crate::rasterize::launch::{launch_rasterize, launch_rasterize_backward};
use crate::rasterize::trace::DeviceTrace;
use crate::rasterize::{Layers, PartsCell, PlaneParts, RasterizeSpec, TraceCell};
use crate::rasterize_rays::RayLayers;
use crate::rasterize_rays::launch::{ROOM, launch_rasterize_rays, launch_rasterize_rays_backward};
use crate::ray_space::columns;
use crate::ray_space::launch::{launch_bounds, launch_ray_space, launch_ray_space_backward};
use crate::sh::Shading;
use crate::sh::launch::{DeviceShCoefficients, ShDeviceInputs, launch_sh, launch_sh_backward};

/// Returns a tensor's elements, row-major.
pub(crate) fn buffer(tensor: CubeTensor) -> Buffer<f32> {
    debug_assert_eq!(tensor.dtype, DType::F32, "the public functions check it");
    let tensor = into_contiguous(tensor);
    let len = tensor.meta.num_elements();
    Buffer::from_handle(tensor.handle, len)
}

/// Returns coefficients of spherical harmonics, row-major.
fn coefficients(tensor: CubeTensor) -> DeviceShCoefficients {
    if tensor.dtype != DType::F16 {
        return buffer(tensor).into();
    }
    let tensor = into_contiguous(tensor);
    let len = tensor.meta.num_elements();
    DeviceShCoefficients::halves(Buffer::from_handle(tensor.handle, len.div_ceil(2)), len)
}

/// Returns a buffer as a tensor on the device of `like`.
pub(crate) fn tensor<T>(buffer: Buffer<T>, shape: impl Into<Shape>, dtype: DType, like: &CubeTensor) -> CubeTensor {
    let (client, device) = (like.client.clone(), like.device.clone());
    CubeTensor::new_contiguous(client, device, shape.into(), buffer.handle, dtype)
}

/// Returns the tensor itself if nothing else holds its memory, else a copy.
pub(crate) fn owned(tensor: CubeTensor) -> CubeTensor {
    let tensor = into_contiguous(tensor);
    if tensor.can_mut() { tensor } else { tensor.copy() }
}

/// Returns `values` times `factor`, `[1]`. Generic tensor code would read both through all their dimensions.
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

/// Reads the elements of an input.
pub(super) fn on_device(input: &InputTensor<CubeBackend>) -> Buffer<f32> {
    buffer(input.0.clone())
}

/// Returns the gradient of an input as a tensor of its shape, if it was asked for.
pub(super) fn gradient(
    (found, input): (Option<Buffer<f32>>, &InputTensor<CubeBackend>),
) -> OptionalTensor<CubeBackend> {
    found.map(|found| tensor(found, input.0.shape(), DType::F32, &input.0)).into()
}

fn shading_on_device(inputs: &ShadingTensors<CubeBackend>) -> ShDeviceInputs {
    ShDeviceInputs {
        sh: coefficients(inputs.sh.0.clone()),
        means: on_device(&inputs.means),
        cam_from_world: on_device(&inputs.cam_from_world),
    }
}

/// Returns the lists in the cell, computing them if it is empty.
fn lists<'a>(
    gpu: &Gpu,
    cell: &'a IntersectionCell,
    projected: &Buffer<f32>,
    spec: &RasterizeSpec,
) -> &'a DeviceIntersections {
    lists_by(cell, || launch_intersect(gpu, projected, &spec.intrinsics, Cut::of(&spec.options)))
}

/// Returns the lists in the cell, filling it by `compute` if it is empty.
fn lists_by(cell: &IntersectionCell, compute: impl FnOnce() -> DeviceIntersections) -> &DeviceIntersections {
    match cell.0.get_or_init(|| StoredIntersections::Device(Box::new(compute()))) {
        StoredIntersections::Device(lists) => lists,
        StoredIntersections::Host(_) => {
            unreachable!("the public functions check that lists and ellipses are on one device")
        }
    }
}

/// Returns the gradient of all `planes` of a render of `features` features in one tensor, with zeros where a part has none. If `shortest`
/// is set and only the features have one, the result has theirs alone.
fn of_planes(grads: PlaneGrads<CubeBackend>, planes: &CubeTensor, features: usize, shortest: bool) -> CubeTensor {
    let [count, height, width] = planes.shape().dims();
    let PlaneParts { colour, alpha, depth } = grads.map(OptionalTensor::into_option);
    let zeros = |len: usize| {
        let shape = Shape::from([len, height, width]);
        CubeBackend::float_zeros(shape, &planes.device, planes.dtype.into())
    };
    let alone = shortest && alpha.is_none();
    let mut parts = vec![colour.unwrap_or_else(|| zeros(features))];
    if !alone {
        parts.push(alpha.unwrap_or_else(|| zeros(1)));
        parts.extend((count > features + 1).then(|| depth.unwrap_or_else(|| zeros(1))));
    }
    if parts.len() == 1 { parts.remove(0) } else { CubeBackend::float_cat(parts, 0) }
}

/// Returns planes as a tensor.
fn planes_tensor(planes: Buffer<f32>, spec: &RasterizeSpec, background: &InputTensor<CubeBackend>) -> CubeTensor {
    let shape = [spec.planes(background.0.shape()[0]), spec.intrinsics.height, spec.intrinsics.width];
    tensor(planes, shape, DType::F32, &background.0)
}

/// Returns the lists of a render along rays, computing them if the cell is empty.
fn ray_lists<'a>(
    gpu: &Gpu,
    cell: &'a IntersectionCell,
    inputs: &RayLayers<Buffer<f32>>,
    spec: &RasterizeSpec,
) -> &'a DeviceIntersections {
    lists_by(cell, || {
        let bounds = launch_bounds(gpu, &inputs.projected, &inputs.ray_space, spec);
        launch_intersect(gpu, &bounds, &spec.intrinsics, Cut::of(&spec.options))
    })
}

impl SplatBackend for CubeBackend {
    fn project(inputs: GeometryTensors<Self>, spec: ProjectSpec) -> FloatTensor<Self> {
        let like = &inputs.means.0;
        let packed = launch_project(&Gpu::new(&like.client), &inputs.each_ref().map(on_device), &spec);
        tensor(packed, [like.shape()[0], COLUMNS], DType::F32, like)
    }

    fn project_backward(
        inputs: GeometryTensors<Self>,
        grad: FloatTensor<Self>,
        spec: ProjectSpec,
        mask: Geometry<bool>,
    ) -> GeometryGrads<Self> {
        let gpu = Gpu::new(&grad.client);
        let found = launch_project_backward(&gpu, &inputs.each_ref().map(on_device), &buffer(grad), &spec, mask);
        found.zip(inputs.each_ref()).map(gradient)
    }

    fn evaluate_sh(
        inputs: ShadingTensors<Self>,
        visible: OptionalTensor<Self>,
        spec: ProjectSpec,
    ) -> FloatTensor<Self> {
        let like = &inputs.means.0;
        let visible = visible.into_option().map(buffer);
        let visible = visible.as_ref().map(|ellipses| (ellipses, &spec));
        let coefficients = inputs.sh.0.shape()[1];
        let colours = launch_sh(&Gpu::new(&like.client), &shading_on_device(&inputs), visible, coefficients);
        tensor(colours, like.shape(), DType::F32, like)
    }

    fn sh_backward(
        inputs: ShadingTensors<Self>,
        visible: OptionalTensor<Self>,
        grad: FloatTensor<Self>,
        spec: ProjectSpec,
        mask: Shading<bool>,
    ) -> ShadingGrads<Self> {
        let gpu = Gpu::new(&grad.client);
        let visible = visible.into_option().map(buffer);
        let visible = visible.as_ref().map(|ellipses| (ellipses, &spec));
        let (on_device, coefficients) = (shading_on_device(&inputs), inputs.sh.0.shape()[1]);
        let found = launch_sh_backward(&gpu, &on_device, visible, coefficients, &buffer(grad), mask);
        found.zip(inputs.each_ref()).map(gradient)
    }

    fn intersect(
        projected: FloatTensor<Self>,
        spec: RasterizeSpec,
        intersections: IntersectionCell,
    ) -> IntTensor<Self> {
        let gpu = Gpu::new(&projected.client);
        let counts = lists(&gpu, &intersections, &buffer(projected.clone()), &spec).counts.clone();
        let [tiles_x, tiles_y] = tile_grid(spec.intrinsics.width, spec.intrinsics.height);
        tensor(counts, [tiles_y, tiles_x], DType::I32, &projected)
    }

    fn rasterize(
        inputs: LayerTensors<Self>,
        _: IntTensor<Self>,
        spec: RasterizeSpec,
        intersections: IntersectionCell,
        trace: Option<TraceCell>,
        _: PartsCell,
    ) -> FloatTensor<Self> {
        let gpu = Gpu::new(&inputs.projected.0.client);
        let on_device = inputs.each_ref().map(on_device);
        let lists = lists(&gpu, &intersections, &on_device.projected, &spec);
        let (planes, kept) = launch_rasterize(&gpu, &on_device, lists, &spec, trace.is_some());
        if let (Some(cell), Some(kept)) = (trace, kept) {
            // A cell that is already filled holds the same trace.
            let _ = cell.0.set(Box::new(kept));
        }
        // The device may have nothing else to do by now.
        gpu.begin();
        planes_tensor(planes, &spec, &inputs.background)
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

    fn rasterize_backward(
        inputs: LayerTensors<Self>,
        planes: FloatTensor<Self>,
        grads: PlaneGrads<Self>,
        spec: RasterizeSpec,
        mask: Layers<bool>,
        intersections: IntersectionCell,
        trace: TraceCell,
    ) -> LayerGrads<Self> {
        let gpu = Gpu::new(&planes.client);
        let features = inputs.background.0.shape()[0];
        let grad = buffer(of_planes(grads, &planes, features, !spec.options.depth));
        let on_device = inputs.each_ref().map(on_device);
        let lists = lists(&gpu, &intersections, &on_device.projected, &spec);
        let kept = trace.0.get().and_then(|kept| kept.downcast_ref::<DeviceTrace>()).cloned();
        let kept = kept.unwrap_or_else(|| {
            launch_rasterize(&gpu, &on_device, lists, &spec, true).1.expect("a trace was asked for")
        });
        let found = launch_rasterize_backward(&gpu, &on_device, &grad, lists, &kept, &spec, mask);
        found.zip(inputs.each_ref()).map(gradient)
    }

    fn ray_space(inputs: GeometryTensors<Self>, spec: ProjectSpec) -> FloatTensor<Self> {
        let like = &inputs.means.0;
        let ray_rows = launch_ray_space(&Gpu::new(&like.client), &inputs.each_ref().map(on_device), &spec);
        tensor(ray_rows, [like.shape()[0], columns(&spec.intrinsics)], DType::F32, like)
    }

    fn ray_space_backward(
        inputs: GeometryTensors<Self>,
        grad: FloatTensor<Self>,
        spec: ProjectSpec,
        mask: Geometry<bool>,
    ) -> GeometryGrads<Self> {
        let gpu = Gpu::new(&grad.client);
        let found = launch_ray_space_backward(&gpu, &inputs.each_ref().map(on_device), &buffer(grad), &spec, mask);
        found.zip(inputs.each_ref()).map(gradient)
    }

    fn bounds(projected: FloatTensor<Self>, ray_space: FloatTensor<Self>, spec: RasterizeSpec) -> FloatTensor<Self> {
        let gpu = Gpu::new(&projected.client);
        let rows = launch_bounds(&gpu, &buffer(projected.clone()), &buffer(ray_space), &spec);
        tensor(rows, projected.shape(), DType::F32, &projected)
    }

    fn rasterize_rays(
        inputs: RayLayerTensors<Self>,
        _: IntTensor<Self>,
        spec: RasterizeSpec,
        intersections: IntersectionCell,
        _: Option<TraceCell>,
        _: PartsCell,
    ) -> FloatTensor<Self> {
        let gpu = Gpu::new(&inputs.projected.0.client);
        let on_device = inputs.each_ref().map(on_device);
        let planes = launch_rasterize_rays(&gpu, &on_device, ray_lists(&gpu, &intersections, &on_device, &spec), &spec);
        planes_tensor(planes, &spec, &inputs.background)
    }

    fn rasterize_rays_backward(
        inputs: RayLayerTensors<Self>,
        planes: FloatTensor<Self>,
        grads: PlaneGrads<Self>,
        spec: RasterizeSpec,
        mask: RayLayers<bool>,
        intersections: IntersectionCell,
        _: TraceCell,
    ) -> RayLayerGrads<Self> {
        let gpu = Gpu::new(&planes.client);
        let features = inputs.background.0.shape()[0];
        let grad = buffer(of_planes(grads, &planes, features, false));
        let on_device = inputs.each_ref().map(on_device);
        let lists = ray_lists(&gpu, &intersections, &on_device, &spec);
        let found = launch_rasterize_rays_backward(&gpu, &on_device, &grad, (lists, ROOM), &spec, mask);
        found.zip(inputs.each_ref()).map(gradient)
    }
}

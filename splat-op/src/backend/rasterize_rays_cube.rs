//! Order of the kernel launches of `depth_slope` and `rasterize_rays` on Burn's GPU backend.

use burn::backend::TensorMetadata;
use burn::backend::tensor::{FloatTensor, IntTensor};
use burn::tensor::DType;
use burn_cubecl::CubeBackend;

use super::cube::{buffer, gradient, lists_by, on_device, planes_tensor, tensor};
use super::rasterize_rays::RasterizeRaysBackend;
use super::tensors::{GeometryGrads, GeometryTensors, RayLayerGrads, RayLayerTensors};
use crate::depth_slope::DEPTH_SLOPE;
use crate::depth_slope::launch::{launch_bounds, launch_depth_slope, launch_depth_slope_backward};
use crate::gpu::{Buffer, Gpu};
use crate::intersect::launch::{DeviceIntersections, launch_intersect};
use crate::intersect::{Cut, IntersectionCell};
use crate::project::{Geometry, ProjectSpec};
use crate::rasterize::{PartsCell, RasterizeSpec};
use crate::rasterize_rays::RayLayers;
use crate::rasterize_rays::launch::{TABLE, launch_rasterize_rays, launch_rasterize_rays_backward};

/// Returns the lists in the cell, computing them if it is empty.
fn lists<'a>(
    gpu: &Gpu,
    cell: &'a IntersectionCell,
    inputs: &RayLayers<Buffer<f32>>,
    spec: &RasterizeSpec,
) -> &'a DeviceIntersections {
    lists_by(cell, || {
        let rows = |packed: &Buffer<f32>| launch_intersect(gpu, packed, &spec.intrinsics, Cut::of(&spec.options));
        match spec.options.extends_by_bounds() {
            true => rows(&launch_bounds(gpu, &inputs.projected, &inputs.depth_slope, spec)),
            false => rows(&inputs.projected),
        }
    })
}

impl RasterizeRaysBackend for CubeBackend {
    fn depth_slope(inputs: GeometryTensors<Self>, spec: ProjectSpec) -> FloatTensor<Self> {
        let like = &inputs.means.0;
        let depth_slopes = launch_depth_slope(&Gpu::new(&like.client), &inputs.each_ref().map(on_device), &spec);
        tensor(depth_slopes, [like.shape()[0], DEPTH_SLOPE], DType::F32, like)
    }

    fn depth_slope_backward(
        inputs: GeometryTensors<Self>,
        grad: FloatTensor<Self>,
        spec: ProjectSpec,
        mask: Geometry<bool>,
    ) -> GeometryGrads<Self> {
        let gpu = Gpu::new(&grad.client);
        let found = launch_depth_slope_backward(&gpu, &inputs.each_ref().map(on_device), &buffer(grad), &spec, mask);
        found.zip(inputs.each_ref()).map(gradient)
    }

    fn bounds(projected: FloatTensor<Self>, depth_slope: FloatTensor<Self>, spec: RasterizeSpec) -> FloatTensor<Self> {
        let gpu = Gpu::new(&projected.client);
        let rows = launch_bounds(&gpu, &buffer(projected.clone()), &buffer(depth_slope), &spec);
        tensor(rows, projected.shape(), DType::F32, &projected)
    }

    fn rasterize_rays(
        inputs: RayLayerTensors<Self>,
        _: IntTensor<Self>,
        spec: RasterizeSpec,
        intersections: IntersectionCell,
        _: PartsCell,
    ) -> FloatTensor<Self> {
        let gpu = Gpu::new(&inputs.projected.0.client);
        let on_device = inputs.each_ref().map(on_device);
        let planes = launch_rasterize_rays(&gpu, &on_device, lists(&gpu, &intersections, &on_device, &spec), &spec);
        planes_tensor(planes, &spec, &inputs.background)
    }

    fn rasterize_rays_backward(
        inputs: RayLayerTensors<Self>,
        _: FloatTensor<Self>,
        grad: FloatTensor<Self>,
        spec: RasterizeSpec,
        mask: RayLayers<bool>,
        intersections: IntersectionCell,
    ) -> RayLayerGrads<Self> {
        let gpu = Gpu::new(&grad.client);
        let on_device = inputs.each_ref().map(on_device);
        let lists = lists(&gpu, &intersections, &on_device, &spec);
        let found = launch_rasterize_rays_backward(&gpu, &on_device, &buffer(grad), (lists, TABLE), &spec, mask);
        found.zip(inputs.each_ref()).map(gradient)
    }
}

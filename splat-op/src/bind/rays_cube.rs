//! The order of the launches of `tilt` and `rays` on Burn's GPU backend.

use burn::backend::TensorMetadata;
use burn::backend::tensor::{FloatTensor, IntTensor};
use burn::tensor::DType;
use burn_cubecl::CubeBackend;

use super::cube::{buffer, lists_by, project_grads, slot, tensor};
use super::rays::RaysBackend;
use crate::blend::{BlendSpec, PartsCell};
use crate::gpu::{Buffer, Gpu};
use crate::project::{COLUMNS, ProjectGrads, ProjectInputs, ProjectNeeds, ProjectSpec};
use crate::rays::launch::{DeviceInputs, launch_rays, launch_rays_backward};
use crate::rays::{RaysGrads, RaysInputs, RaysNeeds};
use crate::tile::launch::{DeviceLists, launch_tile};
use crate::tile::{Cut, HitCell};
use crate::tilt::TILT;
use crate::tilt::launch::{launch_outline, launch_tilt, launch_tilt_backward};

impl RaysInputs<CubeBackend> {
    fn on_device(&self) -> DeviceInputs {
        DeviceInputs {
            projected: buffer(self.projected.clone()),
            tilt: buffer(self.tilt.clone()),
            features: buffer(self.features.clone()),
            background: buffer(self.background.clone()),
        }
    }
}

/// The lists in the cell, computed now if nobody has yet.
fn lists<'a>(gpu: &Gpu, cell: &'a HitCell, inputs: &DeviceInputs, spec: &BlendSpec) -> &'a DeviceLists {
    lists_by(cell, || {
        let rows = |packed: &Buffer<f32>| launch_tile(gpu, packed, &spec.intrinsics, Cut::of(&spec.options));
        match spec.options.reaches_by_outline() {
            true => rows(&launch_outline(gpu, &inputs.projected, &inputs.tilt, spec)),
            false => rows(&inputs.projected),
        }
    })
}

impl RaysBackend for CubeBackend {
    fn tilt(inputs: ProjectInputs<Self>, spec: ProjectSpec) -> FloatTensor<Self> {
        let gpu = Gpu::new(&inputs.means.client);
        let tilts = launch_tilt(&gpu, &inputs.on_device(), &spec);
        tensor(tilts, [inputs.means.shape()[0], TILT], DType::F32, &inputs.means)
    }

    fn tilt_backward(
        inputs: ProjectInputs<Self>,
        grad: FloatTensor<Self>,
        spec: ProjectSpec,
        needs: ProjectNeeds,
    ) -> ProjectGrads<Self> {
        let gpu = Gpu::new(&inputs.means.client);
        let g = launch_tilt_backward(&gpu, &inputs.on_device(), &buffer(grad), &spec, needs);
        project_grads(g, inputs.means.shape()[0], &inputs.means)
    }

    fn outline(projected: FloatTensor<Self>, tilt: FloatTensor<Self>, spec: BlendSpec) -> FloatTensor<Self> {
        let gpu = Gpu::new(&projected.client);
        let rows = launch_outline(&gpu, &buffer(projected.clone()), &buffer(tilt), &spec);
        tensor(rows, projected.shape(), DType::F32, &projected)
    }

    fn rays(
        inputs: RaysInputs<Self>,
        _: FloatTensor<Self>,
        _: IntTensor<Self>,
        spec: BlendSpec,
        hits: HitCell,
        _: PartsCell,
    ) -> FloatTensor<Self> {
        let (gpu, on_device) = (Gpu::new(&inputs.projected.client), inputs.on_device());
        let planes = launch_rays(&gpu, &on_device, lists(&gpu, &hits, &on_device, &spec), &spec);
        let shape = [spec.planes(on_device.background.len), spec.intrinsics.height, spec.intrinsics.width];
        tensor(planes, shape, DType::F32, &inputs.projected)
    }

    fn rays_backward(
        inputs: RaysInputs<Self>,
        _: FloatTensor<Self>,
        grad: FloatTensor<Self>,
        spec: BlendSpec,
        needs: RaysNeeds,
        hits: HitCell,
    ) -> RaysGrads<Self> {
        let (gpu, on_device) = (Gpu::new(&inputs.projected.client), inputs.on_device());
        let lists = lists(&gpu, &hits, &on_device, &spec);
        let g = launch_rays_backward(&gpu, &on_device, &buffer(grad), lists, &spec, needs);
        let (count, channels) = (inputs.projected.shape()[0], on_device.background.len);
        let like = &inputs.projected;
        RaysGrads {
            projected: slot(g.projected, [count, COLUMNS], like),
            tilt: slot(g.tilt, [count, TILT], like),
            features: slot(g.features, [count, channels], like),
            background: slot(g.background, [channels], like),
            mean2d_abs: slot(g.mean2d_abs, [count, 2], like),
        }
    }
}

//! Subject of the measurements: a scene and views of it, on the measured device and in f64 on the CPU.

use anyhow::Result;
use burn::module::{Module, ModuleMapper, Param};
use burn::tensor::{DType, Device, Gradients, Tensor, TensorData};
use splat_model::capture::Photo;
use splat_model::gaussians::{DC, GaussianRows, Gaussians};
use splat_model::loss::{DEFAULT_LAMBDA, Truth, photometric};
use splat_op::{Camera, Extras, Intrinsics, RenderOptions, Rendered, Splats, render_view, with_gradient};

/// A scene and cameras on one device, in one float type.
pub struct DeviceScene {
    /// The parameters, tracked.
    pub gaussians: Gaussians,
    /// The splats, not tracked.
    pub splats: Splats,
    pub cameras: Vec<Camera>,
    pub background: [f32; 3],
    extras: Extras,
    pub device: Device,
    pub dtype: DType,
}

/// Names of the differentiated parameters.
pub const PARAMETERS: [&str; 5] = ["means", "rotations", "log_scales", "logit_opacities", "sh"];

/// Converts parameters to f64, tracked.
struct Wide;

impl ModuleMapper for Wide {
    fn map_float<const D: usize>(&mut self, param: Param<Tensor<D>>) -> Param<Tensor<D>> {
        Param::from_tensor(Tensor::from_inner(param.val().cast(DType::F64)))
    }
}

/// Gradients in the order of [`PARAMETERS`], summed over views.
pub type GradientSums = [Vec<f64>; 5];

impl DeviceScene {
    /// Prepares a scene as in training: f32 on any device.
    pub fn new(rows: &GaussianRows, photos: &[Photo], background: [f32; 3], device: &Device) -> Result<Self> {
        let gaussians = Gaussians::from_rows(rows, &device.clone().autodiff())?;
        let camera = |photo: &Photo| Camera::new(photo.intrinsics, &photo.cam_from_world, device);
        let colour = Some(Tensor::from_floats(background, device));
        Ok(Self {
            splats: gaussians.untracked().splats(),
            gaussians,
            cameras: photos.iter().map(camera).collect(),
            background,
            extras: Extras::default().with_background(colour),
            device: device.clone(),
            dtype: DType::F32,
        })
    }

    /// Prepares the same values, poses included, in f64 on the CPU. Rounding in f32 arithmetic is an error; rounding of its input is not.
    pub fn in_f64(rows: &GaussianRows, photos: &[Photo], background: [f32; 3]) -> Result<Self> {
        let f32 = Self::new(rows, photos, background, &Device::flex())?;
        let gaussians = f32.gaussians.untracked().map(&mut Wide);
        let camera = |camera: Camera| Camera { cam_from_world: camera.cam_from_world.cast(DType::F64), ..camera };
        let background = f32.extras.background.map(|background| background.cast(DType::F64));
        Ok(Self {
            splats: gaussians.untracked().splats(),
            gaussians,
            cameras: f32.cameras.into_iter().map(camera).collect(),
            extras: Extras::default().with_background(background),
            dtype: DType::F64,
            ..f32
        })
    }

    pub fn render(&self, view: usize, options: &RenderOptions) -> Result<Rendered<3>> {
        Ok(render_view(&self.splats, &self.cameras[view], &self.extras, options)?)
    }

    /// Renders a view, tracked, ready for [`Self::backward`].
    pub fn tracked(&self, view: usize, options: &RenderOptions) -> Result<Rendered<3>> {
        Ok(render_view(&self.gaussians.splats(), &self.cameras[view], &self.extras, options)?)
    }

    /// Returns the gradients of `Σ colour · cotangent`, `[H, W, 3]` each.
    pub fn backward(&self, picture: Rendered<3>, cotangent: Tensor<3>) -> Gradients {
        let value = Tensor::<1>::zeros([1], (&self.device, self.dtype));
        with_gradient(picture.colour, value, cotangent).backward()
    }

    /// Adds a view's gradients to `sums`, which are empty at first.
    pub fn add_gradients(&self, gradients: &Gradients, sums: &mut GradientSums) {
        let all = PARAMETERS.map(|name| {
            let blocks = self.gaussians.group(name)?.blocks().map(|block| block.grad(gradients).map(host));
            Some(blocks.collect::<Option<Vec<_>>>()?.concat())
        });
        for (sum, found) in sums.iter_mut().zip(all) {
            let found = found.unwrap_or_default();
            sum.resize(sum.len().max(found.len()), 0.0);
            sum.iter_mut().zip(found).for_each(|(sum, found)| *sum += found);
        }
    }

    /// Returns the values of a view's picture, `[H, W, 3]`, as a tensor on this device.
    pub fn picture(&self, view: usize, values: &[f32]) -> Tensor<3> {
        let Intrinsics { width, height, .. } = self.cameras[view].intrinsics;
        Tensor::from_data(TensorData::new(values.to_vec(), [height, width, 3]), (&self.device, self.dtype))
    }
}

/// Colours of degree 0 closer to zero than this are treated as below zero.
const AT_THE_CLAMP: f32 = 1e-6;

/// Returns the rows with colour channels that lie at the clamp to zero moved below it by ten times [`AT_THE_CLAMP`],
/// which no picture shows. The gradient jumps at the clamp, and rounding decides on the side: f32 and f64 would differ
/// by the whole jump, which would hide the effect of dials. Points that are black in a channel begin there.
pub fn off_the_clamp(rows: &GaussianRows) -> GaussianRows {
    let (mut rows, dc) = (rows.clone(), DC as f32);
    for channel in rows.sh_dc.as_flattened_mut() {
        if (dc * *channel + 0.5).abs() < AT_THE_CLAMP {
            *channel -= 10.0 * AT_THE_CLAMP / dc;
        }
    }
    rows
}

/// Returns the cotangent of the picture `exact` of a photograph, `[H, W, 3]`: the derivative of the training loss there, times the number of
/// values. In f32, so that every device gets the same values.
pub fn cotangent(photo: &Photo, exact: &[f64], background: [f32; 3]) -> Vec<f32> {
    let Intrinsics { width, height, .. } = photo.intrinsics;
    let device = Device::flex();
    let truth = Truth::new(photo.rgb_over(background, &device).cast(DType::F64));
    let image =
        Tensor::<3>::from_data(TensorData::new(exact.to_vec(), [height, width, 3]), (&device.autodiff(), DType::F64));
    let image = image.require_grad();
    let gradient = image.grad(&photometric(image.clone(), &truth, DEFAULT_LAMBDA).backward());
    let values = gradient.map(host).unwrap_or_else(|| vec![0.0; exact.len()]);
    values.iter().map(|value| (value * exact.len() as f64) as f32).collect()
}

/// Returns a tensor's values; f32 values are converted exactly.
pub fn host<const D: usize>(tensor: Tensor<D>) -> Vec<f64> {
    tensor.into_data().iter::<f64>().collect()
}

#[cfg(test)]
mod tests;

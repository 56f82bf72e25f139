//! The photometric loss as operations. Its derivative is computed with it and attached by the caller.

use burn::tensor::Shape;

use super::cpu::{moments_cpu, photometric_cpu};
#[cfg(feature = "cube")]
use super::launch::{launch_moments, launch_photometric};
use super::sweep::PlaneSize;
use super::taps::Compared;
use crate::backend::*;

/// Returns width and height, which are the last two dimensions in reverse order.
fn picture_size(shape: &Shape) -> [usize; 2] {
    let rank = shape.num_dims();
    [shape[rank - 1], shape[rank - 2]]
}

fn plane_size(shape: &Shape) -> PlaneSize {
    let [width, height] = picture_size(shape);
    PlaneSize { width, height }
}

/// `(1 − λ) |x − y| + λ (1 − S)`, divided by the number of values, `[1]`, and its derivative, if asked for.
#[derive(Clone, Debug)]
pub(super) struct Photometric {
    pub lambda: f64,
    pub with_gradient: bool,
}

impl Operation for Photometric {
    fn outputs(&self, inputs: &[Option<Spec>]) -> Vec<Option<Spec>> {
        let image = inputs[0].clone();
        vec![image.as_ref().map(|image| image.with_shape([1])), image.filter(|_| self.with_gradient)]
    }

    fn run<F: Real>(&self, args: &HostArgs) -> Vec<HostOutput> {
        let read = args.all::<F, 4>();
        let inputs = Compared::from_array(slices(&read));
        let (loss, gradient) = photometric_cpu(inputs, plane_size(&args.shape(0)), self.lambda, self.with_gradient);
        vec![HostOutput::floats(vec![loss]), gradient.map_or(HostOutput::Nothing, HostOutput::floats)]
    }

    #[cfg(feature = "cube")]
    fn launch(&self, args: GpuArgs) -> Vec<GpuOutput> {
        let (inputs, size) = (Compared::from_array(args.all()), picture_size(&args.shape(0)));
        let (loss, gradient) = launch_photometric(&args.gpu(), &inputs, size, self.lambda, self.with_gradient);
        gpu_outputs([Some(loss), gradient])
    }
}

/// What the loss needs of a photograph besides its planes, each of their shape: `μy` and `σy² + C2`.
#[derive(Clone, Debug)]
pub(super) struct PhotographMoments;

impl Operation for PhotographMoments {
    fn outputs(&self, inputs: &[Option<Spec>]) -> Vec<Option<Spec>> {
        vec![inputs[0].clone(); 2]
    }

    fn run<F: Real>(&self, args: &HostArgs) -> Vec<HostOutput> {
        float_outputs(moments_cpu::<F>(&args.floats(0), plane_size(&args.shape(0))))
    }

    #[cfg(feature = "cube")]
    fn launch(&self, args: GpuArgs) -> Vec<GpuOutput> {
        gpu_outputs(launch_moments(&args.gpu(), &args.buffer(0), picture_size(&args.shape(0))))
    }
}

/// The same values in contiguous memory.
#[derive(Clone, Debug)]
pub(super) struct Contiguous;

impl Operation for Contiguous {
    fn run<F: Real>(&self, _: &HostArgs) -> Vec<HostOutput> {
        vec![HostOutput::Input(0)]
    }

    #[cfg(feature = "cube")]
    fn launch(&self, args: GpuArgs) -> Vec<GpuOutput> {
        vec![Some(args.handle(0))]
    }
}

//! An operation of one's own in a graph of Burn: a kernel, its CPU twin, and their gradient.

use burn::tensor::{Device, DeviceType, Tensor};
use cubecl::prelude::*;
use splat_op::backend::{GpuArgs, GpuOutput, HostArgs, HostOutput, Operation, Real, apply};

/// Reinhard's tone curve, `y = x / (1 + x)`, whose derivative is `(1 + x)⁻²`.
#[derive(Clone, Debug)]
struct ToneCurve;

#[cube(launch_unchecked)]
fn curve(x: &[f32], y: &mut [f32]) {
    if ABSOLUTE_POS < y.len() {
        y[ABSOLUTE_POS] = x[ABSOLUTE_POS] / (1.0 + x[ABSOLUTE_POS]);
    }
}

#[cube(launch_unchecked)]
fn slope(x: &[f32], grad: &[f32], out: &mut [f32]) {
    if ABSOLUTE_POS < out.len() {
        let sum = 1.0 + x[ABSOLUTE_POS];
        out[ABSOLUTE_POS] = grad[ABSOLUTE_POS] / (sum * sum);
    }
}

impl Operation for ToneCurve {
    const DIFFERENTIABLE: &'static [usize] = &[0];

    fn run<F: Real>(&self, args: &HostArgs) -> Vec<HostOutput> {
        vec![HostOutput::floats(args.floats::<F>(0).iter().map(|&x| x / (F::ONE + x)).collect())]
    }

    fn launch(&self, args: GpuArgs) -> Vec<GpuOutput> {
        let (len, x) = (args.shape(0).num_elements(), args.handle(0));
        let (count, dim, y) = (cubes(len), CubeDim::new_1d(256), args.client().empty(4 * len));
        // SAFETY: both have this many elements, and the kernel keeps within them.
        let [x, out] = [x, y.clone()].map(|handle| unsafe { BufferArg::from_raw_parts(handle, len) });
        unsafe { curve::launch_unchecked(args.client(), count, dim, x, out) };
        vec![Some(y)]
    }

    fn run_backward<F: Real>(&self, args: &HostArgs) -> Vec<HostOutput> {
        let (x, grad) = (args.floats::<F>(0), args.only_grad::<F>());
        let slope = |(&x, &grad): (&F, &F)| grad / ((F::ONE + x) * (F::ONE + x));
        vec![HostOutput::floats(x.iter().zip(grad.iter()).map(slope).collect())]
    }

    fn launch_backward(&self, args: GpuArgs) -> Vec<GpuOutput> {
        let (len, x, grad) = (args.shape(0).num_elements(), args.handle(0), args.grad_handle(0));
        let (count, dim, out) = (cubes(len), CubeDim::new_1d(256), args.client().empty(4 * len));
        // SAFETY: as forwards; a gradient has the shape of its output.
        let [x, grad, to] = [x, grad, out.clone()].map(|handle| unsafe { BufferArg::from_raw_parts(handle, len) });
        unsafe { slope::launch_unchecked(args.client(), count, dim, x, grad, to) };
        vec![Some(out)]
    }
}

fn cubes(len: usize) -> CubeCount {
    CubeCount::Static(len.div_ceil(256) as u32, 1, 1)
}

fn main() {
    let gpu = Device::enumerate(DeviceType::Wgpu).into_vec().into_iter().take(1);
    for device in [Device::flex()].into_iter().chain(gpu) {
        let x = Tensor::<2>::from_floats([[0.0, 0.5, 1.0], [3.0, 7.0, 1e3]], &device.clone().autodiff()).require_grad();
        let y: Tensor<2> = apply(ToneCurve, [(&x).into()]).float(0);
        let grad = x.grad(&(y.clone() * 2.0).sum().backward()).expect("tracked");
        y.into_data()
            .assert_approx_eq::<f32>(&[[0.0, 1.0 / 3.0, 0.5], [0.75, 0.875, 1e3 / 1001.0]].into(), Default::default());
        let slopes = [[2.0, 8.0 / 9.0, 0.5], [0.125, 0.03125, 2.0 / 1001.0f32.powi(2)]];
        grad.into_data().assert_approx_eq::<f32>(&slopes.into(), Default::default());
        println!("the curve and its gradient agree with their formulas on {device:?}");
    }
}

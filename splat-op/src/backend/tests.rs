//! Operations of several outputs, whose gradients are asked for in part.

use burn::tensor::{Device, Tensor};

use super::*;

/// Twice the first input and three times the second.
#[derive(Clone, Debug)]
struct Multiples;

const FACTORS: [f32; 2] = [2.0, 3.0];

impl Operation for Multiples {
    const DIFFERENTIABLE: &'static [usize] = &[0, 1];

    fn outputs(&self, inputs: &[Option<Spec>]) -> Vec<Option<Spec>> {
        inputs.to_vec()
    }

    fn run<F: Real>(&self, _: &HostArgs) -> Vec<HostOutput> {
        [0, 1].map(|i| HostOutput::Scaled(i, FACTORS[i].into())).into()
    }

    #[cfg(feature = "cube")]
    fn launch(&self, args: GpuArgs) -> Vec<GpuOutput> {
        [0, 1].map(|i| Some(times(args.tensor(i).clone(), FACTORS[i]))).into()
    }

    fn depends(&self, output: usize, input: usize) -> bool {
        output == input
    }

    fn run_backward<F: Real>(&self, args: &HostArgs) -> Vec<HostOutput> {
        let scaled = |i: usize, grad: Host<F>| grad.iter().map(|&grad| F::of(FACTORS[i].into()) * grad).collect();
        let of_input =
            |i: usize| args.grad(i).map_or(HostOutput::Nothing, |grad| HostOutput::floats::<F>(scaled(i, grad)));
        [0, 1].map(of_input).into()
    }

    #[cfg(feature = "cube")]
    fn launch_backward(&self, args: GpuArgs) -> Vec<GpuOutput> {
        [0, 1].map(|i| args.grad(i).map(|grad| times(grad, FACTORS[i]))).into()
    }
}

#[cfg(feature = "cube")]
fn times(values: burn_cubecl::tensor::CubeTensor, factor: f32) -> cubecl::server::Handle {
    use burn::backend::ops::FloatTensorOps;

    burn_cubecl::CubeBackend::float_mul_scalar(values, factor.into()).handle
}

fn devices() -> Vec<Device> {
    #[cfg(feature = "cube")]
    return [Device::flex()].into_iter().chain(crate::testing::gpu::device()).collect();
    #[cfg(not(feature = "cube"))]
    vec![Device::flex()]
}

#[test]
fn each_output_passes_its_gradient_to_what_it_depends_on() {
    for device in devices() {
        let tracked = || Tensor::<1>::from_floats([1.0, -2.0], &device.clone().autodiff()).require_grad();
        let values = |tensor: Option<Tensor<1>>| tensor.map(|tensor| tensor.into_data().try_to_vec::<f32>().unwrap());
        // Which outputs the loss reads, and how often.
        for [first, second] in [[1, 0], [0, 1], [1, 1], [2, 3]] {
            let (a, b) = (tracked(), tracked());
            let mut found = apply(Multiples, [(&a).into(), (&b).into()]);
            let (twice, thrice): (Tensor<1>, Tensor<1>) = (found.float(0), found.float(1));
            assert_eq!(values(Some(twice.clone().inner())), Some(vec![2.0, -4.0]), "{device:?}");
            let read = std::iter::repeat_n(twice, first).chain(std::iter::repeat_n(thrice, second));
            let grads = read.reduce(|sum, output| sum + output).unwrap().sum().backward();
            let expected = |count: usize, factor: f32| (count > 0).then(|| vec![factor * count as f32; 2]);
            assert_eq!(values(a.grad(&grads)), expected(first, 2.0), "{device:?}: {first} and {second}");
            assert_eq!(values(b.grad(&grads)), expected(second, 3.0), "{device:?}: {first} and {second}");
        }
    }
}

/// States two elements and makes one.
#[derive(Clone, Debug)]
struct Short;

impl Operation for Short {
    fn run<F: Real>(&self, _: &HostArgs) -> Vec<HostOutput> {
        vec![HostOutput::floats(vec![F::ONE])]
    }
}

#[test]
#[should_panic(expected = "invalid for input of size 4")]
fn an_output_of_another_length_than_stated_is_refused() {
    let _ = apply(Short, [Tensor::<1>::zeros([2], &Device::flex()).into()]);
}

//! Adam's step with packed moments as an operation on GPUs.

#![cfg_attr(not(feature = "cube"), allow(dead_code, reason = "kernels read the fields"))]

#[cfg(feature = "cube")]
use burn::backend::TensorMetadata;

#[cfg(feature = "cube")]
use super::launch::{DevicePackedStep, launch_adam_packed};
use super::{PackedFactors, words_per_row};
#[cfg(feature = "cube")]
use crate::adam::operation::{unsigned, verdict};
#[cfg(feature = "cube")]
use crate::backend::cube::{buffer, owned};
use crate::backend::*;

/// One step of a parameter with packed moments, unless the verdict names a step. Takes the parameter, its gradient, the moments,
/// `[N, words]`, and, optionally, the verdict; returns the parameter and the moments.
#[derive(Clone, Debug)]
pub(super) struct AdamPacked(pub PackedFactors);

impl Operation for AdamPacked {
    fn outputs(&self, inputs: &[Option<Spec>]) -> Vec<Option<Spec>> {
        assert_eq!(inputs[0], inputs[1], "a gradient has the shape of its parameter");
        let shapes = [0, 2].map(|i| inputs[i].as_ref().map_or(&[][..], |spec| spec.shape.as_slice()));
        let words = |rows: &[usize]| [rows[0], words_per_row(rows[1..].iter().product())];
        assert_eq!(shapes[1], words(shapes[0]), "the moments have the rows of their parameter");
        vec![inputs[0].clone(), inputs[2].clone()]
    }

    #[cfg(feature = "cube")]
    fn launch(&self, mut args: GpuArgs) -> Vec<GpuOutput> {
        let (gpu, verdict, grad) = (args.gpu(), verdict(&args, 3), args.buffer(1));
        let (param, words) = (owned(args.take(0)), owned(args.take(2)));
        let shape = param.shape();
        let dims = shape.as_slice();
        let step = DevicePackedStep {
            grad,
            words: unsigned(&words, words.shape().num_elements()),
            factors: self.0,
            band: self.0.factors.rate.band(dims),
            width: dims[1..].iter().product(),
            param: buffer(param),
        };
        launch_adam_packed(&gpu, &step, verdict.as_ref());
        vec![Some(step.param.handle), Some(words.handle)]
    }
}

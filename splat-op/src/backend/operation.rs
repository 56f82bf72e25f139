//! The one form of every operation: shapes, a CPU twin, kernels and a gradient.

use std::fmt::Debug;
use std::sync::Arc;

use burn::tensor::{DType, Shape};

use super::args::Args;
#[cfg(feature = "cube")]
use super::cube::{GpuArgs, GpuOutput};
use super::host::{HostArgs, HostOutput};
use crate::simd::{Real, f32_in_f64};

/// The largest number of inputs that an operation has gradients of.
pub const MAX_DIFFERENTIABLE: usize = 8;

/// Shape and type of a tensor.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Spec {
    /// The shape.
    pub shape: Shape,
    /// The type of the elements.
    pub dtype: DType,
}

impl Spec {
    /// Returns the specification of a tensor of another shape and the same type.
    pub fn with_shape<const D: usize>(&self, shape: [usize; D]) -> Self {
        Self { shape: Shape::from(shape), dtype: self.dtype }
    }

    /// Returns the specification of integers, i32.
    pub fn ints<const D: usize>(shape: [usize; D]) -> Self {
        Self { shape: Shape::from(shape), dtype: DType::I32 }
    }
}

/// An operation on tensors, run by [`apply`](super::apply).
///
/// A value holds what is not a tensor: sizes, options, caches. Inputs and outputs are lists; a place in them may be empty. A CPU calls the
/// twin [`run`](Self::run) in f32 or in f64, which is the type of the inputs; a GPU calls [`launch`](Self::launch). With Burn's fusion both
/// run later than [`apply`](super::apply), on the device's own thread.
pub trait Operation: Clone + Debug + Send + Sync + 'static {
    /// The inputs that gradients flow to, at most [`MAX_DIFFERENTIABLE`].
    const DIFFERENTIABLE: &'static [usize] = &[];
    /// Whether the backward pass is given the outputs. They are kept until then.
    const KEEPS_OUTPUTS: bool = false;

    /// Returns the specification of each output from those of the inputs. By default there is one, as the first input.
    fn outputs(&self, inputs: &[Option<Spec>]) -> Vec<Option<Spec>> {
        inputs[..1].to_vec()
    }

    /// Computes the outputs on the CPU.
    fn run<F: Real>(&self, _args: &HostArgs) -> Vec<HostOutput> {
        unreachable!("{self:?} has no CPU twin: its caller asks for the device")
    }

    /// Computes the outputs on the GPU.
    #[cfg(feature = "cube")]
    fn launch(&self, _args: GpuArgs) -> Vec<GpuOutput> {
        unreachable!("{self:?} has no kernel: its caller asks for the device")
    }

    /// Returns the inputs that gradients flow to. All of them must be present.
    fn differentiable(&self) -> &'static [usize] {
        Self::DIFFERENTIABLE
    }

    /// Whether a gradient of `output` gives one of `input`, where outputs are functions of different inputs.
    fn depends(&self, _output: usize, _input: usize) -> bool {
        true
    }

    /// Returns the operation to run if an input is tracked: one that keeps what its backward pass would compute again.
    fn tracked(&self) -> Self {
        self.clone()
    }

    /// Computes the gradients of the inputs on the CPU, one for each; those that are not needed are dropped. `args` has the gradients of
    /// the outputs.
    fn run_backward<F: Real>(&self, _args: &HostArgs) -> Vec<HostOutput> {
        unreachable!("{self:?} names no differentiable input")
    }

    /// Computes the gradients of the inputs on the GPU, as [`run_backward`](Self::run_backward).
    #[cfg(feature = "cube")]
    fn launch_backward(&self, _args: GpuArgs) -> Vec<GpuOutput> {
        unreachable!("{self:?} names no differentiable input")
    }
}

/// An operation of any type.
pub(super) trait Erased: Debug + Send + Sync {
    fn outputs(&self, inputs: &[Option<Spec>]) -> Vec<Option<Spec>>;
    fn run(&self, args: &HostArgs, backward: bool) -> Vec<HostOutput>;
    #[cfg(feature = "cube")]
    fn launch(&self, args: GpuArgs, backward: bool) -> Vec<GpuOutput>;
    fn differentiable(&self) -> &'static [usize];
    fn depends(&self, output: usize, input: usize) -> bool;
    fn keeps_outputs(&self) -> bool;
    fn tracked(&self) -> Arc<dyn Erased>;
}

impl<O: Operation> Erased for O {
    fn outputs(&self, inputs: &[Option<Spec>]) -> Vec<Option<Spec>> {
        Operation::outputs(self, inputs)
    }

    fn run(&self, args: &HostArgs, backward: bool) -> Vec<HostOutput> {
        if args.holds(DType::F32) && f32_in_f64() {
            return Erased::run(self, &args.widened(), backward).into_iter().map(HostOutput::narrowed).collect();
        }
        match (args.holds(DType::F64), backward) {
            (false, false) => Operation::run::<f32>(self, args),
            (false, true) => self.run_backward::<f32>(args),
            (true, false) => Operation::run::<f64>(self, args),
            (true, true) => self.run_backward::<f64>(args),
        }
    }

    #[cfg(feature = "cube")]
    fn launch(&self, args: GpuArgs, backward: bool) -> Vec<GpuOutput> {
        if backward { self.launch_backward(args) } else { Operation::launch(self, args) }
    }

    fn differentiable(&self) -> &'static [usize] {
        Operation::differentiable(self)
    }

    fn depends(&self, output: usize, input: usize) -> bool {
        Operation::depends(self, output, input)
    }

    fn keeps_outputs(&self) -> bool {
        Self::KEEPS_OUTPUTS
    }

    fn tracked(&self) -> Arc<dyn Erased> {
        Arc::new(Operation::tracked(self))
    }
}

/// The forward or the backward pass of an operation.
#[derive(Clone, Debug)]
pub struct Call {
    pub(super) operation: Arc<dyn Erased>,
    pub(super) backward: Option<Backwards>,
}

/// How the inputs of a backward pass are listed: the operation's inputs, its outputs if it keeps them, and the gradients of its outputs.
#[derive(Clone, Debug)]
pub(super) struct Backwards {
    /// Number of the operation's outputs.
    pub outputs: usize,
    /// For each input, whether its gradient is asked for.
    pub needs: Vec<bool>,
}

impl Call {
    /// Returns the specification of each output, from those of the tensors that the call is given.
    pub(super) fn outputs(&self, given: &[Option<Spec>]) -> Vec<Option<Spec>> {
        let Some(Backwards { needs, .. }) = &self.backward else { return self.operation.outputs(given) };
        let grads = given.iter().skip(needs.len()).flatten();
        let dtype = grads.map(|spec| spec.dtype).find(|dtype| dtype.is_float()).expect("a gradient is given");
        let of_input = |(spec, &needed): (&Option<Spec>, &bool)| {
            spec.as_ref().filter(|_| needed).map(|spec| Spec { shape: spec.shape.clone(), dtype })
        };
        given.iter().zip(needs).map(of_input).collect()
    }

    /// Splits what the call is given into inputs, outputs and gradients of outputs.
    pub(super) fn args<T>(&self, given: Vec<Option<T>>) -> Args<T> {
        let mut given = given.into_iter();
        let Some(Backwards { needs, outputs }) = &self.backward else {
            return Args { inputs: given.collect(), outputs: Vec::new(), grads: Vec::new(), needs: Vec::new() };
        };
        let inputs = given.by_ref().take(needs.len()).collect();
        let kept = if self.operation.keeps_outputs() { *outputs } else { 0 };
        let outputs = given.by_ref().take(kept).collect();
        Args { inputs, outputs, grads: given.collect(), needs: needs.clone() }
    }
}

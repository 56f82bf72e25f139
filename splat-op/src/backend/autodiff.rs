//! The backward node of every operation. A backward pass computes only the gradients of tracked inputs.

use std::array;
use std::fmt::{self, Debug, Formatter};
use std::sync::{Arc, Mutex, PoisonError};

use burn::backend::autodiff::checkpoint::base::Checkpointer;
use burn::backend::autodiff::checkpoint::strategy::{CheckpointStrategy, NoCheckpointing};
use burn::backend::autodiff::grads::Gradients;
use burn::backend::autodiff::ops::{Backward, Ops, OpsKind};
use burn::backend::tensor::FloatTensor;
use burn::backend::{Autodiff, Backend};

use super::apply::OperationBackend;
use super::list::{List, Slot, Tensors};
use super::operation::{Backwards, Call, MAX_DIFFERENTIABLE};

/// A tensor of any [`Autodiff`] over `B`.
type AutodiffTensor<B> = FloatTensor<Autodiff<B>>;

/// Gradients of an operation's outputs. A gradient that is missing is zero.
type Grads<B> = Arc<Mutex<Vec<Option<FloatTensor<B>>>>>;

fn put<B: Backend>(grads: &Grads<B>, output: usize, grad: FloatTensor<B>) {
    grads.lock().unwrap_or_else(PoisonError::into_inner)[output] = Some(grad);
}

/// State of an operation's node.
#[derive(Clone)]
struct NodeState<B: Backend> {
    call: Call,
    inputs: Vec<Slot<B>>,
    /// Empty if the operation keeps none.
    outputs: Vec<Slot<B>>,
    grads: Grads<B>,
    /// Whether the node is that of the one output. Several outputs have nodes of their own, which pass their gradients to this one
    /// outside the graph: one pass computes with all of them.
    single: bool,
}

impl<B: Backend> Debug for NodeState<B> {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        write!(f, "{:?}", self.call)
    }
}

/// The node of an operation.
#[derive(Debug)]
struct Node;

impl<B: OperationBackend> Backward<B, MAX_DIFFERENTIABLE> for Node {
    type State = NodeState<B>;

    fn backward(self, ops: Ops<NodeState<B>, MAX_DIFFERENTIABLE>, grads: &mut Gradients, _: &mut Checkpointer) {
        let NodeState { call, inputs, outputs, grads: of_outputs, single } = ops.state;
        if single {
            put::<B>(&of_outputs, 0, grads.consume::<B>(&ops.node));
        }
        let of_outputs = std::mem::take(&mut *of_outputs.lock().unwrap_or_else(PoisonError::into_inner));
        let differentiable = call.operation.differentiable();
        let reached =
            |input| (0..of_outputs.len()).any(|i| of_outputs[i].is_some() && call.operation.depends(i, input));
        let mut needs = vec![false; inputs.len()];
        for (&input, parent) in differentiable.iter().zip(&ops.parents) {
            needs[input] = parent.is_some() && reached(input);
        }
        if !needs.contains(&true) {
            return;
        }
        let backward = Some(Backwards { outputs: of_outputs.len(), needs });
        let of_outputs = of_outputs.into_iter().map(|grad| grad.map_or(Slot::Absent, Slot::Float));
        let given = inputs.into_iter().chain(outputs).chain(of_outputs).collect();
        let mut found = B::operate(List(given), Call { backward, ..call }).0;
        for (&input, parent) in differentiable.iter().zip(ops.parents) {
            let grad = std::mem::replace(&mut found[input], Slot::Absent);
            if let (Some(parent), Slot::Float(grad)) = (parent, grad) {
                grads.register::<B>(parent.id, grad);
            }
        }
    }
}

/// The node of one of several outputs.
#[derive(Debug)]
struct PartNode;

/// Which output, and where its gradient goes.
#[derive(Clone)]
struct PartState<B: Backend>(usize, Grads<B>);

impl<B: Backend> Debug for PartState<B> {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        write!(f, "PartState({})", self.0)
    }
}

impl<B: Backend> Backward<B, 1> for PartNode {
    type State = PartState<B>;

    fn backward(self, ops: Ops<PartState<B>, 1>, grads: &mut Gradients, _: &mut Checkpointer) {
        let PartState(output, of_outputs) = ops.state;
        put::<B>(&of_outputs, output, grads.consume::<B>(&ops.node));
    }
}

fn constant<B: Backend>(slot: Slot<B>) -> Slot<Autodiff<B>> {
    match slot {
        Slot::Absent => Slot::Absent,
        Slot::Float(tensor) => Slot::Float(AutodiffTensor::<B>::new(tensor)),
        Slot::Int(tensor) => Slot::Int(tensor),
    }
}

fn without_autodiff<B: Backend>(slot: &Slot<Autodiff<B>>) -> Slot<B> {
    match slot {
        Slot::Absent => Slot::Absent,
        Slot::Float(tensor) => Slot::Float(tensor.primitive().clone()),
        Slot::Int(tensor) => Slot::Int(tensor.clone()),
    }
}

/// Returns the tensors for another strategy of checkpoints; they are the same.
fn recast<B: Backend, Old: CheckpointStrategy, New: CheckpointStrategy>(
    tensors: Tensors<Autodiff<B, Old>>,
) -> Tensors<Autodiff<B, New>> {
    let same = |slot| match slot {
        Slot::Absent => Slot::Absent,
        Slot::Float(tensor) => Slot::Float(tensor),
        Slot::Int(tensor) => Slot::Int(tensor),
    };
    List(tensors.0.into_iter().map(same).collect())
}

impl<B: OperationBackend, C: CheckpointStrategy> OperationBackend for Autodiff<B, C> {
    fn operate(inputs: Tensors<Self>, call: Call) -> Tensors<Self> {
        recast(tracked::<B>(recast(inputs), call))
    }
}

/// Runs a pass, with a node if an input is tracked. Operations are not computed again, whatever the strategy of checkpoints.
fn tracked<B: OperationBackend>(inputs: Tensors<Autodiff<B>>, call: Call) -> Tensors<Autodiff<B>> {
    let differentiable = call.operation.differentiable();
    // Backward passes are not themselves differentiable.
    let parents: Vec<AutodiffTensor<B>> = match call.backward {
        None => differentiable.iter().filter_map(|&input| inputs.0[input].clone().float()).collect(),
        Some(_) => Vec::new(),
    };
    let inner: Vec<Slot<B>> = inputs.0.iter().map(without_autodiff).collect();
    drop(inputs);
    let Some(first) = parents.first().map(|tensor| tensor.primitive().clone()) else {
        return List(B::operate(List(inner), call).0.into_iter().map(constant).collect());
    };
    assert_eq!(parents.len(), differentiable.len(), "differentiable inputs are present");
    assert!(
        parents.len() <= MAX_DIFFERENTIABLE,
        "gradients of {} inputs of at most {MAX_DIFFERENTIABLE}",
        parents.len()
    );
    // Burn's nodes have a fixed number of parents; those that are missing are constants.
    let nodes = array::from_fn(|i| match parents.get(i) {
        Some(parent) => parent.node(),
        None => AutodiffTensor::<B>::new(first.clone()).node(),
    });
    drop((parents, first));
    let prep = match Node.prepare::<NoCheckpointing>(nodes).compute_bound().stateful() {
        OpsKind::Tracked(prep) => prep,
        OpsKind::UnTracked(_) => {
            return List(B::operate(List(inner), call).0.into_iter().map(constant).collect());
        }
    };
    let call = Call { operation: call.operation.tracked(), backward: None };
    let outputs = B::operate(List(inner.clone()), call.clone()).0;
    let kept = if call.operation.keeps_outputs() { outputs.clone() } else { Vec::new() };
    let grads: Grads<B> = Arc::new(Mutex::new(vec![None; outputs.len()]));
    let single = outputs.len() == 1;
    let state = NodeState { call, inputs: inner, outputs: kept, grads: grads.clone(), single };
    let first = outputs.iter().find_map(|slot| slot.clone().float()).expect("a differentiable output");
    let node = prep.finish(state, first);
    if single {
        return List(vec![Slot::Float(node)]);
    }
    let part = |(i, output): (usize, Slot<B>)| match output {
        Slot::Float(tensor) => match PartNode.prepare::<NoCheckpointing>([node.node()]).compute_bound().stateful() {
            OpsKind::Tracked(prep) => Slot::Float(prep.finish(PartState(i, grads.clone()), tensor)),
            OpsKind::UnTracked(prep) => Slot::Float(prep.finish(tensor)),
        },
        other => constant(other),
    };
    List(outputs.into_iter().enumerate().map(part).collect())
}

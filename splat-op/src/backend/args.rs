//! What a pass of an operation is given, on a CPU or a GPU.

use std::array;

/// The tensors that a pass is given. The methods panic where there is no such tensor.
pub struct Args<T> {
    pub(super) inputs: Vec<Option<T>>,
    pub(super) outputs: Vec<Option<T>>,
    pub(super) grads: Vec<Option<T>>,
    /// In a backward pass, for each input whether its gradient is asked for.
    pub(super) needs: Vec<bool>,
}

impl<T> Args<T> {
    /// Whether there is input `i`.
    pub fn has(&self, i: usize) -> bool {
        self.inputs[i].is_some()
    }

    /// In a backward pass, returns for each input whether its gradient is asked for.
    pub fn needs<const N: usize>(&self) -> [bool; N] {
        array::from_fn(|i| self.needs[i])
    }

    /// All tensors.
    pub(super) fn all_present(&self) -> impl Iterator<Item = &T> {
        self.inputs.iter().chain(&self.outputs).chain(&self.grads).flatten()
    }
}

use super::*;

impl<const D: usize> ColourMaps<D> {
    /// The penalty for a step on a photograph.
    pub fn pulled(&mut self, view: usize) -> Tensor<1> {
        self.pull(view)
    }

    /// The tracked map of a photograph.
    pub fn tracked(&mut self, view: usize) -> Tensor<D> {
        self.all[view].tracked()
    }

    /// The map of a photograph without autodiff.
    pub fn value(&self, view: usize) -> Tensor<D> {
        self.all[view].value()
    }

    /// The map that changes nothing.
    pub fn neutral(&self) -> Tensor<D> {
        self.kind.neutral.clone()
    }
}

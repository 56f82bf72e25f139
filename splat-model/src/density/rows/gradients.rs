//! Gradients of a scene's parameters.

use burn::module::Param;
use burn::tensor::Tensor;

use crate::gaussians::{Gaussians, Group, joined};

/// Gradients of a scene's groups, without autodiff, in the order of [`Gaussians::groups`].
#[derive(Clone, Debug, Default)]
pub struct Gradients(pub Vec<GroupGradients>);

/// The gradients of a group.
#[derive(Clone, Debug)]
pub struct GroupGradients {
    /// Name of the group.
    pub name: String,
    /// `[n, width]`: one for each block of consecutive rows, of which there is one unless a tensor would be too large. `None` where
    /// the loss does not depend on the block.
    pub blocks: Vec<Option<Tensor<2>>>,
}

impl Gradients {
    /// Removes the gradients of a scene's parameters from the gradients of a loss.
    pub fn take(gaussians: &Gaussians, grads: &mut burn::tensor::Gradients) -> Self {
        let mut of = |block: &Param<Tensor<2>>| block.val().grad_remove(grads);
        let mut of_group = |group: &Group| GroupGradients {
            name: group.name().to_owned(),
            blocks: group.blocks.iter().map(&mut of).collect(),
        };
        Self(gaussians.groups().iter().map(&mut of_group).collect())
    }

    /// Sets the gradient of the group of that name, `[N, …]`, as one block.
    pub fn with<const D: usize>(mut self, name: &str, values: Tensor<D>) -> Self {
        let rows = values.dims()[0];
        let width = values.dims()[1..].iter().product::<usize>();
        let group = GroupGradients { name: name.to_owned(), blocks: vec![Some(values.reshape([rows, width]))] };
        self.0.retain(|other| other.name != name);
        self.0.push(group);
        self
    }

    /// `[N, width]`: the gradient of the group of that name, if it has one.
    pub fn get(&self, name: &str) -> Option<Tensor<2>> {
        let group = self.0.iter().find(|group| group.name == name)?;
        Some(joined(group.blocks.iter().cloned().collect::<Option<_>>()?))
    }

    /// All gradients with the names of their groups, block by block.
    pub(crate) fn blocks(&self) -> impl Iterator<Item = (&str, Option<&Tensor<2>>)> {
        self.0.iter().flat_map(|group| group.blocks.iter().map(|block| (&*group.name, block.as_ref())))
    }

    /// The sum of both, which are gradients of one scene. `None` counts as zero.
    pub fn plus(mut self, other: Self) -> Self {
        for group in other.0 {
            let Some(own) = self.0.iter_mut().find(|own| own.name == group.name) else {
                self.0.push(group);
                continue;
            };
            for (own, block) in own.blocks.iter_mut().zip(group.blocks) {
                *own = match (own.take(), block) {
                    (Some(a), Some(b)) => Some(a + b),
                    (a, b) => a.or(b),
                };
            }
        }
        self
    }

    /// The gradients multiplied by a factor.
    pub fn times(mut self, factor: f64) -> Self {
        let blocks = self.0.iter_mut().flat_map(|group| &mut group.blocks);
        blocks.for_each(|block| *block = block.take().map(|grad| grad * factor));
        self
    }
}

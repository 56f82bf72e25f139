//! Gradients of a scene's parameters.

use burn::tensor::Tensor;

use crate::gaussians::Gaussians;

/// Gradients of a scene's parameters, without autodiff. `None` where the loss does not depend on a parameter.
#[derive(Debug, Default)]
pub struct Gradients {
    /// `[N, 3]`, centres.
    pub means: Option<Tensor<2>>,
    /// `[N, 4]`, quaternions.
    pub rotations: Option<Tensor<2>>,
    /// `[N, 3]`, logarithms of the standard deviations.
    pub log_scales: Option<Tensor<2>>,
    /// `[N]`, logits of the opacities.
    pub logit_opacities: Option<Tensor<1>>,
    /// `[N, (degree + 1)², 3]`, coefficients of the spherical harmonics.
    pub sh: Option<Tensor<3>>,
    /// Further blocks of their rows, as in [`Gaussians::sh_more`].
    pub sh_more: Vec<Option<Tensor<3>>>,
}

impl Gradients {
    /// Removes the gradients of a scene's parameters from the gradients of a loss.
    pub fn take(gaussians: &Gaussians, grads: &mut burn::tensor::Gradients) -> Self {
        Self {
            means: gaussians.means.val().grad_remove(grads),
            rotations: gaussians.rotations.val().grad_remove(grads),
            log_scales: gaussians.log_scales.val().grad_remove(grads),
            logit_opacities: gaussians.logit_opacities.val().grad_remove(grads),
            sh: gaussians.sh.val().grad_remove(grads),
            sh_more: gaussians.sh_more.iter().map(|block| block.val().grad_remove(grads)).collect(),
        }
    }

    /// Which gradients there are, in the order of the fields.
    pub(crate) fn present(&self) -> Vec<bool> {
        let Self { means, rotations, log_scales, logit_opacities, sh, sh_more } = self;
        let fields =
            [means.is_some(), rotations.is_some(), log_scales.is_some(), logit_opacities.is_some(), sh.is_some()];
        fields.into_iter().chain(sh_more.iter().map(Option::is_some)).collect()
    }

    /// The sum of both. `None` counts as zero.
    pub fn plus(self, other: Self) -> Self {
        fn sum<const D: usize>(a: Option<Tensor<D>>, b: Option<Tensor<D>>) -> Option<Tensor<D>> {
            match (a, b) {
                (Some(a), Some(b)) => Some(a + b),
                (a, b) => a.or(b),
            }
        }
        let blocks = self.sh_more.len().max(other.sh_more.len());
        let (mut a, mut b) = (self.sh_more.into_iter(), other.sh_more.into_iter());
        Self {
            means: sum(self.means, other.means),
            rotations: sum(self.rotations, other.rotations),
            log_scales: sum(self.log_scales, other.log_scales),
            logit_opacities: sum(self.logit_opacities, other.logit_opacities),
            sh: sum(self.sh, other.sh),
            sh_more: (0..blocks).map(|_| sum(a.next().flatten(), b.next().flatten())).collect(),
        }
    }

    /// The gradients multiplied by a factor.
    pub fn times(self, factor: f64) -> Self {
        Self {
            means: self.means.map(|grad| grad * factor),
            rotations: self.rotations.map(|grad| grad * factor),
            log_scales: self.log_scales.map(|grad| grad * factor),
            logit_opacities: self.logit_opacities.map(|grad| grad * factor),
            sh: self.sh.map(|grad| grad * factor),
            sh_more: self.sh_more.into_iter().map(|block| block.map(|grad| grad * factor)).collect(),
        }
    }
}

//! What a checkpoint keeps of a scene in training.

use burn::module::Param;
use burn::tensor::{Device, Tensor};

use super::harmonics::{first_and_more, put_harmonics, take_harmonics};
use super::step::on;
use super::{GaussianMoments, Trained};
use crate::gaussians::{Gaussians, parameter};
use crate::optim::{MomentBits, Moments};
use crate::state::{State, StateError};

impl Trained {
    /// Saves parameters and moments.
    pub fn save(&self) -> State {
        let (g, m) = (&self.gaussians, &self.moments);
        let mut state = State::default();
        put_parameter(&mut state, "means", &g.means, &m.means);
        put_parameter(&mut state, "rotations", &g.rotations, &m.rotations);
        put_parameter(&mut state, "log_scales", &g.log_scales, &m.log_scales);
        put_parameter(&mut state, "logit_opacities", &g.logit_opacities, &m.logit_opacities);
        put_harmonics(&mut state, g, m);
        state
    }

    /// Restores a scene with moments of so many bits. It can be trained if `device` is an autodiff device.
    ///
    /// # Errors
    /// If a value is missing, or if parameters and moments are inconsistent.
    pub fn load(from: &mut State, bits: MomentBits, device: &Device) -> Result<Self, StateError> {
        let (means, of_means) = take_parameter::<2>(from, "means", (bits, device), |shape| *shape == [shape[0], 3])?;
        let count = means.val().dims()[0];
        let (rotations, of_rotations) =
            take_parameter::<2>(from, "rotations", (bits, device), |shape| *shape == [count, 4])?;
        let (log_scales, of_log_scales) =
            take_parameter::<2>(from, "log_scales", (bits, device), |shape| *shape == [count, 3])?;
        let (logit_opacities, of_opacities) =
            take_parameter::<1>(from, "logit_opacities", (bits, device), |shape| *shape == [count])?;
        let is_sh = |&[rows, coefficients, channels]: &[usize; 3]| {
            let largest = splat_op::sh::SH_DEGREE_MAX + 1;
            let side = coefficients.isqrt();
            rows == count && (1..=largest).contains(&side) && side * side == coefficients && channels == 3
        };
        let (sh, of_sh) = take_harmonics(from, (bits, device), is_sh)?;
        let ((sh, sh_more), (of_sh, of_sh_more)) = (first_and_more(sh), first_and_more(of_sh));
        Ok(Self {
            gaussians: Gaussians { means, rotations, log_scales, logit_opacities, sh, sh_more },
            moments: GaussianMoments {
                means: of_means,
                rotations: of_rotations,
                log_scales: of_log_scales,
                logit_opacities: of_opacities,
                sh: of_sh,
                sh_more: of_sh_more,
            },
            mark: None,
        })
    }
}

pub(super) fn untracked<const D: usize>(values: Tensor<D>) -> Tensor<D> {
    if values.is_autodiff() { values.inner() } else { values }
}

pub(super) fn put_parameter<const D: usize>(
    to: &mut State,
    name: &str,
    param: &Param<Tensor<D>>,
    moments: &Moments<D>,
) {
    to.in_part(name, |part| {
        part.put("values", untracked(param.val()));
        moments.save(part);
    });
}

/// A parameter on `device`, and its moments. Returns an error if `fits` rejects the shape.
pub(super) fn take_parameter<const D: usize>(
    from: &mut State,
    name: &str,
    (bits, device): (MomentBits, &Device),
    fits: impl Fn(&[usize; D]) -> bool,
) -> Result<(Param<Tensor<D>>, Moments<D>), StateError> {
    let plain = device.clone().inner();
    from.load_part(name, |part| {
        let values = part.take::<D>("values", &plain)?;
        let shape = values.dims();
        if !fits(&shape) {
            return Err(part.shape_error("values", shape.to_vec(), "one that fits the other arrays"));
        }
        Ok((parameter(on(device, values)), Moments::load_with_bits(part, shape, bits, &plain)?))
    })
}

//! The saved state of a scene in training: its parameters and their Adam moments.

use burn::module::Param;
use burn::tensor::{Device, Tensor};

use super::{GaussianMoments, Trained, on};
use crate::gaussians::{Gaussians, parameter};
use crate::optim::Moments;
use crate::state::{State, StateError};

impl Trained {
    /// Saves parameters and moments.
    pub fn save(&self) -> State {
        let (g, m) = (&self.gaussians, &self.moments);
        let mut state = State::default();
        put(&mut state, "means", &g.means, &m.means);
        put(&mut state, "rotations", &g.rotations, &m.rotations);
        put(&mut state, "log_scales", &g.log_scales, &m.log_scales);
        put(&mut state, "logit_opacities", &g.logit_opacities, &m.logit_opacities);
        put(&mut state, "sh", &g.sh, &m.sh);
        state
    }

    /// Restores a scene. It can be trained if `device` is an autodiff device.
    ///
    /// # Errors
    /// If a value is missing, or if parameters and moments are inconsistent.
    pub fn load(from: &mut State, device: &Device) -> Result<Self, StateError> {
        let (means, of_means) = take::<2>(from, "means", device, |shape| *shape == [shape[0], 3])?;
        let count = means.val().dims()[0];
        let (rotations, of_rotations) = take::<2>(from, "rotations", device, |shape| *shape == [count, 4])?;
        let (log_scales, of_log_scales) = take::<2>(from, "log_scales", device, |shape| *shape == [count, 3])?;
        let (logit_opacities, of_opacities) = take::<1>(from, "logit_opacities", device, |shape| *shape == [count])?;
        let is_sh = |&[rows, coefficients, channels]: &[usize; 3]| {
            let largest = splat_op::sh::SH_DEGREE_MAX + 1;
            let side = coefficients.isqrt();
            rows == count && (1..=largest).contains(&side) && side * side == coefficients && channels == 3
        };
        let (sh, of_sh) = take::<3>(from, "sh", device, is_sh)?;
        Ok(Self {
            gaussians: Gaussians { means, rotations, log_scales, logit_opacities, sh },
            moments: GaussianMoments {
                means: of_means,
                rotations: of_rotations,
                log_scales: of_log_scales,
                logit_opacities: of_opacities,
                sh: of_sh,
            },
        })
    }
}

fn put<const D: usize>(to: &mut State, name: &str, param: &Param<Tensor<D>>, moments: &Moments<D>) {
    let values = param.val();
    let mut part = State::default();
    part.put("values", if values.is_autodiff() { values.inner() } else { values });
    moments.save(&mut part);
    to.put_part(name, part);
}

/// A parameter on `device`, and its moments. Returns an error if `fits` rejects the shape.
fn take<const D: usize>(
    from: &mut State,
    name: &str,
    device: &Device,
    fits: impl Fn(&[usize; D]) -> bool,
) -> Result<(Param<Tensor<D>>, Moments<D>), StateError> {
    let plain = device.clone().inner();
    from.load_part(name, |part| {
        let values = part.take::<D>("values", &plain)?;
        let shape = values.dims();
        if !fits(&shape) {
            return Err(StateError::Fit { name: name.to_owned(), found: shape.to_vec() });
        }
        Ok((parameter(on(device, values)), Moments::load(part, shape, &plain)?))
    })
}

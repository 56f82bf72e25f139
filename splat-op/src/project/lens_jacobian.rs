//! The Jacobian of a lens at one centre in the CPU twins, and its gradient, by the code for eight centres.

use fearless_simd::prelude::*;
use fearless_simd::{Level, dispatch};

use super::lens_simd::LensProjectionSimd;
use super::simd::ProjectCameraSimd;
use crate::linalg::Mat3;
use crate::simd::each;
use crate::simd::real::Real;

/// The rows of the Jacobian of a lens at a centre in the camera's frame, px per scene unit.
pub(crate) type LensJacobian<F> = [[F; 3]; 2];

/// The first lane of each element.
#[inline(always)]
fn first<S: Simd, F: Real>(row: [F::Lanes<S>; 3]) -> [F; 3] {
    each!(row, |lanes| lanes[0])
}

/// `W R` of a Gaussian that is not rotated against the camera: the rows of `J W R` are those of `J`.
fn identity<F: Real>() -> Mat3<F> {
    std::array::from_fn(|i| std::array::from_fn(|k| if i == k { F::ONE } else { F::ZERO }))
}

impl<F: Real> ProjectCameraSimd<F> {
    /// Returns the Jacobian at the position at which `project` evaluates it. `None` for a pinhole, and outside the lens's domain.
    pub fn lens_jacobian(&self, mean_cam: [F; 3]) -> Option<LensJacobian<F>> {
        dispatch!(Level::new(), simd => self.jacobian_simd(simd, mean_cam, None).map(|(jacobian, _)| jacobian))
    }

    /// Returns the gradient of the centre from that of its Jacobian.
    pub fn lens_jacobian_backward(&self, mean_cam: [F; 3], grad: LensJacobian<F>) -> [F; 3] {
        let found = dispatch!(Level::new(), simd => self.jacobian_simd(simd, mean_cam, Some(grad)));
        found.map_or([F::ZERO; 3], |(_, grad)| grad)
    }

    #[inline(always)]
    fn jacobian_simd<S: Simd>(
        &self,
        simd: S,
        mean_cam: [F; 3],
        grad: Option<LensJacobian<F>>,
    ) -> Option<(LensJacobian<F>, [F; 3])> {
        let all = |value: F| F::Lanes::<S>::splat(simd, value);
        let camera = self.lanes(simd);
        let distortion = camera.distortion?;
        let rows = each!(identity::<F>(), |row| each!(row, |value| all(value)));
        let bent: LensProjectionSimd<S, F> =
            LensProjectionSimd::new(&distortion, each!(mean_cam, |value| all(value)), &rows, [camera.low, camera.high]);
        let jacobian = each!(bent.rows(camera.focal), |value| first::<S, F>(value));
        let of_mean = match grad {
            Some(grad) => {
                let grad = each!(grad, |row| each!(row, |value| all(value)));
                first::<S, F>(bent.backward(&distortion, camera.focal, grad, [all(F::ZERO); 2]).mean_cam)
            }
            None => [F::ZERO; 3],
        };
        bent.within.any_true().then_some((jacobian, of_mean))
    }
}

//! Reference renders: whole pictures and their gradients in f64, checked in scattered pixels against the renderer without approximations.
//!
//! The reference renders whatever `splat_op` renders: it is the f64 instance of the CPU twins, with every threshold off. Nothing
//! is believed of it: every picture, whatever its projection and lens, has to agree with [`ExactView`], which shares no
//! arithmetic with the twins. A camera or a model choice that is added there needs nothing here.

use anyhow::{Result, ensure};
use burn::tensor::DType;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use splat_hard_cases::exact::{self, ExactView};
use splat_model::capture::Photo;
use splat_op::{Intrinsics, RenderOptions};

use super::subject::{DeviceScene, GradientSums, cotangent, host};

/// The exact reference under some model choices.
pub struct ReferenceRender {
    /// Pictures by view, `[H, W, 3]` row-major.
    pub pictures: Vec<Vec<f64>>,
    /// Cotangents of the pictures by view, `[H, W, 3]` row-major.
    pub cotangents: Vec<Vec<f32>>,
    /// Gradients, summed over the views.
    pub gradients: GradientSums,
    /// Largest difference from the exact renderer, from [`check`].
    pub difference: f64,
}

impl ReferenceRender {
    /// Renders and differentiates every view of `place`, which must be in f64. Each numerical dial of `options` should
    /// have the value that approximates nothing. `done` is called after each view.
    pub fn new(place: &DeviceScene, photos: &[Photo], options: &RenderOptions, mut done: impl FnMut()) -> Result<Self> {
        let (pictures, cotangents) = (Vec::new(), Vec::new());
        let mut truth = Self { pictures, cotangents, gradients: GradientSums::default(), difference: 0.0 };
        for (view, photo) in photos.iter().enumerate() {
            let picture = place.tracked(view, options)?;
            let exact = host(picture.colour.clone().inner());
            truth.difference = truth.difference.max(check(place, view, options, &exact)?);
            let cotangent = cotangent(photo, &exact, place.background);
            let gradients = place.backward(picture, place.picture(view, &cotangent));
            place.add_gradients(&gradients, &mut truth.gradients);
            truth.pictures.push(exact);
            truth.cotangents.push(cotangent);
            done();
        }
        Ok(truth)
    }
}

/// Pixels of a picture that are checked, along each axis.
const CHECKED: usize = 8;

/// Largest allowed difference between the reference renderer and the exact renderer: the reference leaves out alphas
/// below 1e-12, up to a thousand of them in a pixel, and both round in f64.
const TOLERANCE: f64 = 1e-9;

/// Compares a picture of the reference renderer with [`ExactView`], which visits every Gaussian in every pixel, in a random
/// pixel of each field of a grid of 8 × 8. Returns the largest difference. An error if the two differ by more than
/// rounding: no error measured against the reference would mean anything.
fn check(place: &DeviceScene, view: usize, options: &RenderOptions, picture: &[f64]) -> Result<f64> {
    debug_assert_eq!(place.dtype, DType::F64);
    let camera = &place.cameras[view];
    let (gaussians, pose) = exact::read(&place.splats, camera)?;
    let exact = ExactView::new(&gaussians, &pose, &camera.intrinsics, options);
    let background = place.background.map(f64::from);
    let mut largest = 0.0_f64;
    for [x, y] in checked_pixels(&camera.intrinsics, view) {
        let found = &picture[3 * (y * camera.intrinsics.width + x)..];
        for (found, exact) in found.iter().zip(exact.pixel([x, y], &background).features) {
            let difference = (found - exact).abs();
            ensure!(
                difference <= TOLERANCE,
                "the reference renderer is wrong: in pixel {x}, {y} of view {view} it differs from the exact renderer by \
                 {difference:.1e}, which is more than the {TOLERANCE:.0e} of rounding; please report this with the scene"
            );
            largest = largest.max(difference);
        }
    }
    Ok(largest)
}

/// Returns a random pixel of each field of the grid.
fn checked_pixels(camera: &Intrinsics, view: usize) -> impl Iterator<Item = [usize; 2]> {
    let (mut random, size) = (ChaCha8Rng::seed_from_u64(view as u64), [camera.width, camera.height]);
    (0..CHECKED * CHECKED).map(move |field| {
        [(field % CHECKED, size[0]), (field / CHECKED, size[1])].map(|(field, side)| {
            let [start, end] = [field, field + 1].map(|border| border * side / CHECKED);
            random.random_range(start..end.max(start + 1)).min(side - 1)
        })
    })
}

#[cfg(test)]
pub(super) mod tests;

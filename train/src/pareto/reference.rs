//! Reference renders: whole pictures and their gradients in f64, checked on small crops against the renderer without
//! approximations.

use anyhow::{Result, ensure};
use burn::tensor::DType;
use glam::{DMat3, DVec3};
use splat_op::exact::{ExactGaussian, ExactPose, render_exact};
use splat_op::{Camera, Intrinsics, RenderOptions, render_view};

use super::subject::{DeviceScene, GradientSums, MeasuredView, cotangent, host};

/// The exact reference under some model choices.
pub struct ReferenceRender {
    /// Pictures by view, `[H, W, 3]` row-major.
    pub pictures: Vec<Vec<f64>>,
    /// Cotangents of the pictures by view, `[H, W, 3]` row-major.
    pub cotangents: Vec<Vec<f32>>,
    /// Gradients, summed over the views.
    pub gradients: GradientSums,
}

impl ReferenceRender {
    /// Renders and differentiates every view of `place`, which must be in f64. Each numerical dial of `options` should
    /// have the value that approximates nothing. `done` is called after each view.
    pub fn new(
        place: &DeviceScene,
        shots: &[MeasuredView],
        options: &RenderOptions,
        mut done: impl FnMut(),
    ) -> Result<Self> {
        let mut truth = Self { pictures: Vec::new(), cotangents: Vec::new(), gradients: GradientSums::default() };
        for (view, shot) in shots.iter().enumerate() {
            let picture = place.tracked(view, options)?;
            let exact = host(picture.colour.clone().inner());
            let cotangent = cotangent(shot, &exact, background(place));
            let gradients = place.backward(picture, place.picture(view, &cotangent));
            place.add_gradients(&gradients, &mut truth.gradients);
            truth.pictures.push(exact);
            truth.cotangents.push(cotangent);
            done();
        }
        Ok(truth)
    }
}

fn background(place: &DeviceScene) -> [f32; 3] {
    let values = place.extras.background.clone().map(host).unwrap_or_default();
    std::array::from_fn(|channel| values.get(channel).copied().unwrap_or_default() as f32)
}

/// Width and height of a crop, px.
const CROP: usize = 12;

/// Largest allowed difference between the reference renderer and the exact renderer: the reference leaves out alphas
/// below 1e-12, up to a thousand of them in a pixel, and both round in f64.
const TOLERANCE: f64 = 1e-9;

/// Renders crops of up to three views with the reference renderer and with [`render_exact`], which visits every
/// Gaussian in every pixel. A crop is a camera of its own, with a shifted principal point; its Jacobians are clamped at
/// least as far out as those of the whole picture. Returns the largest difference.
///
/// # Errors
/// If the two differ by more than rounding: no error measured against the reference would mean anything.
pub fn check_crops(place: &DeviceScene, shots: &[MeasuredView], options: &RenderOptions) -> Result<f64> {
    let mut largest = 0.0_f64;
    for (view, share) in (0..shots.len()).zip([(0.5, 0.5), (0.3, 0.6), (0.7, 0.4)]) {
        let found = crop_difference(place, view, crop(&shots[view].intrinsics, share, options), options.to_owned())?;
        let name = shots[view].photo.map_or(format!("view {view}"), |photo| photo.name.clone());
        ensure!(
            found <= TOLERANCE,
            "the reference renderer is wrong: in a crop of {name} it differs from the exact renderer by {found:.1e}, which is more \
             than the {TOLERANCE:.0e} of rounding; please report this with the scene"
        );
        largest = largest.max(found);
    }
    Ok(largest)
}

/// Returns the camera of a crop whose middle is at `share` of the picture, and the margin at which its Jacobians are
/// clamped.
fn crop(full: &Intrinsics, share: (f64, f64), options: &RenderOptions) -> (Intrinsics, f64) {
    let corner = |size: usize, share: f64| {
        let side = CROP.min(size);
        (side, ((size as f64 * share) as usize).saturating_sub(side / 2).min(size - side) as f64)
    };
    let ((width, x), (height, y)) = (corner(full.width, share.0), corner(full.height, share.1));
    let camera = Intrinsics { width, height, cx: full.cx - x, cy: full.cy - y, ..*full };
    let margin = |full: usize, crop: usize| (2.0 + options.jacobian_margin) * full as f64 / crop as f64;
    (camera, margin(full.width, width).max(margin(full.height, height)))
}

fn crop_difference(
    place: &DeviceScene,
    view: usize,
    (intrinsics, jacobian_margin): (Intrinsics, f64),
    options: RenderOptions,
) -> Result<f64> {
    let options = RenderOptions { jacobian_margin, ..options };
    let camera = Camera { intrinsics, ..place.cameras[view].clone() };
    let found = host(render_view(&place.splats, &camera, &place.extras, &options)?.colour);
    let background: Vec<f64> = background(place).map(f64::from).to_vec();
    let exact = render_exact(&gaussians(place, &camera)?, &pose(&camera), &intrinsics, &background, &options);
    let exact = exact.iter().flat_map(|pixel| &pixel.features);
    let differences = found.iter().zip(exact).map(|(found, exact)| (found - exact).abs());
    // `max` would ignore NaN.
    Ok(differences.fold(0.0, |largest, difference| if difference <= largest { largest } else { difference }))
}

/// Returns the Gaussians that can be rendered, with their colours as seen by `camera`.
fn gaussians(place: &DeviceScene, camera: &Camera) -> Result<Vec<ExactGaussian>> {
    debug_assert_eq!(place.dtype, DType::F64);
    let splats = &place.splats;
    let colours = host(splat_op::colours(splats, camera)?);
    let (means, rotations) = (host(splats.means.clone()), host(splats.rotations.clone()));
    let (scales, opacities) = (host(splats.scales.clone()), host(splats.opacities.clone()));
    let gaussian = |i: usize| ExactGaussian {
        mean: DVec3::from_slice(&means[3 * i..]),
        rotation: std::array::from_fn(|k| rotations[4 * i + k]),
        scale: DVec3::from_slice(&scales[3 * i..]),
        opacity: opacities[i],
        features: colours[3 * i..3 * i + 3].to_vec(),
    };
    // Gaussians of opacity 0 are masked; their other values may be anything.
    Ok((0..opacities.len()).filter(|&i| opacities[i] > 0.0).map(gaussian).collect())
}

fn pose(camera: &Camera) -> ExactPose {
    let rows = host(camera.cam_from_world.clone());
    let row = |i: usize| DVec3::from_slice(&rows[4 * i..]);
    ExactPose {
        rotation: DMat3::from_cols(row(0), row(1), row(2)).transpose(),
        translation: DVec3::new(rows[3], rows[7], rows[11]),
    }
}

#[cfg(test)]
pub(super) mod tests {
    use glam::DAffine3;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;
    use splat_model::accuracy::Dial;
    use splat_model::gaussians::GaussianRows;

    use super::*;

    pub const CAMERA: Intrinsics = Intrinsics { cy: 17.0, ..Intrinsics::centred(40, 30, 36.0) };

    /// Gaussians in front of [`CAMERA`] at the origin; one of them is too large to be rendered.
    pub fn rows(count: usize) -> GaussianRows {
        let mut random = ChaCha8Rng::seed_from_u64(3);
        let mut between = |low: f32, high: f32| random.random_range(low..high);
        let mut rows = GaussianRows { sh_degree: 1, ..GaussianRows::default() };
        for _ in 0..count {
            let z = between(2.0, 5.0);
            rows.means.push([z * between(-0.7, 0.7), z * between(-0.5, 0.5), z]);
            rows.rotations.push([(); 4].map(|()| between(-1.0, 1.0)));
            rows.log_scales.push([(); 3].map(|()| between(-4.0, -1.0)));
            rows.logit_opacities.push(between(-2.0, 6.0));
            rows.sh_dc.push([(); 3].map(|()| between(-1.0, 1.0)));
            rows.sh_rest.extend([(); 9].map(|()| between(-0.3, 0.3)));
        }
        rows.log_scales[0][0] = f32::INFINITY;
        // A wall behind half of them, denser than the standard's limit for a layer.
        (rows.means[1], rows.log_scales[1], rows.logit_opacities[1]) = ([0.0, -0.2, 4.0], [0.5; 3], 9.0);
        rows
    }

    pub fn shots() -> Vec<MeasuredView<'static>> {
        let shot = |x: f64| MeasuredView {
            intrinsics: CAMERA,
            cam_from_world: DAffine3::from_translation(DVec3::new(x, 0.0, 0.1)),
            photo: None,
        };
        vec![shot(0.0), shot(0.3)]
    }

    #[test]
    fn the_reference_is_the_exact_renderer() {
        let place = DeviceScene::in_f64(&rows(80), &shots(), [0.1, 0.2, 0.3]).unwrap();
        let options = Dial::all_exact(RenderOptions::standard());
        let found = check_crops(&place, &shots(), &options).unwrap();
        assert!(found < TOLERANCE, "{found:.1e}");
    }

    #[test]
    fn a_reference_that_approximates_is_refused() {
        let place = DeviceScene::in_f64(&rows(80), &shots(), [0.0; 3]).unwrap();
        let exact = Dial::all_exact(RenderOptions::standard());
        for (options, what) in [
            (RenderOptions { alpha_max: 0.99, ..exact }, "alpha_max"),
            (RenderOptions { alpha_min: 1.0 / 255.0, ..exact }, "alpha_min"),
            (RenderOptions { transmittance_min: 1e-2, ..exact }, "transmittance_min"),
        ] {
            let error = check_crops(&place, &shots(), &options).expect_err(what).to_string();
            assert!(error.contains("the reference renderer is wrong: in a crop of view 0"), "{what}: {error}");
        }
    }

    #[test]
    fn gradients_are_those_of_all_views() {
        let options = Dial::all_exact(RenderOptions::standard());
        let truth = |shots: &[MeasuredView]| {
            let place = DeviceScene::in_f64(&rows(12), shots, [0.0; 3]).unwrap();
            ReferenceRender::new(&place, shots, &options, || ()).unwrap()
        };
        let all = shots();
        let (both, first, second) = (truth(&all), truth(&all[..1]), truth(&all[1..]));
        for kind in 0..5 {
            assert!(!both.gradients[kind].is_empty());
            let parts = first.gradients[kind].iter().zip(&second.gradients[kind]);
            for (found, (first, second)) in both.gradients[kind].iter().zip(parts) {
                assert!((found - (first + second)).abs() <= 1e-12 * (1.0 + found.abs()), "{found}, {first}, {second}");
            }
        }
        assert_eq!(both.pictures[0].len(), 3 * CAMERA.width * CAMERA.height);
    }
}

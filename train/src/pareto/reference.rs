//! Reference renders: whole pictures and their gradients in f64, checked in scattered pixels against the renderer without
//! approximations.
//!
//! The reference renders whatever `splat_op` renders: it is the f64 instance of the CPU twins, with every threshold off. Nothing
//! is believed of it: every picture, whatever its projection and lens, has to agree with [`ExactView`], which shares no
//! arithmetic with the twins. A camera or a model choice that is added there needs nothing here.

use anyhow::{Result, ensure};
use burn::tensor::DType;
use glam::{DMat3, DVec3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use splat_op::exact::{ExactGaussian, ExactPose, ExactView};
use splat_op::{Camera, Intrinsics, RenderOptions};

use super::subject::{DeviceScene, GradientSums, MeasuredView, cotangent, host};

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
    /// Mean square error of the order of centres, from [`order_error`].
    pub order_error: f64,
}

impl ReferenceRender {
    /// Renders and differentiates every view of `place`, which must be in f64. Each numerical dial of `options` should
    /// have the value that approximates nothing. `done` is called after each view.
    ///
    /// # Errors
    /// As [`check`], and if the operation refuses the scene.
    pub fn new(
        place: &DeviceScene,
        shots: &[MeasuredView],
        options: &RenderOptions,
        mut done: impl FnMut(),
    ) -> Result<Self> {
        let (pictures, cotangents) = (Vec::new(), Vec::new());
        let mut truth =
            Self { pictures, cotangents, gradients: GradientSums::default(), difference: 0.0, order_error: 0.0 };
        for (view, shot) in shots.iter().enumerate() {
            let picture = place.tracked(view, options)?;
            let exact = host(picture.colour.clone().inner());
            truth.difference = truth.difference.max(check(place, (view, shot), options, &exact)?);
            truth.order_error += order_error(place, view, options)? / shots.len() as f64;
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

/// Pixels of a picture that are checked, along each axis.
const CHECKED: usize = 8;

/// Largest allowed difference between the reference renderer and the exact renderer: the reference leaves out alphas
/// below 1e-12, up to a thousand of them in a pixel, and both round in f64.
const TOLERANCE: f64 = 1e-9;

/// Compares a picture of the reference renderer with [`ExactView`], which visits every Gaussian in every pixel, in a random
/// pixel of each field of a grid of 8 × 8. Returns the largest difference.
///
/// # Errors
/// If the two differ by more than rounding: no error measured against the reference would mean anything.
pub fn check(
    place: &DeviceScene,
    (view, shot): (usize, &MeasuredView),
    options: &RenderOptions,
    picture: &[f64],
) -> Result<f64> {
    let camera = &place.cameras[view];
    let gaussians = gaussians(place, camera)?;
    let exact = ExactView::new(&gaussians, &pose(camera), &camera.intrinsics, options);
    let background = background(place).map(f64::from);
    let mut largest = 0.0_f64;
    for [x, y] in checked_pixels(&camera.intrinsics, view) {
        let found = &picture[3 * (y * camera.intrinsics.width + x)..];
        for (found, exact) in found.iter().zip(exact.pixel([x, y], &background).features) {
            let difference = (found - exact).abs();
            let name = || shot.photo.map_or(format!("view {view}"), |photo| photo.name.clone());
            ensure!(
                difference <= TOLERANCE,
                "the reference renderer is wrong: in pixel {x}, {y} of {} it differs from the exact renderer by {difference:.1e}, \
                 which is more than the {TOLERANCE:.0e} of rounding; please report this with the scene",
                name()
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

/// Returns the mean square error that the order of centres causes, in the pixels of [`check`]: against the order of each pixel, which
/// the exact renderer alone computes.
fn order_error(place: &DeviceScene, view: usize, options: &RenderOptions) -> Result<f64> {
    let camera = &place.cameras[view];
    let (gaussians, pose, background) = (gaussians(place, camera)?, pose(camera), background(place).map(f64::from));
    let by_centres = ExactView::new(&gaussians, &pose, &camera.intrinsics, options);
    let by_pixel = ExactView::new(&gaussians, &pose, &camera.intrinsics, options).sorted_per_pixel();
    let squares = checked_pixels(&camera.intrinsics, view).flat_map(|pixel| {
        let [found, exact] = [&by_centres, &by_pixel].map(|view| view.pixel(pixel, &background).features);
        found.into_iter().zip(exact).map(|(found, exact)| (found - exact).powi(2))
    });
    Ok(squares.sum::<f64>() / (3 * CHECKED * CHECKED) as f64)
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
    use splat_model::accuracy::Dial;
    use splat_model::gaussians::GaussianRows;
    use splat_op::{CameraModel, Projection};

    use super::*;

    pub const CAMERA: Intrinsics = Intrinsics { cy: 17.0, ..Intrinsics::centred(40, 30, 36.0) };

    const DISTORTION: [f64; 8] = [0.1, -0.03, 0.002, -0.001, 0.0, 0.0, 0.0, 0.0];

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

    fn rendered(options: &RenderOptions, shots: &[MeasuredView]) -> Result<f64> {
        let place = DeviceScene::in_f64(&rows(80), shots, [0.1, 0.2, 0.3])?;
        Ok(ReferenceRender::new(&place, shots, options, || ())?.difference)
    }

    #[test]
    fn the_reference_is_the_exact_renderer() {
        let exact = Dial::all_exact(RenderOptions::standard());
        for projection in [Projection::Affine, Projection::RayMax] {
            let options = exact.with_projection(projection).with_antialias(true);
            let found = rendered(&options, &shots()).unwrap();
            assert!(found > 0.0 && found < TOLERANCE, "{projection:?}: {found:.1e}");
        }
        let mut through_lenses = shots();
        through_lenses[0].intrinsics = Intrinsics { model: CameraModel::OpenCv, distortion: DISTORTION, ..CAMERA };
        through_lenses[1].intrinsics = Intrinsics { model: CameraModel::Fisheye, distortion: DISTORTION, ..CAMERA };
        let found = rendered(&exact, &through_lenses).unwrap();
        assert!(found > 0.0 && found < TOLERANCE, "{found:.1e}");
    }

    #[test]
    fn a_reference_that_approximates_is_refused() {
        let exact = Dial::all_exact(RenderOptions::standard());
        for (options, what) in [
            (RenderOptions { alpha_max: 0.99, ..exact }, "alpha_max"),
            (RenderOptions { alpha_min: 1.0 / 255.0, ..exact }, "alpha_min"),
            (RenderOptions { transmittance_min: 1e-2, ..exact }, "transmittance_min"),
        ] {
            let error = rendered(&options, &shots()).expect_err(what).to_string();
            assert!(error.contains("the reference renderer is wrong: in pixel"), "{what}: {error}");
        }
    }

    /// A picture in another projection than the one asked for is not taken for the truth.
    #[test]
    fn a_reference_of_another_function_is_refused() {
        let (shots, exact) = (shots(), Dial::all_exact(RenderOptions::standard()));
        let place = DeviceScene::in_f64(&rows(80), &shots, [0.0; 3]).unwrap();
        let plain = host(place.render(0, &exact).unwrap().colour);
        check(&place, (0, &shots[0]), &exact, &plain).unwrap();
        assert!(check(&place, (0, &shots[0]), &exact.with_projection(Projection::RayMax), &plain).is_err());
    }

    /// Two crossing sheets differ by the order of each pixel in part of the picture; two sheets one behind the other nowhere.
    #[test]
    fn the_order_of_centres_costs_something_where_splats_cross() {
        let options = Dial::all_exact(RenderOptions::standard());
        let error = |lean: f32| {
            let sheets = GaussianRows {
                means: vec![[0.2, 0.0, 3.0], [-0.2, 0.0, 3.2]],
                rotations: vec![[1.0, 0.0, lean, 0.0], [1.0, 0.0, -lean, 0.0]],
                log_scales: vec![[-0.3, -0.3, -4.0]; 2],
                logit_opacities: vec![2.0; 2],
                sh_dc: vec![[1.0, 0.0, -1.0], [-1.0, 0.0, 1.0]],
                ..GaussianRows::default()
            };
            let place = DeviceScene::in_f64(&sheets, &shots()[..1], [0.0; 3]).unwrap();
            order_error(&place, 0, &options).unwrap()
        };
        let (apart, crossing) = (error(0.0), error(0.5));
        assert!(apart < 1e-9 && crossing > 1e-3, "{apart:.1e}, {crossing:.1e}");
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

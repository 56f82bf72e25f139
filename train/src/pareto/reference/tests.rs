use glam::{DAffine3, DVec3};
use splat_model::accuracy::Dial;
use splat_model::gaussians::GaussianRows;
use splat_op::{CameraModel, Projection};

use super::*;

pub const CAMERA: Intrinsics = Intrinsics::pinhole(40, 30, [36.0, 36.0], [20.0, 17.0]);

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

pub fn photos() -> Vec<Photo> {
    let photo = |x: f64| Photo {
        name: x.to_string(),
        intrinsics: CAMERA,
        cam_from_world: DAffine3::from_translation(DVec3::new(x, 0.0, 0.1)),
        rgb: (0..3 * CAMERA.width * CAMERA.height).map(|i| (37 * i % 251) as u8).collect(),
        alpha: None,
        mask: None,
    };
    vec![photo(0.0), photo(0.3)]
}

fn rendered(options: &RenderOptions, photos: &[Photo]) -> Result<f64> {
    let place = DeviceScene::in_f64(&rows(80), photos, [0.1, 0.2, 0.3])?;
    Ok(ReferenceRender::new(&place, photos, options, || ())?.difference)
}

#[test]
fn the_reference_is_the_exact_renderer() {
    let exact = Dial::all_exact(RenderOptions::standard());
    for projection in [Projection::Affine, Projection::RayMax] {
        let options = exact.with_projection(projection).with_antialias(true);
        let found = rendered(&options, &photos()).unwrap();
        assert!(found > 0.0 && found < TOLERANCE, "{projection:?}: {found:.1e}");
    }
    let mut through_lenses = photos();
    through_lenses[0].intrinsics = CAMERA.with_lens(CameraModel::OpenCv, DISTORTION);
    through_lenses[1].intrinsics = CAMERA.with_lens(CameraModel::Fisheye, DISTORTION);
    let found = rendered(&exact, &through_lenses).unwrap();
    assert!(found > 0.0 && found < TOLERANCE, "{found:.1e}");
}

#[test]
fn a_reference_that_approximates_is_refused() {
    let exact = Dial::all_exact(RenderOptions::standard());
    for (options, what) in [
        (exact.with_alpha_max(0.99), "alpha_max"),
        (exact.with_alpha_min(1.0 / 255.0), "alpha_min"),
        (exact.with_transmittance_min(1e-2), "transmittance_min"),
    ] {
        let error = rendered(&options, &photos()).expect_err(what).to_string();
        assert!(error.contains("the reference renderer is wrong: in pixel"), "{what}: {error}");
    }
}

/// A picture in another projection than the one asked for is not taken for the truth.
#[test]
fn a_reference_of_another_function_is_refused() {
    let (photos, exact) = (photos(), Dial::all_exact(RenderOptions::standard()));
    let place = DeviceScene::in_f64(&rows(80), &photos, [0.0; 3]).unwrap();
    let plain = host(place.render(0, &exact).unwrap().colour);
    check(&place, 0, &exact, &plain).unwrap();
    assert!(check(&place, 0, &exact.with_projection(Projection::RayMax), &plain).is_err());
}

#[test]
fn gradients_are_those_of_all_views() {
    let options = Dial::all_exact(RenderOptions::standard());
    let truth = |photos: &[Photo]| {
        let place = DeviceScene::in_f64(&rows(12), photos, [0.0; 3]).unwrap();
        ReferenceRender::new(&place, photos, &options, || ()).unwrap()
    };
    let all = photos();
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

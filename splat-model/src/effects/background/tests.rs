use std::fs;

use glam::{DMat3, DVec3};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

use super::*;

fn camera() -> (Intrinsics, DAffine3) {
    let turned = DMat3::from_rotation_x(0.3) * DMat3::from_rotation_y(1.0);
    (Intrinsics::centred(9, 7, 6.0), DAffine3::from_mat3_translation(turned, DVec3::new(1.0, 2.0, 3.0)))
}

/// An environment that is brighter towards +z of the world and red towards +x.
fn lit() -> Vec<[f32; 3]> {
    vec![[0.1, 0.0, -0.1], [0.0; 3], [0.3, 0.3, 0.3], [-0.4, 0.0, 0.0]]
}

#[test]
fn an_environment_shows_the_light_of_each_direction() {
    let (intrinsics, pose) = camera();
    let device = Device::flex();
    let nothing = Tensor::zeros([7, 9, 3], &device);
    let image = Background::Environment(lit()).behind(nothing, Tensor::zeros([7, 9, 1], &device), &intrinsics, &pose);
    let values = values_of(image);
    // Definition of the harmonics up to degree 1.
    let [y0, y1] = [0.5 / std::f64::consts::PI.sqrt(), (0.75 / std::f64::consts::PI).sqrt()];
    for (x, y) in [(0, 0), (8, 6), (4, 3), (2, 5)] {
        let direction = intrinsics.cam_from_px(DVec2::new(x as f64 + 0.5, y as f64 + 0.5)).normalize();
        let world = pose.matrix3.inverse() * direction;
        let expected = [
            0.5 + 0.1 * y0 + 0.3 * y1 * world.z + 0.4 * y1 * world.x,
            0.5 + 0.3 * y1 * world.z,
            0.5 - 0.1 * y0 + 0.3 * y1 * world.z,
        ];
        for (channel, expected) in expected.into_iter().enumerate() {
            let found = f64::from(values[3 * (9 * y + x) + channel]);
            assert!((found - expected).abs() < 1e-6, "({x}, {y}) channel {channel}: {found} instead of {expected}");
        }
    }
}

#[test]
fn what_is_hidden_of_the_background_does_not_show() {
    let (intrinsics, pose) = camera();
    let device = Device::flex();
    let image = Tensor::<3>::full([7, 9, 3], 0.3, &device);
    let shown = |alpha: f32| {
        let alpha = Tensor::full([7, 9, 1], alpha, &device);
        values_of(Background::Environment(lit()).behind(image.clone(), alpha, &intrinsics, &pose))
    };
    assert!(shown(1.0).iter().all(|value| *value == 0.3));
    for (half, none) in shown(0.5).into_iter().zip(shown(0.0)) {
        assert!((half - 0.3 - 0.5 * (none - 0.3)).abs() < 1e-6, "{half} and {none}");
    }
}

#[test]
fn an_environment_is_learnt() {
    let (intrinsics, pose) = camera();
    let device = Device::flex();
    let (image, alpha) = (Tensor::<3>::zeros([7, 9, 3], &device), Tensor::<3>::full([7, 9, 1], 0.25, &device));
    let truth = Background::Environment(lit());
    // Several viewing directions are needed to determine all harmonics.
    let poses: Vec<DAffine3> = (0..4)
        .map(|i| pose * DAffine3::from_rotation_y(1.5 * f64::from(i)) * DAffine3::from_rotation_z(f64::from(i)))
        .collect();
    let mut environment = Environment::new(1, &poses, &device);
    let steps = 800;
    for step in 1..=steps {
        let view = step % poses.len();
        let tracked = |tensor: &Tensor<3>| Tensor::from_inner(tensor.clone());
        let shown = environment.behind(tracked(&image), tracked(&alpha), view, &intrinsics);
        let expected = truth.behind(image.clone(), alpha.clone(), &intrinsics, &poses[view]);
        let mut gradients = (shown - Tensor::from_inner(expected)).square().mean().backward();
        environment.step(&mut gradients, EffectContext { view, step, steps, verdict: None });
    }
    let Some(Background::Environment(found)) = environment.background() else { panic!("an environment") };
    for (found, expected) in found.as_flattened().iter().zip(lit().as_flattened()) {
        assert!((found - expected).abs() < 0.02, "{found} instead of {expected}");
    }
    // The four photographs share the directions of their camera. Those of another size are another camera's.
    let bytes = 9 * 7 * 3 * size_of::<f32>();
    assert_eq!(environment.cached_bytes, bytes);
    let half = intrinsics.resized(4, 3);
    let small = |tensor: Tensor<3>| Tensor::from_inner(tensor.slice([0..3, 0..4]));
    environment.behind(small(image), small(alpha), 0, &half);
    assert_eq!(environment.cached_bytes, bytes + 4 * 3 * 3 * size_of::<f32>());
}

#[test]
fn colours_are_drawn_only_where_they_are_random() {
    let device = Device::flex();
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let drawn: Vec<[f32; 3]> = (0..50).filter_map(|_| RandomBackground.draw(&mut rng)).collect();
    assert_eq!(drawn.len(), 50);
    assert!(drawn.as_flattened().iter().all(|value| (0.0..1.0).contains(value)));
    assert!(drawn.iter().all(|[r, g, b]| r != g && g != b), "a colour, not a grey");
    let mean = drawn.as_flattened().iter().sum::<f32>() / 150.0;
    assert!((mean - 0.5).abs() < 0.1, "{mean}");
    let mut learnt = LearnedBackground::new([0.2; 3], &device);
    assert_eq!((learnt.draw(&mut rng), learnt.background()), (None, Some(Background::Colour([0.2; 3]))));
    assert!(RandomBackground.background().is_none());
}

#[test]
fn files_are_read_back_and_others_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("background.json");
    for background in [Background::Colour([0.25, 0.5, 1.0]), Background::Environment(lit())] {
        fs::write(&path, background.to_json().unwrap()).unwrap();
        assert_eq!(Background::read(&path).unwrap(), background);
    }
    for (text, part) in [
        ("{", "expected"),
        (r#"{"environment": [[0, 0, 0], [0, 0, 0]]}"#, "2 coefficients"),
        (r#"{"colour": [0, 1]}"#, "colour"),
        (r#"{"colour": [0, 1, 1e300]}"#, "expected"),
    ] {
        fs::write(&path, text).unwrap();
        let message = Background::read(&path).unwrap_err().to_string();
        assert!(message.contains(part) && message.contains("background.json"), "{message}");
    }
    // A file that is too long is not read, whatever its start.
    fs::write(&path, [Background::Colour([0.0; 3]).to_json().unwrap().as_bytes(), &vec![b' '; 1 << 20]].concat())
        .unwrap();
    let message = Background::read(&path).unwrap_err().to_string();
    assert!(message.contains("more than 1048576 bytes"), "{message}");
    let message = Background::read(&folder.path().join("none.json")).unwrap_err().to_string();
    assert!(message.contains("none.json") && message.contains("beside its scene"), "{message}");
}

/// The colour stays in the range of a picture, however far the parameter moves.
#[test]
fn a_learnt_colour_is_one_that_can_be_shown_and_is_learnt() {
    let device = Device::flex();
    let mut learnt = LearnedBackground::new([0.995, 0.005, 0.5], &device);
    let weights = Tensor::<1>::from_inner(Tensor::from_floats([-1.0, 1.0, 1.0], &device));
    for step in 1..=4 {
        let mut gradients = (learnt.colour.tracked() * weights.clone()).sum().backward();
        learnt.step(&mut gradients, EffectContext { view: 0, step, steps: 4, verdict: None });
    }
    let Some(Background::Colour(found)) = learnt.background() else { panic!("a colour") };
    assert_eq!(found[..2], [1.0, 0.0]);
    // Adam's steps under a constant gradient have the size of the rates, which fall from 0.01 to 0.001.
    let moved: f32 = (0..4).map(|step| 0.01 * 0.1_f32.powf(step as f32 / 3.0)).sum();
    assert!((0.5 - found[2] - moved).abs() < 1e-4, "{found:?}");
}

/// Directions beyond the size of the cache are computed again each time and not counted. Photographs of one camera share them.
#[test]
fn what_does_not_fit_is_not_kept() {
    let (intrinsics, pose) = camera();
    let device = Device::flex();
    let mut environment = Environment::new(1, &[pose; 3], &device);
    environment.cached_bytes = CACHE_BYTES - 9 * 7 * 3 * size_of::<f32>();
    for focal_px in [0.0, 0.0, 1.0] {
        environment.directions_of(&intrinsics.with_focal(intrinsics.fx + focal_px, intrinsics.fy));
    }
    assert_eq!((environment.cached_bytes, environment.cache.len()), (CACHE_BYTES, 1));
}

/// The sky of a photograph is that from directions in the world frame, for every degree and any pose.
#[test]
fn directions_are_rotated_into_the_world() {
    let (intrinsics, _) = camera();
    let device = Device::flex();
    let poses: Vec<DAffine3> = (0..5)
        .map(|i| {
            let turned =
                DMat3::from_euler(glam::EulerRot::XYZ, 0.7 * f64::from(i), 2.0 - f64::from(i), 1.3 * f64::from(i));
            DAffine3::from_mat3_translation(turned, DVec3::new(1.0, 2.0, 3.0))
        })
        .collect();
    for degree in 0..=4 {
        let count = (degree + 1) * (degree + 1);
        let light: Vec<[f32; 3]> = (0..count).map(|k| [k as f32, 3.0 - k as f32, 0.5].map(|x| 0.1 * x.sin())).collect();
        let mut environment = Environment::new(degree, &poses, &device);
        environment.coefficients =
            Learned::new(Tensor::from_floats(TensorData::new(light.as_flattened().to_vec(), [count, 3]), &device));
        for (view, pose) in poses.iter().enumerate() {
            let nothing = Tensor::zeros([7, 9, 3], &device);
            let alpha = Tensor::zeros([7, 9, 1], &device);
            let expected =
                Background::Environment(light.clone()).behind(nothing.clone(), alpha.clone(), &intrinsics, pose);
            let tracked = |tensor: Tensor<3>| Tensor::from_inner(tensor);
            let found = environment.behind(tracked(nothing), tracked(alpha), view, &intrinsics).inner();
            for (found, expected) in values_of(found).into_iter().zip(values_of(expected)) {
                assert!((found - expected).abs() < 2e-6, "degree {degree}, view {view}: {found} and {expected}");
            }
        }
    }
}

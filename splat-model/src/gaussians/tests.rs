use super::group::tensor;
use super::testing::{devices, random_rows};
use super::*;

#[test]
fn rows_survive_a_round_trip_bit_for_bit() {
    for device in devices() {
        for device in [device.clone(), device.autodiff()] {
            for degree in 0..=3 {
                let rows = random_rows(17, degree, degree as u64);
                let scene = Gaussians::from_rows(&rows, &device).unwrap();
                assert_eq!(scene.to_rows(), rows);
                assert_eq!(Gaussians::from_own_rows(rows.clone(), &device).unwrap().to_rows(), rows);
                assert_eq!((scene.len(), scene.sh_degree()), (17, degree));
                assert_eq!(scene.sh_blocks().remove(0).dims(), [17, (degree + 1) * (degree + 1), 3]);
            }
        }
    }
}

#[test]
fn rows_are_copied_to_the_host_in_parts() {
    let mut rows = random_rows(1, 1, 0);
    let only = rows.clone();
    (1..ROWS_AT_ONCE + 2).for_each(|_| rows.push(&only, 0));
    let last = rows.rest_per_row() * (ROWS_AT_ONCE + 1);
    rows.sh_rest[last] = 5.0;
    rows.sh_dc[ROWS_AT_ONCE] = [6.0; 3];
    let scene = Gaussians::from_rows(&rows, &Device::flex()).unwrap();
    assert!(scene.to_rows() == rows);
    let mut last = GaussianRows { sh_degree: 1, ..GaussianRows::default() };
    (ROWS_AT_ONCE..ROWS_AT_ONCE + 2).for_each(|row| last.push(&rows, row));
    assert_eq!(scene.rows_in(ROWS_AT_ONCE..ROWS_AT_ONCE + 2), last);
}

#[test]
fn accessors_activate() {
    let ln2 = 2f32.ln();
    let rows = GaussianRows {
        means: vec![[1.0, 2.0, 3.0]],
        rotations: vec![[2.0, 0.0, 0.0, 0.0]],
        log_scales: vec![[0.0, ln2, -ln2]],
        logit_opacities: vec![9f32.ln()],
        sh_dc: vec![[0.1, 0.2, 0.3]],
        sh_rest: (1..=9).map(|i| i as f32).collect(),
        sh_degree: 1,
        groups: Vec::new(),
    };
    for device in devices() {
        let scene = Gaussians::from_rows(&rows, &device).unwrap();
        let scales = values_of(scene.scales());
        assert!(
            scales.iter().zip([1.0, 2.0, 0.5]).all(|(found, expected)| (found - expected).abs() < 1e-6),
            "{scales:?}"
        );
        let opacity = values_of(scene.opacities())[0];
        assert!((opacity - 0.9).abs() < 1e-6, "{opacity}");
        // Coefficient by coefficient, the constant one first.
        assert_eq!(
            values_of(scene.sh_blocks().remove(0)),
            [0.1, 0.2, 0.3, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0]
        );
    }
}

/// Compares with `e⁻ˣ / (1 + e⁻ˣ)²` of the magnitude, because the derivative depends on the magnitude alone.
#[test]
fn opacities_within_rounding_of_one_keep_their_derivative() {
    let logits: Vec<f32> = (-40..=40).map(|i| 1.25 * i as f32).collect();
    let close = |found: f32, expected: f64| (f64::from(found) / expected - 1.0).abs() <= 1e-6;
    for device in devices() {
        let rows = GaussianRows { logit_opacities: logits.clone(), ..random_rows(logits.len(), 1, 2) };
        let scene = Gaussians::from_rows(&rows, &device.clone().autodiff()).unwrap();
        let opacities = scene.opacities();
        let gradient = scene.gradient("logit_opacities", &opacities.clone().sum().backward()).unwrap();
        let gradient = values_of(gradient);
        let plain = values_of(Gaussians::from_rows(&rows, &device).unwrap().opacities());
        assert_eq!(values_of(opacities), plain);
        for ((logit, value), gradient) in logits.iter().zip(plain).zip(gradient) {
            let logit = f64::from(*logit);
            let falling = (-logit.abs()).exp();
            assert!(close(value, 1.0 / (1.0 + (-logit).exp())), "{logit}: {value}");
            assert!(close(gradient, falling / (1.0 + falling).powi(2)), "{logit}: {gradient}");
        }
    }
}

#[test]
fn rows_that_do_not_fit_are_named() {
    type Spoil = fn(&mut GaussianRows);
    let cases: [(&str, Spoil); 7] = [
        ("rotations", |rows| rows.rotations.truncate(3)),
        ("log_scales", |rows| rows.log_scales.push([0.0; 3])),
        ("logit_opacities", |rows| rows.logit_opacities.clear()),
        ("sh_dc", |rows| rows.sh_dc.truncate(3)),
        ("sh_rest", |rows| rows.sh_rest.truncate(95)),
        ("sh_rest", |rows| rows.sh_degree = 3),
        ("sh_degree", |rows| rows.sh_degree = 5),
    ];
    for (field, spoil) in cases {
        let mut rows = random_rows(4, 2, 1);
        assert_eq!(rows.check(), Ok(()));
        spoil(&mut rows);
        let message = rows.check().unwrap_err().to_string();
        assert!(message.starts_with(&format!("`{field}` holds")), "{message}");
        assert!(Gaussians::from_rows(&rows, &Device::flex()).is_err());
    }
}

/// Whether each input of a render is tracked.
fn tracked(scene: &Gaussians) -> [bool; 5] {
    let Splats { means, rotations, scales, opacities, colour } = scene.splats();
    let Colour::SphericalHarmonics(sh) = colour else { panic!("a scene has spherical harmonics") };
    [means.is_tracked(), rotations.is_tracked(), scales.is_tracked(), opacities.is_tracked(), sh.is_tracked()]
}

#[test]
fn untracked_is_the_same_scene_without_autodiff() {
    for device in devices() {
        for degree in [0, 2] {
            let rows = random_rows(5, degree, 3);
            let scene = Gaussians::from_rows(&rows, &device.clone().autodiff()).unwrap();
            assert_eq!(tracked(&scene), [true; 5]);
            let plain = scene.untracked();
            assert_eq!(tracked(&plain), [false; 5]);
            assert_eq!(plain.splats().means.device(), device);
            assert_eq!(plain.to_rows(), rows);
            assert_eq!(plain.untracked().to_rows(), rows);
        }
    }
}

#[test]
fn a_scene_may_be_empty() {
    for device in devices() {
        for degree in [0, 1] {
            let rows = GaussianRows { sh_degree: degree, ..GaussianRows::default() };
            assert!(rows.is_empty());
            let scene = Gaussians::from_rows(&rows, &device.clone().autodiff()).unwrap();
            assert!(scene.is_empty());
            assert_eq!(scene.to_rows(), rows);
            assert_eq!(scene.sh_blocks().remove(0).dims(), [0, (degree + 1) * (degree + 1), 3]);
            assert!(scene.untracked().is_empty());
        }
    }
}

/// A scene of `count` Gaussians with a group of two numbers each.
fn with_features(count: usize, activation: Activation, device: &Device) -> Gaussians {
    let scene = Gaussians::from_rows(&random_rows(count, 1, 2), device).unwrap();
    let values: Vec<f32> = (0..2 * count).map(|i| i as f32 - 1.5).collect();
    let options = GroupOptions { activation, rate: 0.1, ..GroupOptions::default() };
    let group = Group::new("features", tensor(values, [count, 2], device), options).unwrap();
    scene.with_group(group).unwrap()
}

#[test]
fn groups_survive_a_round_trip() {
    for device in devices() {
        for device in [device.clone(), device.autodiff()] {
            let scene = with_features(7, Activation::Sigmoid, &device);
            let rows = scene.to_rows();
            assert_eq!(rows.groups[0].values[..4], [-1.5, -0.5, 0.5, 1.5]);
            assert_eq!(Gaussians::from_rows(&rows, &device).unwrap().to_rows(), rows);
            assert_eq!(scene.rows_in(2..4), rows.part(2..4));
            assert_eq!(scene.untracked().to_rows(), rows);
            assert_eq!(scene.group("features").unwrap().raw().is_require_grad(), device.is_autodiff());
        }
    }
}

#[test]
fn groups_are_activated() {
    let device = Device::flex();
    for (activation, expected) in [
        (Activation::Identity, [-1.5, -0.5]),
        (Activation::Exp, [(-1.5_f32).exp(), (-0.5_f32).exp()]),
        (Activation::Sigmoid, [sigmoid(-1.5) as f32, sigmoid(-0.5) as f32]),
        (Activation::Normalise, [-1.5 / 2.5_f32.sqrt(), -0.5 / 2.5_f32.sqrt()]),
    ] {
        let found = values_of(with_features(1, activation, &device).group("features").unwrap().values());
        assert!(found.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-6), "{activation:?}: {found:?}");
    }
    let zeros = Group::new(
        "a",
        Tensor::zeros([1, 2], &device),
        GroupOptions { activation: Activation::Normalise, ..GroupOptions::default() },
    );
    assert_eq!(values_of(zeros.unwrap().values()), [0.0; 2]);
}

#[test]
fn groups_that_do_not_fit_are_refused() {
    let device = Device::flex();
    let new = |name: &str, shape: [usize; 2]| Group::new(name, Tensor::zeros(shape, &device), GroupOptions::default());
    let scene = with_features(3, Activation::Identity, &device);
    let add = |name: &str, rows| scene.clone().with_group(new(name, [rows, 2]).unwrap()).unwrap_err().to_string();
    assert!(add("means", 3).contains("two groups are named `means`"));
    assert!(add("features", 3).contains("two groups are named `features`"));
    assert!(add("others", 4).contains("`others` holds 8 numbers, expected 6 for 3 Gaussians"));
    assert!(new("a/b", [3, 1]).unwrap_err().to_string().contains("a group named \"a/b\""));
    assert!(new("", [3, 1]).unwrap_err().to_string().contains("a group named \"\""));
    assert!(new("f_rest", [3, 9]).unwrap_err().to_string().contains("a group named \"f_rest\""));
    let wide = Tensor::zeros([3, 2], (&device, burn::tensor::DType::F64));
    let wide = Group::new("a", wide, GroupOptions::default()).unwrap();
    assert!(scene.clone().with_group(wide).unwrap_err().to_string().contains("the group `a` is on"));
    let tracked = with_features(3, Activation::Identity, &device.clone().autodiff());
    let tracked = tracked.with_group(new("a", [3, 2]).unwrap()).unwrap();
    assert!(tracked.group("a").unwrap().raw().is_require_grad());
    for (options, expected) in [
        (GroupOptions { rate: f64::NAN, ..GroupOptions::default() }, "`rate` of the group `a` is NaN"),
        (GroupOptions { final_share: 0.0, ..GroupOptions::default() }, "`final_share` of the group `a` is 0"),
        (GroupOptions { reset: Some(f32::INFINITY), ..GroupOptions::default() }, "`reset` of the group `a` is inf"),
    ] {
        let error = Group::new("a", Tensor::zeros([3, 2], &device), options).unwrap_err().to_string();
        assert!(error.contains(expected), "{error}");
    }
    assert!(new("a", [3, 0]).unwrap_err().to_string().contains("rows of 0 numbers"));
}

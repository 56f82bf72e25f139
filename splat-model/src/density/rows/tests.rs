use burn::tensor::{Device, Distribution};

use super::*;
use crate::density::rows_on;
use crate::gaussians::testing::{devices, random_rows};
use crate::gaussians::values_of;
use crate::gaussians::{GaussianRows, GroupOptions, NewRows};
use crate::optim::{Adam, LearningRates};

const RATES: LearningRates = LearningRates {
    means: 0.0,
    means_final_share: 1.0,
    scales: 0.01,
    rotations: 0.02,
    sh_dc: 0.03,
    sh_rest: 0.04,
    opacities: 0.05,
    others_final_share: 1.0,
};

fn scene(rows: &GaussianRows, device: &Device) -> Trained {
    Trained::new(Gaussians::from_rows(rows, &device.clone().autodiff()).unwrap())
}

/// The same with moments of some bits.
fn with_bits(rows: &GaussianRows, bits: MomentBits, device: &Device) -> Trained {
    Trained::with_bits(Gaussians::from_rows(rows, &device.clone().autodiff()).unwrap(), bits)
}

/// Random numbers like a group, without autodiff.
fn noise(group: &Group) -> Tensor<2> {
    group.raw().inner().random_like(Distribution::Uniform(-1.0, 1.0))
}

fn random_gradients(of: &Gaussians) -> Gradients {
    of.groups().iter().fold(Gradients::default(), |all, group| all.with(group.name(), noise(group)))
}

fn step(scene: &mut Trained, gradients: Gradients, step: usize) {
    scene.step(gradients, &Adam::default(), &StepRates { rates: RATES, means: 0.06, done: 0.0, views: 1 }, step, None);
}

/// A scene whose moments are all non-zero.
fn walked(rows: &GaussianRows, device: &Device) -> Trained {
    let mut scene = scene(rows, device);
    for i in 1..=3 {
        let gradients = random_gradients(&scene.gaussians);
        step(&mut scene, gradients, i);
    }
    scene
}

/// Values, first and second moments of one parameter.
type Numbers = [Vec<f32>; 3];

/// All values and moments of a scene, by group.
fn all(scene: &Trained) -> Vec<(String, Numbers)> {
    let numbers = |(group, moments): (&Group, &Vec<Moments<2>>)| {
        let [m, v] = moments[0].numbers();
        (group.name().to_owned(), [values_of(group.raw()), m, v])
    };
    scene.gaussians.groups().iter().zip(&scene.moments).map(numbers).collect()
}

/// The edit that keeps rows and adds others, whatever they come from.
fn edit_to(keep: &[u32], add: &GaussianRows, device: &Device) -> RowEdit {
    let added = Gaussians::from_rows(add, device).unwrap();
    let edit = RowEdit::new(rows_on(device, keep), rows_on(device, &vec![1; add.len()]));
    edit.with("means", added.means())
        .with("rotations", added.rotations())
        .with("log_scales", added.log_scales())
        .with("logit_opacities", added.logit_opacities())
        .with("sh", added.sh_blocks().remove(0))
}

/// Whether each parameter is tracked.
fn all_tracked(scene: &Gaussians) -> bool {
    scene.groups().iter().all(|group| group.raw().is_require_grad())
}

#[test]
fn an_edit_keeps_rows_with_their_moments() {
    for device in devices() {
        for degree in [0, 2] {
            let mut scene = walked(&random_rows(9, degree, 1), &device);
            let before = all(&scene);
            let keep = vec![7, 2, 8, 0, 5];
            let add = random_rows(3, degree, 2);
            scene.edit(&edit_to(&keep, &add, &device)).unwrap();

            let added = all(&self::scene(&add, &device));
            for (((name, new), (_, old)), (_, added)) in all(&scene).iter().zip(&before).zip(&added) {
                for (which, ((new, old), added)) in new.iter().zip(old).zip(added).enumerate() {
                    let width = old.len() / 9;
                    let row = |of: u32| &old[of as usize * width..(of as usize + 1) * width];
                    let expected: Vec<f32> = keep.iter().flat_map(|&of| row(of)).chain(added).copied().collect();
                    assert_eq!(new, &expected, "{name} {which}");
                    assert!(old.iter().all(|value| *value != 0.0), "{name} {which} has a history to mix up");
                }
            }
            assert!(all_tracked(&scene.gaussians));
            let gradients = random_gradients(&scene.gaussians);
            step(&mut scene, gradients, 4);
            assert_eq!(scene.gaussians.len(), 8);
        }
    }
}

/// Codes move with their rows, come back from a file bit for bit, and follow harmonics that are added.
#[test]
fn packed_moments_move_grow_and_resume() {
    for device in devices() {
        let mut scene = with_bits(&random_rows(9, 1, 1), MomentBits::Eight, &device);
        for i in 1..=3 {
            let gradients = random_gradients(&scene.gaussians);
            step(&mut scene, gradients, i);
        }
        let before = all(&scene);
        scene.edit(&edit_to(&[7, 2, 8], &random_rows(2, 1, 2), &device)).unwrap();
        for ((name, new), (_, old)) in all(&scene).iter().zip(&before) {
            for (new, old) in new[1..].iter().zip(&old[1..]) {
                let width = old.len() / 9;
                let kept: Vec<f32> = [7, 2, 8].iter().flat_map(|row| &old[row * width..][..width]).copied().collect();
                assert_eq!(new[..3 * width], kept, "{name}");
                assert!(new[3 * width..].iter().all(|code| *code == 0.0), "{name}");
            }
            assert!(old[1].iter().any(|code| *code != 0.0), "{name}");
        }
        scene.grow_sh(2);
        let mut state = scene.save().unwrap();
        let mut resumed = Trained::load(&mut state, MomentBits::Eight, &device.clone().autodiff()).unwrap();
        state.finish().unwrap();
        let gradients = random_gradients(&scene.gaussians);
        step(&mut resumed, gradients.clone(), 4);
        step(&mut scene, gradients, 4);
        assert_eq!(all(&resumed), all(&scene));
        let error = Trained::load(&mut scene.save().unwrap(), MomentBits::ThirtyTwo, &device).unwrap_err().to_string();
        assert!(error.contains("`means/m`"), "{error}");
    }
}

/// The dial's bound: the way of a run with packed moments is that of one in f32, but for a share.
#[test]
fn packed_moments_take_nearly_the_same_steps() {
    for device in devices() {
        let rows = random_rows(40, 2, 1);
        let (mut exact, mut other) = (scene(&rows, &device), with_bits(&rows, MomentBits::Eight, &device));
        let start = all(&exact);
        for i in 1..=20 {
            let gradients = random_gradients(&exact.gaussians);
            step(&mut exact, gradients.clone(), i);
            step(&mut other, gradients, i);
        }
        for (((name, a), (_, b)), (_, start)) in all(&exact).iter().zip(all(&other)).zip(&start) {
            let distance =
                |a: &[f32], b: &[f32]| a.iter().zip(b).map(|(a, b)| f64::from(a - b).powi(2)).sum::<f64>().sqrt();
            let (apart, way) = (distance(&a[0], &b[0]), distance(&a[0], &start[0]));
            assert!(apart > 0.0 && apart <= 0.15 * way, "{name}: {}", apart / way);
        }
    }
}

#[test]
fn all_rows_may_go_or_make_place_for_others() {
    for device in devices() {
        let mut scene = walked(&random_rows(4, 1, 1), &device);
        let add = random_rows(2, 1, 2);
        scene.edit(&edit_to(&[], &add, &device)).unwrap();
        assert_eq!(scene.gaussians.to_rows(), add);
        scene.edit(&RowEdit::new(rows_on(&device, &[]), rows_on(&device, &[]))).unwrap();
        assert!(scene.gaussians.is_empty());
        let gradients = random_gradients(&scene.gaussians);
        step(&mut scene, gradients, 4);
    }
}

/// A new row has the values of the row that it comes from, in every parameter that the edit does not name, and no history.
#[test]
fn a_new_row_inherits_what_the_edit_does_not_name() {
    for device in devices() {
        let mut scene = walked(&random_rows(4, 1, 1), &device);
        let before = scene.gaussians.to_rows();
        let means = Tensor::<2>::from_floats([[9.0, 8.0, 7.0], [6.0, 5.0, 4.0]], &device);
        scene.edit(&RowEdit::new(rows_on(&device, &[3]), rows_on(&device, &[2, 2])).with("means", means)).unwrap();
        let mut expected = GaussianRows { sh_degree: 1, ..GaussianRows::default() };
        [3, 2, 2].iter().for_each(|&i| expected.push(&before, i));
        (expected.means[1], expected.means[2]) = ([9.0, 8.0, 7.0], [6.0, 5.0, 4.0]);
        assert_eq!(scene.gaussians.to_rows(), expected);
        for (name, [values, m, v]) in all(&scene) {
            let width = values.len() / 3;
            assert!(m[..width].iter().chain(&v[..width]).all(|sum| *sum != 0.0), "{name}");
            assert!(m[width..].iter().chain(&v[width..]).all(|sum| *sum == 0.0), "{name}");
        }
    }
}

#[test]
fn a_refused_edit_changes_nothing() {
    let device = Device::flex();
    let mut scene = walked(&random_rows(4, 1, 1), &device);
    let before = all(&scene);
    let one = || RowEdit::new(rows_on(&device, &[0]), rows_on(&device, &[1, 2]));
    for (edit, expected) in [
        (edit_to(&[0], &random_rows(2, 0, 2), &device), "`sh` holds 6 numbers, expected 24 for 2 Gaussians"),
        (one().with("means", Tensor::<2>::zeros([1, 3], &device)), "`means` holds 3 numbers, expected 6"),
        (one().with("normals", Tensor::<2>::zeros([2, 3], &device)), "`normals` holds 6 numbers, expected 0"),
    ] {
        let error = scene.edit(&edit).unwrap_err().to_string();
        assert!(error.contains(expected), "{error}");
        assert_eq!(all(&scene), before);
    }
}

/// Sets the coefficients above `degree` to zero.
fn cut(sh: Tensor<2>, degree: usize) -> Tensor<2> {
    let (have, all) = (3 * (degree + 1) * (degree + 1), sh.dims()[1]);
    if have == all {
        return sh;
    }
    Tensor::cat(vec![sh.clone().narrow(1, 0, have), sh.narrow(1, have, all - have).zeros_like()], 1)
}

#[test]
fn harmonics_that_come_later_are_as_if_they_had_always_been_there() {
    for device in devices() {
        let rows = random_rows(6, 0, 1);
        let (mut grown, mut full) = (scene(&rows, &device), scene(&rows, &device));
        full.grow_sh(3);
        for i in 1..=8 {
            // Each degree is requested twice.
            let degree = (i - 1) / 2;
            grown.grow_sh(degree);
            assert_eq!(grown.gaussians.sh_degree(), degree);
            assert!(all_tracked(&grown.gaussians));
            let gradients = random_gradients(&full.gaussians);
            let sh = cut(gradients.get("sh").unwrap(), degree);
            let own = gradients.clone().with("sh", sh.clone().narrow(1, 0, 3 * (degree + 1) * (degree + 1)));
            let gradients = gradients.with("sh", sh);
            step(&mut grown, own, i);
            step(&mut full, gradients, i);
        }
        assert_eq!(all(&grown), all(&full));
        // The degree does not fall, and a repeated request does nothing.
        let before = all(&grown);
        grown.grow_sh(1);
        grown.grow_sh(3);
        assert_eq!(all(&grown), before);
    }
}

/// Asserts that two scenes agree except in one parameter, and returns that parameter of the second scene.
#[track_caller]
fn assert_only_changed(before: &Trained, after: &Trained, changed: &str) -> Numbers {
    let mut of_changed = None;
    for ((name, old), (_, new)) in all(before).into_iter().zip(all(after)) {
        if name == changed {
            of_changed = Some(new);
        } else {
            assert_eq!(new, old, "{name}");
        }
    }
    of_changed.expect("the parameter is one of the scene's")
}

#[test]
fn reset_opacities_forget_their_history_only() {
    for device in devices() {
        let before = walked(&random_rows(5, 1, 1), &device);
        let mut after = before.clone();
        let logits = Tensor::from_floats([-1.0, -2.0, -3.0, -4.0, -5.0], &device);
        after.reset_opacities(logits);
        let [values, m, v] = assert_only_changed(&before, &after, "logit_opacities");
        assert_eq!(values, [-1.0, -2.0, -3.0, -4.0, -5.0]);
        assert_eq!((m, v), (vec![0.0; 5], vec![0.0; 5]));
        assert!(all_tracked(&after.gaussians));
    }
}

#[test]
fn replaced_log_scales_keep_their_history() {
    let device = Device::flex();
    let before = walked(&random_rows(2, 1, 1), &device);
    let mut after = before.clone();
    after.replace_log_scales(Tensor::full([2, 3], -4.0, &device));
    let [values, m, v] = assert_only_changed(&before, &after, "log_scales");
    assert_eq!(values, [-4.0; 6]);
    assert_eq!([&m, &v], [&all(&before)[2].1[1], &all(&before)[2].1[2]]);
    assert!(all_tracked(&after.gaussians));
}

#[test]
fn parameters_without_a_gradient_stay() {
    for device in devices() {
        let before = walked(&random_rows(5, 1, 1), &device);
        let mut after = before.clone();
        step(&mut after, Gradients::default().with("rotations", noise(&before.gaussians.groups()[1])), 4);
        let rotations = assert_only_changed(&before, &after, "rotations");
        for (new, old) in rotations.iter().zip(&all(&before)[1].1) {
            assert!(new.iter().zip(old).all(|(new, old)| new != old));
        }
    }
}

#[test]
fn each_parameter_has_its_own_rate() {
    // Adam's first step has the size of the learning rate for any gradient.
    for (device, degree) in devices().into_iter().flat_map(|device| (0..4).map(move |degree| (device.clone(), degree)))
    {
        let rows = random_rows(3, degree, 1);
        let mut scene = scene(&rows, &device);
        let before = all(&scene);
        let gradients = random_gradients(&scene.gaussians);
        step(&mut scene, gradients, 1);
        let rates = [0.06, RATES.rotations, RATES.scales, RATES.opacities, RATES.sh_rest];
        for (((name, new), (_, old)), rate) in all(&scene).iter().zip(&before).zip(rates) {
            let per_row = new[0].len() / 3;
            for (at, (new, old)) in new[0].iter().zip(&old[0]).enumerate() {
                let rate = if name == "sh" && at % per_row < 3 { RATES.sh_dc } else { rate };
                assert!((f64::from((new - old).abs()) - rate).abs() < 1e-6, "{name} {at}: {}", new - old);
            }
        }
    }
}

/// A scene with a group of two numbers each, beginning at 1.
fn with_features(rows: &GaussianRows, options: GroupOptions, bits: MomentBits, device: &Device) -> Trained {
    let numbers = Tensor::arange(0..2 * rows.len() as i64, device).float() + 1.0;
    let group = Group::new("features", numbers.reshape([rows.len(), 2]), options).unwrap();
    with_bits(rows, bits, device).with_group(group).unwrap()
}

/// Everything that carries the five parameters carries a group of one's own.
#[test]
fn a_group_of_ones_own_is_carried_along() {
    let all_bits = [MomentBits::ThirtyTwo, MomentBits::Eight];
    for (device, bits) in devices().into_iter().flat_map(|device| all_bits.map(|bits| (device.clone(), bits))) {
        let options = GroupOptions { rate: 0.5, final_share: 0.01, reset: Some(7.0), ..GroupOptions::default() };
        let mut scene = with_features(&random_rows(4, 1, 1), options, bits, &device);
        let features = |scene: &Trained| values_of(scene.gaussians.group("features").unwrap().raw());
        // Adam's first step has the length of its rate, which has fallen to a tenth in the middle of the run and doubled by
        // four views.
        let rates = StepRates { rates: RATES, means: 0.06, done: 0.5, views: 4 };
        scene.step(
            Gradients::default().with("features", Tensor::<2>::ones([4, 2], &device)),
            &Adam::default(),
            &rates,
            1,
            None,
        );
        let moved = features(&scene);
        assert!(moved.iter().enumerate().all(|(i, value)| (value - (i as f32 + 0.9)).abs() < 1e-3), "{moved:?}");
        // New rows are copies without a history.
        scene.edit(&RowEdit::new(rows_on(&device, &[3, 1]), rows_on(&device, &[1]))).unwrap();
        assert_eq!(features(&scene), [&moved[6..8], &moved[2..4], &moved[2..4]].concat());
        let [m, _] = scene.moments[5][0].numbers();
        assert!(
            m[..m.len() / 3].iter().any(|value| *value != 0.0)
                && m[m.len() / 3 * 2..].iter().all(|value| *value == 0.0)
        );
        // A checkpoint has the group with its options and its moments.
        let mut state = scene.save().unwrap();
        let resumed = Trained::load(&mut state, bits, &device.clone().autodiff()).unwrap();
        state.finish().unwrap();
        assert_eq!(all(&resumed), all(&scene));
        assert_eq!(resumed.gaussians.group("features").unwrap().options(), &options);
        // A reset of opacities resets it too.
        scene.reset_opacities(Tensor::zeros([3], &device));
        assert_eq!(features(&scene), [7.0; 6]);
        assert!(scene.moments[5][0].numbers()[0].iter().all(|value| *value == 0.0));
        assert!(all_tracked(&scene.gaussians));
    }
}

#[test]
fn new_rows_of_a_group_may_have_a_value_of_their_own() {
    let device = Device::flex();
    let options = GroupOptions { new_rows: NewRows::Filled(-1.0), ..GroupOptions::default() };
    let mut scene = with_features(&random_rows(3, 0, 1), options, MomentBits::ThirtyTwo, &device);
    let edit = RowEdit::new(rows_on(&device, &[2]), rows_on(&device, &[0, 1]));
    scene.edit(&edit).unwrap();
    let features = |scene: &Trained| values_of(scene.gaussians.group("features").unwrap().raw());
    assert_eq!(features(&scene), [5.0, 6.0, -1.0, -1.0, -1.0, -1.0]);
    // An edit that names values has the last word, and a rate of 0 keeps them.
    let edit = RowEdit::new(rows_on(&device, &[0]), rows_on(&device, &[0]));
    scene.edit(&edit.with("features", Tensor::<2>::full([1, 2], 9.0, &device))).unwrap();
    let gradients = random_gradients(&scene.gaussians);
    step(&mut scene, gradients, 1);
    assert_eq!(features(&scene), [5.0, 6.0, 9.0, 9.0]);
}

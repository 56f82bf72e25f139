//! Tests that the judge can fail a result: each rule, broken alone, fails a result that otherwise equals the reference.

use super::*;
use crate::case::MeasuredDeviation;
use crate::compare::largest;
use crate::scene::Splat;

fn reference() -> CaseReference {
    let hard = Splat::at([20.3, 18.6], 3.0, 2.0);
    let neighbour = Splat::at([50.2, 8.4], 2.0, 1.0).colour(&[0.3, 0.9, 0.6]);
    CaseReference::new(&HardScene::new("plain", &[hard]).with_neighbour(&neighbour))
}

fn place() -> TestDevice {
    TestDevice { name: "flex".into(), device: Device::flex(), processor: Processor::Cpu, software: false }
}

/// Judges the reference with one change to a gradient or a picture.
fn changed(reference: &CaseReference, change: impl Fn(&mut Outputs, &Outputs)) -> CaseOutcome {
    let mut found = reference.expected.clone();
    change(&mut found, &reference.spread);
    reference.compare(&found, 1.0)
}

#[test]
fn the_truth_passes_and_is_not_off() {
    let reference = reference();
    assert_eq!(reference.remarks, Vec::<String>::new());
    let outcome = changed(&reference, |_, _| {});
    assert!(outcome.passed(), "{:?}", outcome.failures);
    assert_eq!(outcome.forward, Some(MeasuredDeviation::default()));
    assert_eq!(outcome.gradient, Some(MeasuredDeviation::default()));
    let outcome = reference.judge(&place(), 1.0);
    assert!(outcome.passed(), "{:?}", outcome.failures);
}

#[test]
fn what_is_not_finite_fails() {
    let reference = reference();
    for value in [f64::NAN, f64::INFINITY] {
        let picture = changed(&reference, |found, _| found.pictures[1].values[700] = value);
        let gradient = changed(&reference, |found, _| found.gradients[6].values[3] = value);
        assert!(!picture.passed() && !gradient.passed());
        assert!(gradient.failures.iter().any(|failure| failure.contains("pose is not finite")));
    }
}

#[test]
fn twice_the_ceiling_fails_and_half_of_it_passes() {
    let reference = reference();
    // The hard Gaussian's smallest element and the background's largest, so that no other error hides either.
    for (tensor, element) in [(0, 0), (1, 1), (2, 2), (3, 0), (5, 1), (6, 7), (7, 1)] {
        for (share, passes) in [(0.5, true), (2.0, false)] {
            let outcome = changed(&reference, |found, spread| {
                let spread = 16.0 * spread.gradients[tensor].values[element];
                found.gradients[tensor].values[element] += share * spread.max(1e-30);
                // The part of the ceiling that the floor adds.
                if share > 1.0 {
                    let largest = largest(&found.gradients[tensor].values);
                    found.gradients[tensor].values[element] += share * 1e-6 * largest;
                }
            });
            assert_eq!(outcome.passed(), passes, "{tensor}, {element}, {share}: {:?}", outcome.failures);
        }
    }
}

#[test]
fn a_row_that_is_off_fails_though_its_elements_are_below_the_ceiling() {
    let mut reference = reference();
    // A spread as if the last digits of the inputs had much effect, but less than the tolerance of a row.
    let expected = reference.expected.gradients[0].values.clone();
    let spread = &mut reference.spread.gradients[0].values;
    spread.iter_mut().zip(&expected).for_each(|(spread, expected)| *spread = 5e-4 * expected.abs());
    let off =
        |share: f64| changed(&reference, |found, _| found.gradients[0].values.iter_mut().for_each(|v| *v *= share));
    assert!(off(1.0 + 5e-4).passed());
    let outcome = off(1.0 + 2e-3);
    assert!(outcome.gradient.is_some_and(|score| score.used < 1.0));
    assert!(outcome.failures.iter().any(|failure| failure.contains("rows are off")), "{:?}", outcome.failures);
}

#[test]
fn a_neighbour_that_changes_fails() {
    let reference = reference();
    let place = place();
    let found = evaluate(&reference.scene, &reference.weights, &place.device, DType::F32);
    assert!(reference.judge_neighbours(&found, &place).passed());
    let one_ulp = |value: &mut f64| *value = f64::from((*value as f32).next_up());
    let mut other = found.clone();
    one_ulp(&mut other.gradients[2].values[4]);
    assert!(!reference.judge_neighbours(&other, &place).passed(), "a gradient");
    let mut other = found.clone();
    one_ulp(&mut other.pictures[0].values[3 * (8 * 60 + 50)]);
    assert!(!reference.judge_neighbours(&other, &place).passed(), "a pixel");
    // A neighbour that the hard Gaussian covers proves nothing.
    let covered = HardScene::new("covered", &[Splat::at([20.0, 18.0], 3.0, 2.0)]).with_neighbour(&Splat::at(
        [22.0, 18.0],
        2.0,
        1.0,
    ));
    let outcome = CaseReference::new(&covered).judge(&place, 1.0);
    assert!(outcome.failures.iter().any(|failure| failure.contains("covered")), "{:?}", outcome.failures);
}

#[test]
fn a_splat_culled_without_reason_fails() {
    let scene = HardScene::new("behind", &[Splat::at([20.0, 18.0], -3.0, 2.0), Splat::at([20.0, 18.0], 3.0, 2.0)]);
    for (culled, passes) in [(vec![0], true), (vec![], false), (vec![0, 1], false), (vec![1], false)] {
        let outcome = CaseReference::new(&scene.clone().with_culled(&culled)).judge(&place(), 1.0);
        assert_eq!(outcome.passed(), passes, "{culled:?}: {:?}", outcome.failures);
    }
}

#[test]
fn a_truth_that_disagrees_with_the_twin_is_remarked_on() {
    // The twin culls a zero quaternion, and the papers' formulas make it NaN.
    let scene = HardScene::new("zero", &[Splat::at([20.0, 18.0], 3.0, 2.0).quat([0.0; 4])]);
    assert!(!CaseReference::new(&scene).remarks.is_empty());
}

#[test]
fn loose_bounds_hold_where_they_are_given_and_never_pass() {
    let case = |loose: bool| {
        let case = HardCase::check("three times", "", |_| CaseOutcome::default());
        if loose { case.loose(Processor::Cpu, 3.0, "because") } else { case }
    };
    assert_eq!(judge(&case(false), &[place()]).verdict(), CaseVerdict::Passed);
    assert_eq!(judge(&case(true), &[place()]).verdict(), CaseVerdict::Loose);
    let gpu = TestDevice { processor: Processor::Gpu, ..place() };
    assert_eq!(judge(&case(true), std::slice::from_ref(&gpu)).verdict(), CaseVerdict::Passed);
    assert_eq!((case(true).limit(Processor::Cpu), case(true).limit(Processor::Gpu)), (3.0, 1.0));
    let fails =
        HardCase::check("fails", "", |_| CaseOutcome { failures: vec!["it does".into()], ..CaseOutcome::default() });
    let row = judge(&fails, &[place()]);
    assert_eq!((row.verdict(), row.failures()), (CaseVerdict::Failed, vec!["flex: it does".to_owned()]));
    // A case that drivers in software cannot run is left out on them alone.
    let software = TestDevice { software: true, ..gpu };
    let beyond = || HardCase::check("fails", "", |_| panic!("ran")).beyond_software("because");
    assert!(judge(&beyond(), &[software]).places.is_empty());
}

use burn::tensor::DType;
use splat_op::CameraModel;

use super::super::testing::{
    FIELDS, average, camera, check_gradient, distance, ellipses, host, numbers, pose, render, tensor, varied,
};
use super::*;

const APERTURE: f64 = 0.12;
const FOCUS: f64 = 3.6;

fn parameters(aperture: f64) -> (Tensor<1>, Tensor<1>) {
    (tensor(&[aperture.ln()], [1], DType::F64), tensor(&[1.0 / FOCUS], [1], DType::F64))
}

#[test]
fn circles_are_those_of_a_thin_lens() {
    let (log_aperture, inverse_focus) = parameters(0.5);
    let given = [
        0.0,
        0.0,
        0.0,
        0.0,
        0.0,
        0.0,
        1.0,
        1.0,
        1.0,
        0.0,
        0.0,
        0.0,
        1.0,
        1.0,
        1.0,
        FOCUS,
        2.0 * FOCUS,
        0.9,
        1.0,
        1.0,
        1.0,
    ];
    let given = ellipses(&tensor(&given, [FIELDS * 3], DType::F64), 3);
    let radii = host(confusion(&given, &camera(), &log_aperture, &inverse_focus).unwrap());
    // 0 in focus; −½ · 1/7.2 behind it; ½ (1/0.9 − 1/3.6) = 5/12 in front of it; times 40 px and 44 px.
    let expected = [0.0, 0.0, -20.0 / 7.2, -22.0 / 7.2, 50.0 / 3.0, 55.0 / 3.0];
    assert!(distance(&radii, &expected) < 1e-12, "{radii:?}");
}

#[test]
fn a_blurred_ellipse_is_the_average_over_the_aperture() {
    let camera = camera();
    // Points of equal area on a disc, and their opposites.
    let golden = std::f64::consts::PI * (3.0 - 5.0_f64.sqrt());
    let points = (0..32).flat_map(|i| {
        let (radius, angle) = (APERTURE * ((f64::from(i) + 0.5) / 32.0).sqrt(), golden * f64::from(i));
        let (x, y) = (radius * angle.cos(), radius * angle.sin());
        [[x, y], [-x, -y]]
    });
    // The camera moves over the aperture, and the picture moves so that points in focus stay.
    let pictures: Vec<_> = points
        .map(|[x, y]| {
            let mut moved = camera;
            moved.cx += camera.fx * x / FOCUS;
            moved.cy += camera.fy * y / FOCUS;
            let shift = tensor(&[0.0, 0.0, 0.0, -x, 0.0, 0.0, 0.0, -y, 0.0, 0.0, 0.0, 0.0], [3, 4], DType::F64);
            render(moved, pose() + shift, |e| e)
        })
        .collect();
    let truth = average(&pictures);
    let sharp = render(camera, pose(), |e| e);
    let (log_aperture, inverse_focus) = parameters(APERTURE);
    let found = render(camera, pose(), |e| {
        let radii = confusion(&e, &camera, &log_aperture, &inverse_focus).unwrap();
        blurred(e, radii)
    });
    let (without, with) = (distance(&sharp, &truth), distance(&found, &truth));
    assert!(without > 4e-4 && with < 0.1 * without, "{with:e}, and {without:e} without an aperture");
}

#[test]
fn without_an_aperture_nothing_changes() {
    let before = tensor(&varied(9), [FIELDS * 9], DType::F64);
    let given = || ellipses(&before, 9);
    let (log_aperture, inverse_focus) = parameters(0.0);
    let radii = confusion(&given(), &camera(), &log_aperture, &inverse_focus).unwrap();
    assert_eq!(host(numbers(blurred(given(), radii))), host(before.clone()), "to the last bit");
}

#[test]
fn gradients_are_those_of_differences_in_focus_too() {
    let count = 5;
    let mut at = [varied(count), vec![0.4_f64.ln(), 1.0 / FOCUS]].concat();
    at[5 * count] = FOCUS;
    check_gradient(&at, |values| {
        let given = ellipses(&values, count);
        let (log_aperture, inverse_focus) =
            (values.clone().narrow(0, FIELDS * count, 1), values.narrow(0, FIELDS * count + 1, 1));
        let radii = confusion(&given, &camera(), &log_aperture, &inverse_focus).unwrap();
        numbers(blurred(given, radii))
    });
}

#[test]
fn a_culled_gaussian_stays_and_has_no_say() {
    let device = burn::tensor::Device::flex().autodiff();
    let row = [0.0, 0.0, 1.0, 0.0, 1.0, 0.0, 0.0];
    let given = ellipses(&Tensor::from_floats(row, &device), 1);
    let log_aperture = Tensor::<1>::from_floats([1.0], &device).require_grad();
    let inverse_focus = Tensor::<1>::from_floats([0.5], &device).require_grad();
    let radii = confusion(&given, &camera(), &log_aperture, &inverse_focus).unwrap();
    let after = numbers(blurred(given, radii.clone()));
    assert_eq!(host(after.clone().inner()), row);
    let mut gradients = (after.sum() + radii.sum()).backward();
    assert_eq!(host(log_aperture.grad_remove(&mut gradients).unwrap()), [0.0]);
    assert_eq!(host(inverse_focus.grad_remove(&mut gradients).unwrap()), [0.0]);
}

#[test]
fn a_lens_is_refused() {
    let camera = Intrinsics { model: CameraModel::OpenCv, ..camera() };
    let given = ellipses(&tensor(&varied(2), [FIELDS * 2], DType::F64), 2);
    let (log_aperture, inverse_focus) = parameters(0.1);
    let error = confusion(&given, &camera, &log_aperture, &inverse_focus).unwrap_err();
    assert_eq!(error, ScreenError::Lens(CameraModel::OpenCv));
}

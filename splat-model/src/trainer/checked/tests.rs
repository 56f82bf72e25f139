//! Each check reports errors of its stage. A test of the guard covers that a sound step passes all checks.

use burn::tensor::{Device, Int, TensorData};
use splat_op::{Ellipses, Intrinsics, RenderOptions};

use super::*;

fn device() -> Device {
    Device::flex()
}

fn column(values: [f32; 3]) -> Tensor<1> {
    Tensor::from_floats(values, &device())
}

/// Three Gaussians, the second of them culled.
fn ellipses() -> Ellipses {
    Ellipses {
        mean2d: Tensor::from_floats([[1.0, 2.0], [0.0, 0.0], [-1e6, 5.0]], &device()),
        sigma_u: column([1.0, 1.0, 0.5]),
        shear: column([-0.3, 0.0, 1e6]),
        sigma_v: column([1.0, 1.0, 1e-3]),
        depth: column([1.0, 0.0, 9.0]),
        opacity: column([1.0, 0.0, 0.5]),
    }
}

fn projected(ellipses: Ellipses) -> Projected {
    ellipses.pack(&Intrinsics::centred(16, 16, 10.0)).unwrap()
}

#[track_caller]
fn assert_wrong<T: std::fmt::Debug>(found: Result<T, Wrong>, stage: RenderStage, parts: &[&str]) {
    let wrong = found.expect_err("wrong");
    assert_eq!(wrong.stage, stage, "{}", wrong.detail);
    parts.iter().for_each(|part| assert!(wrong.detail.contains(part), "{part:?} is not in: {}", wrong.detail));
}

#[test]
fn ellipses_are_looked_at_column_by_column() {
    assert_eq!(check_projected(&projected(ellipses())), Ok(vec![1.0, 0.0, 0.5]));
    type Spoil = (&'static str, fn(&mut Ellipses));
    let cases: [Spoil; 7] = [
        ("mean2d", |e| e.mean2d = e.mean2d.clone() * f32::INFINITY),
        ("sigma_u", |e| e.sigma_u = column([1.0, 1.0, 0.0])),
        ("shear", |e| e.shear = column([0.0, 0.0, f32::NAN])),
        ("sigma_v", |e| e.sigma_v = column([1.0, 1.0, -1.0])),
        ("depth", |e| e.depth = column([1.0, 0.0, f32::INFINITY])),
        ("opacity", |e| e.opacity = column([1.0, 0.0, 1.001])),
        ("opacity", |e| e.opacity = column([1.0, 0.0, f32::NAN])),
    ];
    for (field, spoil) in cases {
        let mut wrong = ellipses();
        spoil(&mut wrong);
        let row = if field == "mean2d" { "Gaussian 0" } else { "Gaussian 2" };
        assert_wrong(check_projected(&projected(wrong)), RenderStage::Project, &[&format!("`{field}`"), row]);
    }
}

#[test]
fn colours_matter_only_where_something_is_drawn() {
    let colours = |bad| Tensor::from_floats([[0.1, 0.2, 0.3], [0.0, bad, 0.0], [0.0, 5.0, 1.0]], &device());
    assert_eq!(check_colours(&colours(f32::NAN), &[1.0, 0.0, 0.5]), Ok(()));
    let found = check_colours(&colours(f32::NAN), &[1.0, 0.1, 0.5]);
    assert_wrong(found, RenderStage::Sh, &["Gaussian 1", "NaN", "1 of 9"]);
}

#[test]
fn a_picture_is_finite_and_hides_no_more_than_all() {
    let picture = |colour: f32, alpha: f32| Rendered {
        colour: Tensor::from_floats([[[0.0, colour, 7.0], [0.0, 0.0, 0.0]]], &device()),
        alpha: Tensor::from_floats([[[0.0], [alpha]]], &device()),
        depth: None,
    };
    assert_eq!(check_picture(&picture(-2.0, 1.0)), Ok(()));
    assert_wrong(check_picture(&picture(f32::INFINITY, 1.0)), RenderStage::Rasterize, &["`colour` of pixel 0", "inf"]);
    assert_wrong(check_picture(&picture(0.0, 1.1)), RenderStage::Rasterize, &["`alpha` of pixel 1", "1.1", "0 to 1"]);
    assert_wrong(check_picture(&picture(0.0, f32::NAN)), RenderStage::Rasterize, &["`alpha`"]);
}

#[test]
fn no_tile_lists_more_gaussians_than_there_are() {
    let options = RenderOptions::standard();
    let intersections = intersect(&projected(ellipses()), &options).unwrap();
    assert_eq!(check_intersections(&intersections, 3), Ok(()));
    for count in [-1, 4] {
        let data = TensorData::new(vec![3_i32, count], [1, 2]);
        let mut wrong = intersections.clone();
        wrong.counts = Tensor::<2, Int>::from_data(data, &device());
        assert_wrong(check_intersections(&wrong, 3), RenderStage::Intersect, &["tile 1", &count.to_string(), "0 to 3"]);
    }
}

use burn::tensor::Device;
use glam::DAffine3;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use splat_op::{Intrinsics, RenderOptions};

use super::*;
use crate::gaussians::GaussianRows;

fn push(rows: &mut GaussianRows, mean: [f32; 3], log_scale: f32, logit: f32) {
    rows.means.push(mean);
    rows.rotations.push([1.0, 0.0, 0.0, 0.0]);
    rows.log_scales.push([log_scale; 3]);
    rows.logit_opacities.push(logit);
    rows.sh_dc.push([0.5; 3]);
}

/// Camera at the origin that looks along z.
fn contribution(rows: &GaussianRows) -> Contribution {
    let camera = (Intrinsics::centred(40, 30, 40.0), DAffine3::IDENTITY);
    Contribution::of(rows, [camera], &RenderOptions::standard(), &Device::flex(), || ()).unwrap()
}

#[test]
fn the_weights_of_a_picture_are_what_it_covers() {
    // An opaque wall, a faint Gaussian before it, one behind it, and one behind the camera.
    let mut rows = GaussianRows::default();
    push(&mut rows, [0.0, 0.0, 4.0], 4.0, 9.0);
    push(&mut rows, [0.0, 0.0, 2.0], -2.0, -0.8);
    push(&mut rows, [0.0, 0.0, 6.0], -2.0, 9.0);
    push(&mut rows, [0.0, 0.0, -2.0], -2.0, 9.0);
    let found = contribution(&rows);
    let sum: f32 = found.total_px.iter().sum();
    // The wall lets through at most 1% where nothing else is.
    assert!(sum <= 40.0 * 30.0 && sum > 0.98 * 40.0 * 30.0, "{found:?}");
    // A Gaussian of opacity o and standard deviation σ covers 2π o σ² px: 0.31 · 2π · (2.7² + 0.3) px here.
    assert!((found.total_px[1] - 14.8).abs() < 0.5, "{found:?}");
    assert_eq!(found.is_front, [true, false, false, false], "{found:?}");
    assert_eq!([0, 1, 2, 3].map(|row| found.is_unseen(row)), [false, false, false, true], "{found:?}");
    assert_eq!(found.total_px, found.most_px);
    // Two pictures: the sum doubles, the largest stays.
    let camera = (Intrinsics::centred(40, 30, 40.0), DAffine3::IDENTITY);
    let mut pictures = 0;
    let twice = Contribution::of(&rows, [camera; 2], &RenderOptions::standard(), &Device::flex(), || pictures += 1);
    let twice = twice.unwrap();
    assert_eq!((pictures, &twice.most_px, twice.total_px[0]), (2, &found.most_px, 2.0 * found.total_px[0]));
}

#[test]
fn a_faint_gaussian_before_nothing_is_no_front() {
    let mut rows = GaussianRows::default();
    push(&mut rows, [0.0, 0.0, 2.0], -1.5, -0.8);
    assert_eq!(contribution(&rows).is_front, [false]);
    rows.logit_opacities[0] = 3.0;
    assert_eq!(contribution(&rows).is_front, [true]);
}

#[test]
fn a_gaussian_in_free_space_is_isolated_and_a_sparse_scene_is_not() {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let mut means: Vec<[f32; 3]> = Vec::new();
    let cloud = |means: &mut Vec<[f32; 3]>, count: usize, middle: [f32; 3], radius: f32, rng: &mut ChaCha8Rng| {
        means.extend((0..count).map(|_| middle.map(|x| x + radius * rng.random_range(-1.0..1.0))));
    };
    // A dense object, scenery a hundred times as sparse, and three floaters between them.
    cloud(&mut means, 2000, [0.0; 3], 1.0, &mut rng);
    cloud(&mut means, 500, [300.0, 0.0, 0.0], 60.0, &mut rng);
    means.extend([[0.0, 3.0, 0.0], [0.0, 3.1, 0.0], [5.0, 0.0, -4.0]]);
    let of = |means: &[[f32; 3]], log_scale: f32| {
        let mut rows = GaussianRows::default();
        means.iter().for_each(|mean| push(&mut rows, *mean, log_scale, 0.0));
        isolated(&rows, ISOLATED)
    };
    let found = of(&means, -3.0);
    assert_eq!(found[2500..], [true; 3]);
    assert_eq!(found[..2500].iter().filter(|isolated| **isolated).count(), 0);
    // The unit of the scene does not count.
    let small: Vec<[f32; 3]> = means.iter().map(|mean| mean.map(|x| 2.0_f32.powi(-10) * x)).collect();
    assert_eq!(of(&small, -3.0 - 10.0 * 2.0_f32.ln()), found);
    // One that reaches its neighbours is not alone.
    assert_eq!(of(&means, 2.0)[2500..], [false; 3]);
    // Nor do duplicates count, or scenes without neighbours.
    assert_eq!(of(&[[1.0; 3]; 40], -3.0), [false; 40]);
    assert_eq!(of(&means[..16], -3.0), [false; 16]);
}

#[test]
fn the_bulk_ignores_outliers() {
    let mut values: Vec<[f32; 3]> = (0..=100).map(|i| [i as f32, 0.1 * i as f32, 5.0]).collect();
    let bulk = Bulk::of(&values).unwrap();
    assert_eq!((bulk.low[0], bulk.middle[0], bulk.high[0], bulk.width), (5.0, 50.0, 95.0, 90.0));
    values.push([1e30, 0.0, 5.0]);
    values.push([-1e30, 0.0, 5.0]);
    let spoilt = Bulk::of(&values).unwrap();
    assert!((spoilt.width - 90.0).abs() <= 2.0, "{spoilt:?}");
    assert!(
        spoilt.holds(&[-1000.0, 1000.0, 5.0]) && !spoilt.holds(&[1e30, 0.0, 5.0]) && !spoilt.holds(&[0.0, -1e4, 5.0])
    );
    assert_eq!(Bulk::of(&[]), None);
}

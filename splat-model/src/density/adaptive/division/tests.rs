use burn::tensor::Device;

use super::*;
use crate::density::pick::rows_on;
use crate::gaussians::testing::{devices, random_rows};
use crate::gaussians::{GaussianRows, sigmoid, values_of};

/// The rows `of` of some rows, with what a function makes of them, on a device.
fn divided(
    rows: &GaussianRows,
    of: &[u32],
    copies: usize,
    device: &Device,
    divide: impl Fn(&Gaussians, &Tensor<1, Int>) -> Divided,
) -> GaussianRows {
    let Divided { means, log_scales, logit_opacities } =
        divide(&Gaussians::from_rows(rows, device).unwrap(), &rows_on(device, of));
    let mut new = GaussianRows { sh_degree: rows.sh_degree, ..GaussianRows::default() };
    (0..copies).for_each(|_| of.iter().for_each(|&i| new.push(rows, i as usize)));
    let triples = |values: Tensor<2>| values_of(values).as_chunks::<3>().0.to_vec();
    (new.means, new.log_scales, new.logit_opacities) =
        (triples(means), triples(log_scales), values_of(logit_opacities));
    new
}

/// Row `i` with the centre, size and opacity of row `k` of others.
fn placed(rows: &GaussianRows, i: usize, other: &GaussianRows, k: usize) -> GaussianRows {
    let mut one = rows.part(i..i + 1);
    one.means[0] = other.means[k];
    one.log_scales[0] = other.log_scales[k];
    one.logit_opacities[0] = other.logit_opacities[k];
    one
}

#[test]
fn parts_are_drawn_from_the_gaussian() {
    let count = 500;
    let scales = [0.01f32, 0.03, 0.3];
    let mut rows = random_rows(count, 1, 2);
    rows.means = vec![[1.0, 2.0, 3.0]; count];
    rows.log_scales = vec![scales.map(f32::ln); count];
    // A quarter turn about z maps the Gaussian's x axis to y. The length of quaternions does not matter.
    rows.rotations =
        (0..count).map(|i| [1.0, 3.0, 1e-25, 1e25][i % 4]).map(|length| [length, 0.0, 0.0, length]).collect();
    for device in devices() {
        let of: Vec<u32> = (0..2 * count as u32).map(|i| i / 2).collect();
        check_parts(&rows, scales, &divided(&rows, &of, 1, &device, |scene, rows| parts(scene, rows, 5)));
    }
}

fn check_parts(rows: &GaussianRows, scales: [f32; 3], parts: &GaussianRows) {
    assert_eq!((parts.means.len(), parts.check()), (2 * rows.len(), Ok(())));
    for (axis, sigma) in [scales[1], scales[0], scales[2]].into_iter().enumerate() {
        let offsets: Vec<f32> = parts.means.iter().map(|mean| (mean[axis] - [1.0, 2.0, 3.0][axis]) / sigma).collect();
        assert!(offsets.iter().all(|offset| offset.abs() < 6.0), "axis {axis}");
        // Tolerance: five standard errors of 1,000 draws.
        let mean = offsets.iter().sum::<f32>() / offsets.len() as f32;
        let variance = offsets.iter().map(|offset| offset * offset).sum::<f32>() / offsets.len() as f32;
        assert!(mean.abs() < 0.16 && (variance - 1.0).abs() < 0.23, "axis {axis}: mean {mean}, variance {variance}");
    }
    for logs in &parts.log_scales {
        assert!(logs.iter().zip(scales).all(|(log, scale)| (log.exp() * 1.6 / scale - 1.0).abs() < 1e-5), "{logs:?}");
    }
    assert_eq!(parts.logit_opacities[..2], [rows.logit_opacities[0]; 2]);
    assert_eq!(parts.part(7..8), placed(rows, 3, parts, 7));
}

/// Halves lie along the axis that is longest, whatever the rotation.
#[test]
fn halves_lie_along_the_longest_axis() {
    let mut rows = random_rows(2, 1, 1);
    // A quarter turn about z maps the Gaussian's x axis to y. The length of quaternions does not matter.
    rows.rotations = vec![[2.0, 0.0, 0.0, 2.0]; 2];
    let scales = [[0.04_f32, 0.01, 0.02], [0.01, 0.02, 0.03]];
    rows.log_scales = scales.map(|scale| scale.map(f32::ln)).to_vec();
    rows.logit_opacities = vec![0.0; 2];
    devices().iter().for_each(|device| check_halves(&rows, scales, &divided(&rows, &[0, 1], 2, device, halves)));
}

fn check_halves(rows: &GaussianRows, scales: [[f32; 3]; 2], halves: &GaussianRows) {
    assert_eq!((halves.means.len(), halves.check()), (4, Ok(())));
    let along = [[0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
    for (half, (whole, axis, side)) in [(0, 0, -1.0), (1, 2, -1.0), (0, 0, 1.0), (1, 2, 1.0)].into_iter().enumerate() {
        for k in 0..3 {
            let expected = rows.means[whole][k] + side * 0.6 * scales[whole][axis] * along[whole][k];
            assert!((halves.means[half][k] - expected).abs() < 1e-6, "half {half}: {:?}", halves.means[half]);
            let shrunk = if k == axis { 0.6 } else { 1.0 };
            let ratio = (halves.log_scales[half][k] - rows.log_scales[whole][k]).exp();
            assert!((ratio - shrunk).abs() < 1e-6, "half {half}, axis {k}: {ratio}");
        }
        assert!((sigmoid(halves.logit_opacities[half]) - 0.4).abs() < 1e-6);
        assert_eq!(halves.part(half..half + 1), placed(rows, whole, halves, half));
    }
}

/// Of equal axes the first counts as the longest, on every device.
#[test]
fn a_round_gaussian_is_cut_across_its_first_axis() {
    for device in devices() {
        let logs = Tensor::<2>::from_floats([[1.0, 1.0, 1.0], [0.0, 2.0, 2.0], [0.0, 1.0, 2.0]], &device);
        assert_eq!(values_of(longest_axis(logs)), [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]);
    }
}

/// The root of the mean square difference of alpha along the axis, relative to the whole's, by sums over a fine grid.
#[test]
fn two_halves_show_nearly_what_the_whole_showed() {
    for (opacity, largest) in [(0.1_f32, 0.105), (0.5, 0.125), (0.9, 0.165), (0.99, 0.175)] {
        let mut rows = random_rows(1, 0, 1);
        rows.means = vec![[0.0; 3]];
        rows.rotations = vec![[1.0, 0.0, 0.0, 0.0]];
        rows.log_scales = vec![[0.5_f32.ln(), -9.0, -9.0]];
        rows.logit_opacities = vec![(opacity / (1.0 - opacity)).ln()];
        let halves = divided(&rows, &[0], 2, &Device::flex(), halves);
        let alpha = |rows: &GaussianRows, i: usize, x: f64| {
            let (mean, sigma) = (f64::from(rows.means[i][0]), f64::from(rows.log_scales[i][0]).exp());
            sigmoid(rows.logit_opacities[i]) * (-0.5 * ((x - mean) / sigma).powi(2)).exp()
        };
        let (mut difference, mut whole) = (0.0, 0.0);
        for x in (-4_000..4_000).map(|i| f64::from(i) * 1e-3) {
            let both = 1.0 - (1.0 - alpha(&halves, 0, x)) * (1.0 - alpha(&halves, 1, x));
            difference += (both - alpha(&rows, 0, x)).powi(2);
            whole += alpha(&rows, 0, x).powi(2);
        }
        let found: f64 = (difference / whole).sqrt();
        assert!(found < largest, "opacity {opacity}: {found}");
    }
}

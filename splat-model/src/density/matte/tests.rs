use burn::tensor::{Device, Tensor, TensorData};
use glam::DVec3;
use splat_op::{Camera, Intrinsics, shade};

use super::*;
use crate::gaussians::testing::random_rows;

/// Directions spread evenly over the sphere (a Fibonacci lattice).
fn directions(count: usize) -> impl Iterator<Item = DVec3> {
    let golden = std::f64::consts::PI * (3.0 - 5f64.sqrt());
    (0..count).map(move |i| {
        let z = 1.0 - (2 * i + 1) as f64 / count as f64;
        let (sin, cos) = (golden * i as f64).sin_cos();
        let radius = (1.0 - z * z).sqrt();
        DVec3::new(radius * cos, radius * sin, z)
    })
}

/// Against colours as the operation shades them, in many directions.
#[test]
fn the_variation_is_that_of_what_is_seen() {
    const SEEN: usize = 4_000;
    let device = Device::flex();
    for degree in 0..=4 {
        let mut rows = random_rows(5, degree, degree as u64);
        // Well above the clamp.
        rows.sh_dc = vec![[30.0; 3]; 5];
        let scene = Gaussians::from_rows(&rows, &device).unwrap();
        let sh = scene.sh.val();
        let mut colours = Vec::new();
        for row in 0..rows.len() {
            // The same Gaussian seen from everywhere: many of it around one camera.
            let means: Vec<f32> = directions(SEEN).flat_map(|d| d.as_vec3().to_array()).collect();
            let means = Tensor::from_data(TensorData::new(means, [SEEN, 3]), &device);
            let camera = Camera::new(Intrinsics::centred(8, 8, 8.0), &glam::DAffine3::IDENTITY, &device);
            let same = sh.clone().narrow(0, row, 1).expand([SEEN as i64, -1, -1]);
            colours.push(values_of(shade(&same, &means, &camera).unwrap()));
        }
        for (found, seen) in values_of(variation(sh)).into_iter().zip(colours) {
            let of_channel = |channel: usize| {
                let values = || seen.iter().skip(channel).step_by(3).map(|value| f64::from(*value));
                let mean = values().sum::<f64>() / SEEN as f64;
                (values().map(|value| (value - mean).powi(2)).sum::<f64>() / SEEN as f64).sqrt()
            };
            let expected = (0..3).map(of_channel).fold(0.0, f64::max);
            let error = (f64::from(found) - expected).abs();
            assert!(error <= 2e-3 * expected + 1e-5, "degree {degree}: {found} instead of {expected}");
            assert!(degree == 0 || expected > 0.01, "degree {degree}: nothing varies");
        }
    }
}

#[test]
fn what_varies_in_one_channel_stays_and_what_hardly_does_goes() {
    let mut rows = random_rows(6, 1, 1);
    rows.sh_rest.fill(0.0);
    // A variation of 2.1 levels in blue, of 1.9 in each channel, of nothing, of no number, of exactly the limit.
    let coefficient = |levels: f64| (levels / 255.0 * (4.0 * std::f64::consts::PI).sqrt()) as f32;
    rows.sh_rest[2] = coefficient(2.1);
    rows.sh_rest[9..18].iter_mut().step_by(4).for_each(|value| *value = coefficient(-1.9));
    rows.sh_rest[27] = f32::NAN;
    rows.sh_rest[36 + 7] = f32::INFINITY;
    rows.sh_rest[45..48].fill(coefficient(1.2));
    let scene = Gaussians::from_rows(&rows, &Device::flex()).unwrap();
    assert_eq!(hardly_varying(&scene, 2.0 / 255.0), [1, 2, 5]);
    assert_eq!(hardly_varying(&scene, 1.5 / 255.0), [2, 5]);
    assert!(hardly_varying(&scene, 0.0).is_empty());
}

#[test]
fn each_degree_has_its_time_before_gaussians_are_asked() {
    let asked = |every, largest| (0..=60).filter(|&steps| asks_after(steps, every, largest)).collect::<Vec<_>>();
    assert_eq!(asked(10, 3), [20, 30, 40]);
    assert_eq!(asked(10, 1), [20]);
    assert!(asked(10, 0).is_empty() && asked(0, 3).is_empty());
}

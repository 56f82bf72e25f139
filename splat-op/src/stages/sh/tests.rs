//! `evaluate_sh`: central finite differences, published values of the basis, and the clamp.

use super::cpu::{ShCpuInputs, sh_backward_cpu, sh_cpu};
use super::{Shading, sh_degree};
use crate::testing::finite::{check_gradient, inner_product};
use crate::testing::random::Random;

const ALL: Shading<bool> = Shading { sh: true, means: true, cam_from_world: true };
const COUNT: usize = 16;

/// Coefficients, means and pose.
#[derive(Clone)]
struct StageInputs([Vec<f64>; 3], usize);

impl StageInputs {
    fn random(seed: u64, degree: usize) -> Self {
        let mut random = Random::new(seed);
        let coefficients = (degree + 1) * (degree + 1);
        let mut sh = random.fill(3 * COUNT * coefficients, -1.0, 1.0);
        // The constant term may exceed the 0.5, so that some channels are clamped at every degree.
        sh.iter_mut().step_by(3 * coefficients).step_by(3).for_each(|c| *c = -6.0);
        let means = random.fill(3 * COUNT, -3.0, 3.0);
        // Not quite a rotation: every entry of the pose is a free variable.
        let mut pose = vec![0.9, 0.2, -0.3, 0.4, -0.1, 1.1, 0.2, -0.6, 0.3, -0.2, 0.8, 0.5];
        pose.iter_mut().for_each(|entry| *entry += random.between(-0.05, 0.05));
        Self([sh, means, pose], coefficients)
    }

    fn inputs(&self) -> ShCpuInputs<'_, f64> {
        let [sh, means, cam_from_world] = &self.0;
        ShCpuInputs { sh, means, cam_from_world, coefficients: self.1 }
    }
}

fn list(g: Shading<Vec<f64>>) -> [Vec<f64>; 3] {
    [g.sh, g.means, g.cam_from_world]
}

#[test]
fn every_gradient_agrees_with_finite_differences() {
    for degree in 0..=4 {
        let scene = StageInputs::random(20 + degree as u64, degree);
        let colours = sh_cpu(scene.inputs(), None);
        let clamped = colours.iter().filter(|c| **c == 0.0).count();
        assert!(clamped > 2 && clamped < colours.len(), "degree {degree}: {clamped} of {} clamped", colours.len());
        let grad = Random::new(degree as u64).fill(3 * COUNT, -1.0, 1.0);
        let gradients = list(sh_backward_cpu(scene.inputs(), None, &grad, ALL));
        for (i, name) in ["sh", "means", "pose"].into_iter().enumerate() {
            check_gradient(&format!("{name}, degree {degree}"), &scene.0[i], &gradients[i], 1, |moved| {
                let mut scene = scene.clone();
                scene.0[i] = moved.to_vec();
                inner_product(&sh_cpu(scene.inputs(), None), &grad)
            });
        }
    }
}

#[test]
fn each_gradient_is_the_same_alone_and_nothing_else_is_computed() {
    let scene = StageInputs::random(30, 3);
    let grad = Random::new(31).fill(3 * COUNT, -1.0, 1.0);
    let all = list(sh_backward_cpu(scene.inputs(), None, &grad, ALL));
    for alone in 0..3 {
        let [sh, means, cam_from_world] = std::array::from_fn(|i| i == alone);
        let gradients = list(sh_backward_cpu(scene.inputs(), None, &grad, Shading { sh, means, cam_from_world }));
        for (i, gradient) in gradients.iter().enumerate() {
            let expected = if i == alone { all[i].as_slice() } else { &[] };
            assert_eq!(gradient, expected, "gradient {i}, asked for {alone}");
        }
    }
}

/// Real spherical harmonics are orthonormal: `∫ Yᵢ Yⱼ = δᵢⱼ`. Wrong constants, a wrong polynomial and a repeated function all
/// violate this. The reference vectors fix signs and order.
#[test]
fn the_basis_is_orthonormal() {
    // Gauss-Legendre in z and equal steps in angle integrate polynomials of degree 8 exactly.
    let nodes = [0.0, 0.538_469_310_105_683_1, 0.906_179_845_938_664];
    let weights = [0.568_888_888_888_888_9, 0.478_628_670_499_366_5, 0.236_926_885_056_189_1];
    let mut products = [[0.0; 25]; 25];
    for (node, weight) in nodes.into_iter().zip(weights) {
        for z in if node == 0.0 { vec![0.0] } else { vec![-node, node] } {
            for step in 0..10 {
                let angle = f64::from(step) * std::f64::consts::TAU / 10.0;
                let across = (1.0_f64 - z * z).sqrt();
                let y = super::basis::basis([across * angle.cos(), across * angle.sin(), z], 4);
                for (row, a) in products.iter_mut().zip(y) {
                    row.iter_mut().zip(y).for_each(|(p, b)| *p += weight * std::f64::consts::TAU / 10.0 * a * b);
                }
            }
        }
    }
    for (i, row) in products.iter().enumerate() {
        for (j, product) in row.iter().enumerate() {
            let error = (product - f64::from(u8::from(i == j))).abs();
            assert!(error <= 1e-13, "<Y{i}, Y{j}> = {product}");
        }
    }
}

#[test]
fn a_centre_on_the_camera_is_finite_and_has_no_direction() {
    let mut scene = StageInputs::random(32, 2);
    scene.0[2] = vec![1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0];
    scene.0[1][..3].fill(0.0);
    assert!(sh_cpu(scene.inputs(), None).iter().all(|c| c.is_finite()));
    let gradients = list(sh_backward_cpu(scene.inputs(), None, &[1.0; 3 * COUNT], ALL));
    assert!(gradients.iter().flatten().all(|g| g.is_finite()));
    assert_eq!(gradients[1][..3], [0.0; 3]);
}

#[test]
fn degrees_follow_from_the_number_of_coefficients() {
    let degrees: Vec<usize> = (0..40).filter_map(sh_degree).collect();
    assert_eq!(degrees, [0, 1, 2, 3, 4]);
    assert_eq!([1, 4, 9, 16, 25].map(sh_degree), [0, 1, 2, 3, 4].map(Some));
}

//! The kernel against its twin.

use super::launch::{DevicePackedStep, launch_adam_packed};
use super::tests::factors;
use super::*;
use crate::adam::Band;
use crate::gpu::Buffer;
use crate::testing::gpu::gpus;
use crate::testing::random::Random;

/// Share of the codes that may round the other way, because square roots and divisions of devices differ in the last bits.
const OTHERWISE: f64 = 2e-3;

#[test]
fn steps_are_those_of_the_twin() {
    for (width, rows) in [(3, 700), (4, 1), (1, 5_000), (48, 300)] {
        let band = (width == 48).then_some(Band { period: 48, width: 3 });
        for (device, gpu) in gpus() {
            let mut random = Random::new(width as u64);
            let mut param: Vec<f32> = random.fill(rows * width, -2.0, 2.0).iter().map(|x| *x as f32).collect();
            let mut words = vec![0_i32; rows * words_per_row(width)];
            for step in 1..=6 {
                // Every seventh number has no gradient.
                let grad: Vec<f32> = (0..rows * width)
                    .map(|i| if i % 7 == 0 { 0.0 } else { random.between(-1e-2, 1e-2) as f32 })
                    .collect();
                let of = factors(step);
                let bits: Vec<u32> = words.iter().map(|word| *word as u32).collect();
                let on_device = DevicePackedStep {
                    param: Buffer::from_slice(&gpu, &param),
                    grad: Buffer::from_slice(&gpu, &grad),
                    words: Buffer::from_slice(&gpu, &bits),
                    factors: of,
                    band,
                    width,
                };
                launch_adam_packed(&gpu, &on_device, None);
                let state = HostState { param: &mut param, grad: &grad, words: &mut words };
                step_on_host(state, width, band, &of);
                let what = format!("{width}, {device}, step {step}");
                for (found, expected) in on_device.param.read(&gpu).iter().zip(&param) {
                    assert!((found - expected).abs() <= 1e-5, "{what}: {found} instead of {expected}");
                }
                compare_codes(&what, &on_device.words.read(&gpu), &words);
            }
        }
    }
}

/// Codes agree, but for a few that differ by one level.
fn compare_codes(what: &str, found: &[u32], expected: &[i32]) {
    let mut others = 0;
    for (found, expected) in found.iter().zip(expected) {
        for i in 0..CODES_PER_WORD {
            let [a, b] = [*found, *expected as u32].map(|word| word >> (CODE_BITS * i) & u32::MAX >> (32 - CODE_BITS));
            let second = (a & ((1 << SECOND_BITS) - 1)).abs_diff(b & ((1 << SECOND_BITS) - 1));
            let level = (a >> SECOND_BITS & LARGEST_LEVEL).abs_diff(b >> SECOND_BITS & LARGEST_LEVEL);
            // A level's unit depends on the stored `v`.
            let few = if second == 0 { 1 } else { 1 + (LARGEST_LEVEL >> FRACTION_BITS) };
            assert!(second <= 1 && level <= few, "{what}: {a:#x} instead of {b:#x}");
            others += usize::from(a != b);
        }
    }
    let share = others as f64 / (expected.len() * CODES_PER_WORD as usize) as f64;
    assert!(share <= OTHERWISE, "{what}: {share} of the codes differ");
}

#[test]
fn a_verdict_holds_a_step_back() {
    for (device, gpu) in gpus() {
        let step = DevicePackedStep {
            param: Buffer::from_slice(&gpu, &[0.5_f32; 300]),
            grad: Buffer::from_slice(&gpu, &[0.1_f32; 300]),
            words: Buffer::from_slice(&gpu, &[0_u32; 200]),
            factors: factors(1),
            band: None,
            width: 3,
        };
        launch_adam_packed(&gpu, &step, Some(&Buffer::from_slice(&gpu, &[7_u32, 1])));
        assert!(step.param.read(&gpu).iter().all(|x| *x == 0.5), "{device}");
        launch_adam_packed(&gpu, &step, Some(&Buffer::from_slice(&gpu, &[0_u32, 0])));
        assert!(step.param.read(&gpu).iter().all(|x| *x < 0.5), "{device}");
        assert!(step.words.read(&gpu).iter().all(|word| *word != 0), "{device}");
    }
}

//! Normal deviates, made on the device from a seed, the same on every device but for rounding. Burn's own generators differ between devices
//! and depend on what else draws from them.
//!
//! A deviate is made of a count by a Feistel network (Luby and Rackoff 1988) over 30 bits, in whole numbers that no device
//! overflows, and by the polar form of Box and Muller (1958). Its parts of 15 bits bound it by 4.6 standard deviations.
//!
//! A step that needs one deviate per coordinate of every Gaussian takes them from a stock of twice as many rows as there are
//! Gaussians, each step from another random row on. Two Gaussians, or one Gaussian at two steps, share values only by chance.

use std::f64::consts::TAU;

use burn::tensor::{DType, Device, Int, Tensor};
use rand::{Rng, RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::state::{State, StateError};

/// Bits of each half of a count.
const HALF_BITS: i32 = 15;
const HALF: i32 = (1 << HALF_BITS) - 1;

/// Rounds of the network. Four are enough for a function of each round that is random; this one is a product.
const ROUNDS: usize = 6;

/// A stock of deviates. Empty until it is needed.
#[derive(Debug, Default)]
pub(super) struct Noise {
    seed: u64,
    /// `[2 N, 3]`.
    stock: Option<Tensor<2>>,
}

impl Noise {
    /// `[count, 3]`: standard normal deviates for a step. A new stock is drawn if there is none for this number of rows.
    pub fn draw(&mut self, count: usize, rng: &mut dyn Rng, device: &Device) -> Tensor<2> {
        let kept = self.stock.take().filter(|stock| stock.dims()[0] == 2 * count);
        let stock = kept.unwrap_or_else(|| {
            self.seed = rng.next_u64();
            normal(self.seed, 2 * count, device)
        });
        self.stock.insert(stock).clone().narrow(0, rng.random_range(0..=count), count)
    }

    /// Discards the stock, so that the next step draws a new one.
    pub fn forget(&mut self) {
        self.stock = None;
    }

    pub fn save(&self, to: &mut State) -> Result<(), StateError> {
        let Some(stock) = &self.stock else { return Ok(()) };
        to.tell("noise", &(self.seed, stock.dims()[0]))
    }

    /// The stock is drawn again from its seed.
    pub fn load(&mut self, from: &mut State, device: &Device) -> Result<(), StateError> {
        self.stock = None;
        if from.has("noise") {
            let (seed, rows): (u64, u32) = from.told("noise")?;
            (self.seed, self.stock) = (seed, Some(normal(seed, rows as usize, device)));
        }
        Ok(())
    }
}

/// `[rows, 3]`: standard normal deviates.
pub(super) fn normal(seed: u64, rows: usize, device: &Device) -> Tensor<2> {
    // A count gives two deviates.
    let pairs = (3 * rows).div_ceil(2);
    let (high, low) = scrambled(seed, pairs, device);
    let unit = |half: Tensor<1, Int>| (half.float().cast(DType::F32) + 0.5) / f64::from(HALF + 1);
    let radius = (unit(high).log() * -2.0).sqrt();
    let angle = unit(low) * TAU;
    let deviates = Tensor::cat(vec![radius.clone() * angle.clone().cos(), radius * angle.sin()], 0);
    deviates.narrow(0, 0, 3 * rows).reshape([rows, 3])
}

/// Both halves of each of so many counts after the network, `[count]` each.
fn scrambled(seed: u64, count: usize, device: &Device) -> (Tensor<1, Int>, Tensor<1, Int>) {
    let mut keys = ChaCha8Rng::seed_from_u64(seed);
    let counts: Tensor<1, Int> = Tensor::arange(0..count as i64, (device, DType::I32));
    let halves = (counts.clone().bitwise_right_shift_scalar(HALF_BITS), counts.bitwise_and_scalar(HALF));
    (0..ROUNDS).fold(halves, |(left, right), _| {
        let [factor, summand] = [1, 0].map(|lowest| keys.random_range(0..=HALF) | lowest);
        // Below 2^31. The upper bits of the product depend on all bits of the half, the lower ones on few.
        let product = right.clone() * factor + summand;
        let mixed = product.clone().bitwise_right_shift_scalar(HALF_BITS).bitwise_xor(product);
        (right, left.bitwise_xor(mixed.bitwise_and_scalar(HALF)))
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gaussians::testing::devices;
    use crate::gaussians::values_of;

    #[test]
    fn deviates_are_normal_and_independent() {
        for (device, seed) in devices().into_iter().flat_map(|device| [3, 4, 5].map(|seed| (device.clone(), seed))) {
            let rows = 50_001;
            let values: Vec<f64> = values_of(normal(seed, rows, &device)).into_iter().map(f64::from).collect();
            let count = values.len() as f64;
            assert_eq!(values.len(), 3 * rows);
            let mean = |of: &dyn Fn(usize) -> f64| (0..values.len()).map(of).sum::<f64>() / count;
            // Tolerance: five standard errors of the moments of a normal distribution.
            let error = 5.0 / count.sqrt();
            for (power, expected, variance) in [(1, 0.0, 1.0), (2, 1.0, 2.0), (3, 0.0, 15.0), (4, 3.0, 96.0_f64)] {
                let found = mean(&|i| values[i].powi(power));
                assert!((found - expected).abs() < error * variance.sqrt(), "{seed}: moment {power} is {found}");
            }
            for apart in [1, 2, 3, 4, 64, 4_096, 3 * rows / 2] {
                let found = mean(&|i| values[i] * values[(i + apart) % values.len()]);
                assert!(found.abs() < error, "{seed}: correlation {found} of numbers {apart} apart");
                let found = mean(&|i| (values[i].powi(2) - 1.0) * (values[(i + apart) % values.len()].powi(2) - 1.0));
                assert!(found.abs() < 2.0 * error, "{seed}: correlation {found} of squares {apart} apart");
            }
            assert_ne!(
                values[..9],
                values_of(normal(seed + 1, rows, &device)).into_iter().map(f64::from).collect::<Vec<_>>()[..9]
            );
        }
    }

    #[test]
    fn every_step_has_others_and_a_seed_decides_them() {
        let device = Device::flex();
        let drawn = |seed| {
            let (mut noise, mut rng) = (Noise::default(), ChaCha8Rng::seed_from_u64(seed));
            let mut draw = |count| values_of(noise.draw(count, &mut rng, &device));
            [draw(500), draw(500), draw(499)]
        };
        let [first, second, third] = drawn(1);
        assert_eq!((first.len(), third.len()), (1500, 1497));
        assert_ne!(first, second);
        assert_ne!(second[..1497], third);
        assert_eq!(drawn(1), [first.clone(), second, third]);
        assert_ne!(drawn(2)[0], first);
    }

    #[test]
    fn a_stock_is_taken_up_again() {
        let device = Device::flex();
        let (mut noise, mut rng) = (Noise::default(), ChaCha8Rng::seed_from_u64(1));
        noise.draw(50, &mut rng, &device);
        let mut state = State::default();
        noise.save(&mut state).unwrap();
        let (mut again, mut same_rng) = (Noise::default(), rng.clone());
        again.load(&mut state, &device).unwrap();
        state.finish().unwrap();
        let expected = values_of(noise.draw(50, &mut rng, &device));
        assert_eq!(values_of(again.draw(50, &mut same_rng, &device)), expected);
        let mut empty = State::default();
        Noise::default().save(&mut empty).unwrap();
        again.load(&mut empty, &device).unwrap();
        assert!(again.stock.is_none());
    }
}

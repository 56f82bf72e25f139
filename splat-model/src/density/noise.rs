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
    apart(device, || deviates(seed, rows, device))
}

/// Runs tensor code apart from what was registered before and what comes after. Fusion joins operations with their neighbours, and a
/// kernel's rounding depends on what else it does: apart, equal inputs have equal results, which a resumed run needs. A device that
/// cannot flush says so at the next read.
pub(super) fn apart<T>(device: &Device, run: impl FnOnce() -> T) -> T {
    let _ = device.flush();
    let found = run();
    let _ = device.flush();
    found
}

fn deviates(seed: u64, rows: usize, device: &Device) -> Tensor<2> {
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
mod tests;

//! Normal deviates for steps that need one per coordinate of every Gaussian.
//!
//! They are drawn on the host, so that they depend only on the seed on every device, but not at every step: a stock of
//! twice as many rows as there are Gaussians is drawn at once and kept on the device, and each step reads it from another
//! random row on. Two Gaussians, or one Gaussian at two steps, share values only by chance.

use burn::tensor::{Device, Tensor, TensorData};
use rand::{Rng, RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use rayon::prelude::*;

use crate::state::{State, StateError};

/// Rows per stream of the generator. Results do not depend on the number of threads.
const CHUNK: usize = 4096;

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
fn normal(seed: u64, rows: usize, device: &Device) -> Tensor<2> {
    let mut values = vec![0.0_f32; 3 * rows];
    values.par_chunks_mut(3 * CHUNK).enumerate().for_each(|(stream, chunk)| {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        rng.set_stream(stream as u64);
        chunk.iter_mut().for_each(|value| *value = StandardNormal.sample(&mut rng));
    });
    Tensor::from_data(TensorData::new(values, [rows, 3]), device)
}

#[cfg(test)]
mod tests;

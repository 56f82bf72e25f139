//! Measured rates of this machine's processors.

use std::fmt::{self, Display};
use std::hint::black_box;
use std::time::Instant;

use fearless_simd::{Level, dispatch, f32x8, prelude::*};
use rayon::prelude::*;

/// Rates of a device.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Machine {
    /// Bytes per second to and from memory.
    pub bandwidth: f64,
    /// f32 operations per second, where a fused multiply-add counts as two. `None` if not measured.
    pub operations: Option<f64>,
}

/// Length of each of three arrays: 64 MiB, so that no array stays in a cache.
const NUMBERS: usize = 16 << 20;

/// Number of values that a thread processes at a time.
const CHUNK: usize = 1 << 16;

/// Number of independent sums: more than a processor can execute at once (five cycles, two per cycle).
const CHAINS: usize = 12;

/// Number of rounds of a run of [`chains`]: about 20 ms.
const ROUNDS: usize = 5_000_000;

/// Number of runs, of which the fastest counts: a shared machine reaches its full speed only at times.
const RUNS: usize = 10;

impl Machine {
    /// Measures the processors that rayon uses, for about a second, with McCalpin's triad `a = b + s c`, read and written, and
    /// independent chains of fused multiply-adds on eight lanes.
    pub fn measure() -> Self {
        Self { bandwidth: triad(), operations: Some(arithmetic()) }
    }
}

impl Display for Machine {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:.1} GB/s, read and written", self.bandwidth / 1e9)?;
        match self.operations {
            Some(rate) => write!(f, "; {:.0} billion f32 operations per second", rate / 1e9),
            None => write!(f, "; arithmetic not measured, so limits count memory alone"),
        }
    }
}

/// Returns the time of the shortest of [`RUNS`] runs, in seconds.
fn best(mut run: impl FnMut()) -> f64 {
    let seconds = |run: &mut dyn FnMut()| {
        let start = Instant::now();
        run();
        start.elapsed().as_secs_f64()
    };
    (0..RUNS).map(|_| seconds(&mut run)).fold(f64::INFINITY, f64::min)
}

fn triad() -> f64 {
    // Not zeros, because pages that were never written share one physical page.
    let (b, c) = (vec![1.0_f32; NUMBERS], vec![2.0_f32; NUMBERS]);
    let mut a = vec![3.0_f32; NUMBERS];
    let scale = black_box(0.5);
    let seconds = best(|| {
        let read = b.par_chunks(CHUNK).zip(c.par_chunks(CHUNK));
        a.par_chunks_mut(CHUNK).zip(read).for_each(|(a, (b, c))| {
            a.iter_mut().zip(b.iter().zip(c)).for_each(|(a, (b, c))| *a = b + scale * c);
        });
    });
    assert_eq!(black_box(&a)[NUMBERS / 2], 2.0);
    (3 * size_of::<f32>() * NUMBERS) as f64 / seconds
}

fn arithmetic() -> f64 {
    let start = black_box(1.0_f32);
    let seconds = best(|| {
        let ends = rayon::broadcast(|_| dispatch!(Level::new(), simd => chains(simd, start)));
        assert!(black_box(ends).into_iter().all(f32::is_finite));
    });
    (2 * 8 * CHAINS * ROUNDS * rayon::current_num_threads()) as f64 / seconds
}

/// Computes sums that stay finite: `x ← x/2 + 1`.
#[inline(always)]
fn chains<S: Simd>(simd: S, start: f32) -> f32 {
    let (half, one) = (f32x8::splat(simd, 0.5 * start), f32x8::splat(simd, start));
    let mut sums: [f32x8<S>; CHAINS] = std::array::from_fn(|chain| f32x8::splat(simd, start + chain as f32));
    for _ in 0..ROUNDS {
        for sum in &mut sums {
            *sum = sum.mul_add(half, one);
        }
    }
    sums.into_iter().fold(f32x8::splat(simd, 0.0), |total, sum| total + sum)[0]
}

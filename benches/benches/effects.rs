//! Times the operations of effects on a smooth picture, forwards and backwards. The backward pass includes what every loss has: the
//! gradient of the picture, multiplied by that of the loss.
//!
//! `cargo bench --workspace --bench effects -- 539 960` takes the width and the height, px; these are the defaults.

use std::error::Error;
use std::time::Duration;

use burn::tensor::{Device, Distribution, Int, Tensor};
use splat_benches::measure::{Prepare, time};
use splat_benches::passes::{backward, forward, leaf};
use splat_op::{SplatError, bilateral, colour_map, depth_miss, environment};

splat_train::allocator!();

/// Time budget for all operations.
const BUDGET: Duration = Duration::from_secs(20);

/// Number of known depths.
const KNOWN: usize = 1500;

/// An operation of the picture and of the effect's parameters.
type Op = fn(&Tensor<3>, &Constants) -> Result<Tensor<3>, SplatError>;

/// What the operations take besides the picture. The parameters among them have gradients.
#[derive(Clone)]
struct Constants {
    map: Tensor<2>,
    grid: Tensor<4>,
    coefficients: Tensor<2>,
    directions: Tensor<3>,
    alpha: Tensor<3>,
    known: Tensor<1>,
    pixels: Tensor<1, Int>,
}

const OPS: [(&str, Op); 4] = [
    ("colour map (exposure)", |picture, of| colour_map::apply(picture, &of.map)),
    ("bilateral grid", |picture, of| bilateral::slice(picture, &of.grid)),
    ("environment", |picture, of| environment::over(picture, &of.alpha, &of.directions, &of.coefficients)),
    ("known depths", |picture, of| {
        let depth = picture.clone().narrow(2, 0, 1);
        Ok(depth_miss::depth_miss(&depth, &of.alpha, &of.known, &of.pixels)?.reshape([1, 1, 1]))
    }),
];

fn main() -> Result<(), Box<dyn Error>> {
    let sizes: Vec<usize> = std::env::args().filter_map(|argument| argument.parse().ok()).collect();
    let [width, height] = if let [width, height] = sizes[..] { [width, height] } else { [539, 960] };
    let device = Device::flex();
    let random = |shape: &[usize]| {
        Tensor::<1>::random([shape.iter().product::<usize>()], Distribution::Uniform(0.5, 1.0), &device)
    };
    let constants = Constants {
        map: leaf(&random(&[3, 4]).reshape([3, 4])),
        grid: leaf(&random(&[12, 8, 16, 16]).reshape([12, 8, 16, 16])),
        coefficients: leaf(&random(&[16, 3]).reshape([16, 3])),
        directions: random(&[3, height, width]).reshape([3, height, width]),
        alpha: random(&[height, width, 1]).reshape([height, width, 1]),
        known: random(&[KNOWN]),
        pixels: Tensor::<1, Int>::arange(0..KNOWN as i64, &device) * (height * width / KNOWN) as i64,
    };
    // Planes of slow waves, as renders lie in memory and as brightness changes in photographs.
    let waves = Tensor::<1, Int>::arange(0..(3 * height * width) as i64, &device).float() * 0.02;
    let picture = (waves.sin() * 0.4 + 0.5).reshape([3, height, width]).permute([1, 2, 0]);
    let mut passes: Vec<Prepare> = Vec::new();
    for (_, op) in OPS {
        let [height, width, channels] = op(&picture, &constants)?.dims();
        // In the order of the picture's planes, as the loss gives it.
        let grad = Tensor::<3>::ones([channels, height, width], &device).permute([1, 2, 0]);
        let (own, of) = (picture.clone(), constants.clone());
        passes.push(forward(move || op(&own, &of)));
        let (own, of) = (picture.clone(), constants.clone());
        passes.push(backward(grad, move || op(&leaf(&own), &of).expect("as forwards")));
    }
    let times = time(&mut passes, &device, BUDGET)?;
    println!(
        "{width} × {height}, {} threads\n{:<24} {:>12} {:>13}",
        rayon::current_num_threads(),
        "operation",
        "forwards, ms",
        "backwards, ms"
    );
    for ((name, _), of) in OPS.iter().zip(times.chunks_exact(2)) {
        println!("{name:<24} {:>12.2} {:>13.2}", 1e3 * of[0].median_s, 1e3 * of[1].median_s);
    }
    Ok(())
}

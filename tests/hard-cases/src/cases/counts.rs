//! Numbers of Gaussians: none, one, none visible, and very many in one place.

use splat_op::Intrinsics;

use crate::case::HardCase;
use crate::random::Random;
use crate::scene::{HardScene, Splat, TruthSource};

/// Number of Gaussians over one tile.
const CROWD: usize = 200_000;

/// Number of Gaussians that a driver in software can render.
const SMALLER_CROWD: usize = 40_000;

/// Found with Mesa 22.3: lists above about 52,000 entries are truncated without an error.
const LOOPS: &str = "Mesa's llvmpipe ends a kernel's loops after 65,535 iterations, whether or not they are finished";

pub fn cases() -> Vec<HardCase> {
    vec![
        HardCase::scenes("no splats", "every list is empty, and so is every launch", vec![HardScene::new("none", &[])])
            .hardness("0 splats"),
        HardCase::scenes(
            "one splat",
            "most lists are empty",
            vec![HardScene::new("one", &[Splat::at([24.3, 20.6], 3.0, 3.0)])],
        )
        .hardness("1 splat"),
        HardCase::scenes(
            "all culled",
            "there are rows but no intersections; every gradient exists and is exactly zero",
            vec![all_culled()],
        )
        .hardness("300 splats, no intersections"),
        HardCase::scenes(
            "all in one pixel",
            "one pixel holds every layer, and only the blur gives the layers a size",
            vec![one_pixel()],
        )
        .hardness("500 splats"),
        HardCase::scenes(
            "200,000 splats over one tile",
            "every pixel adds 200,000 terms and multiplies as many factors close to one",
            vec![crowd(CROWD)],
        )
        .hardness("200,000 layers")
        .beyond_software(LOOPS),
        HardCase::scenes(
            "40,000 splats over one tile",
            "as above, for drivers in software, which cannot run more",
            vec![crowd(SMALLER_CROWD)],
        )
        .hardness("40,000 layers"),
    ]
}

fn all_culled() -> HardScene {
    let mut random = Random::new(3);
    let splats: Vec<Splat> = (0..300).map(|_| Splat::at([20.0, 20.0], random.between(-9.0, 0.01), 2.0)).collect();
    HardScene::new("behind", &splats).with_culled(&(0..300).collect::<Vec<usize>>())
}

fn one_pixel() -> HardScene {
    let mut random = Random::new(4);
    let splats: Vec<Splat> = (0..500)
        .map(|_| {
            let px = [random.between(28.0, 29.0), random.between(22.0, 23.0)];
            let splat = Splat::at(px, random.between(2.0, 9.0), random.between(0.01, 0.2));
            splat.opacity(random.between(0.01, 0.9)).colour(&random.fill(3, 0.0, 1.0))
        })
        .collect();
    HardScene::new("pixel 28, 22", &splats).holding_depth()
}

/// Layers so faint that the last one is still visible, on part of a tile to keep the run short.
fn crowd(count: usize) -> HardScene {
    let lens = Intrinsics::pinhole(8, 8, [20.0, 20.0], [4.2, 3.9]);
    let mut random = Random::new(6);
    let splats: Vec<Splat> = (0..count)
        .map(|_| {
            let px = [random.between(0.0, 8.0), random.between(0.0, 8.0)];
            let splat = Splat::seen_by(&lens, px, random.between(2.0, 9.0), random.between(2.0, 8.0));
            splat.opacity(random.between(1e-5, 5e-5)).colour(&random.fill(3, 0.0, 1.0))
        })
        .collect();
    HardScene::new("8 × 8 px", &splats).with_camera(lens).holding_depth().with_truth(TruthSource::Twin).with_draws(2)
}

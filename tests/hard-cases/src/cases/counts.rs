//! Numbers of things: none, one, none that shows, and very many in one place.

use splat_op::Intrinsics;

use crate::case::{Case, Processor};
use crate::random::Random;
use crate::scene::{HardScene, Splat, Truth};

/// Gaussians over one tile.
const CROWD: usize = 200_000;

/// As many as a driver in software takes.
const SMALLER_CROWD: usize = 40_000;

/// What the kernels do not do, because it takes registers.
const PLAIN: &str = "the kernels add up what the layers of a bucket stop, but multiply and add the buckets plainly and do not \
                     keep what rounding takes, as the CPU does";

/// Found with Mesa 22.3: lists above some 52,000 are cut short, without a word.
const LOOPS: &str = "Mesa's llvmpipe ends the loops of a kernel after 65,535 rounds, whatever is left to do";

pub fn cases() -> Vec<Case> {
    vec![
        Case::scenes("no splats", "every list is empty, and so is every launch", vec![HardScene::new("none", &[])])
            .hardness("0 splats"),
        Case::scenes(
            "one splat",
            "most lists are empty",
            vec![HardScene::new("one", &[Splat::at([24.3, 20.6], 3.0, 3.0)])],
        )
        .hardness("1 splat"),
        Case::scenes(
            "all culled",
            "there are rows but no hits; every gradient is there and exactly zero",
            vec![all_culled()],
        )
        .hardness("300 splats, no hits"),
        Case::scenes(
            "all in one pixel",
            "one pixel has every layer, and only the blur gives them a size",
            vec![one_pixel()],
        )
        .hardness("500 splats"),
        Case::scenes(
            "200,000 splats over one tile",
            "every pixel adds 200,000 terms and multiplies as many factors next to one",
            vec![crowd(CROWD)],
        )
        .hardness("200,000 layers")
        .loose(Processor::Gpu, 10.0, PLAIN)
        .beyond_software(LOOPS),
        Case::scenes(
            "40,000 splats over one tile",
            "as above, for those that cannot do more",
            vec![crowd(SMALLER_CROWD)],
        )
        .hardness("40,000 layers")
        .loose(Processor::Gpu, 2.0, PLAIN),
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

/// So faint that the last of them still shows, on part of a tile to keep it short.
fn crowd(count: usize) -> HardScene {
    let lens = Intrinsics { cx: 4.2, cy: 3.9, ..Intrinsics::centred(8, 8, 20.0) };
    let mut random = Random::new(6);
    let splats: Vec<Splat> = (0..count)
        .map(|_| {
            let px = [random.between(0.0, 8.0), random.between(0.0, 8.0)];
            let splat = Splat::seen_by(&lens, px, random.between(2.0, 9.0), random.between(2.0, 8.0));
            splat.opacity(random.between(1e-5, 5e-5)).colour(&random.fill(3, 0.0, 1.0))
        })
        .collect();
    HardScene::new("8 × 8 px", &splats).with_camera(lens).holding_depth().with_truth(Truth::Twin).with_draws(2)
}

//! Depth: the order of layers, and distances that span ten orders of magnitude in one view.

use crate::case::HardCase;
use crate::scene::{HardScene, SMOOTH, Splat};

pub fn cases() -> Vec<HardCase> {
    let three = 3.0_f32;
    let orders: [[usize; 5]; 3] = [[0, 1, 2, 3, 4], [4, 3, 2, 1, 0], [2, 0, 4, 1, 3]];
    let scenes = |depths: [f32; 5]| {
        let scene = |order: [usize; 5]| {
            let splats: Vec<Splat> = order.iter().map(|&i| layer(i, f64::from(depths[i]))).collect();
            HardScene::new(format!("order {order:?}"), &splats).holding_depth()
        };
        orders.map(scene).to_vec()
    };
    let ulps: [f32; 5] = std::array::from_fn(|i| f32::from_bits(three.to_bits() + i as u32));
    vec![
        HardCase::scenes(
            "five layers at one depth",
            "they must keep the order of input, on every path and for every order of input",
            scenes([three; 5]),
        )
        .hardness("Δz 0"),
        HardCase::scenes(
            "five layers, 1 ulp apart",
            "a sort key with fewer bits than the depth cannot separate them",
            scenes(ulps),
        )
        .hardness("Δz 2e-7"),
        HardCase::scenes(
            "pairs at one depth between others 1 ulp away",
            "ties and near ties occur together, so the sort must be stable and exact",
            scenes([ulps[1], ulps[0], ulps[1], ulps[2], ulps[0]]),
        )
        .hardness("Δz 0 and 2e-7"),
        HardCase::scenes(
            "depths from 1e-3 to 1e7 in one view",
            "gradients of centres and accumulated depths span ten orders of magnitude in one sum",
            vec![far_and_near()],
        )
        .hardness("z ratio 1e10"),
    ]
}

/// Layer `i`, with its own colour, position and size.
fn layer(i: usize, depth: f64) -> Splat {
    let t = i as f64;
    let splat = Splat::at([26.0 + 1.7 * t, 20.0 + 1.1 * t], depth, 4.0 + t);
    splat.opacity(0.5 + 0.08 * t).colour(&[0.2 * t, 0.9 - 0.2 * t, 0.5])
}

fn far_and_near() -> HardScene {
    let splats: Vec<Splat> =
        [1e3, 1e-3, 1e7, 1.0, 1e5].into_iter().enumerate().map(|(i, depth)| layer(i, depth).opacity(0.6)).collect();
    HardScene::new("five", &splats).with_options(SMOOTH.with_near(1e-4))
}

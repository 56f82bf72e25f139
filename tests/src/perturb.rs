//! The change of a result when every input moves by one f32 ulp: the unit of f32 errors.

use burn::tensor::{DType, Device};
use splat_op::RenderOptions;

pub use splat_hard_cases::ceiling::ceiling_used;
use splat_hard_cases::ceiling::{moved_value, rounded as rounded_value};

use crate::random::Random;
use crate::scene::{LossWeights, Named, RenderOutputs, Scene, evaluate};

/// Number of random directions in which the inputs move. The largest change of several draws is a lower estimate of the largest
/// change that an ulp can cause.
const DRAWS: u64 = 8;

fn map_scene(scene: &Scene, mut map: impl FnMut(f64) -> f64) -> Scene {
    let mut all = |values: &[f64]| values.iter().map(|v| map(*v)).collect::<Vec<f64>>();
    let (means, quats, scales) = (all(&scene.means), all(&scene.quats), all(&scene.scales));
    let (opacities, sh) = (all(&scene.opacities), all(&scene.sh));
    let (background, pose) = (all(&scene.background), all(&scene.pose));
    let camera = &scene.intrinsics;
    let lens = all(&[camera.fx, camera.fy, camera.cx, camera.cy]);
    let distortion = camera.distortion.map(|value| if value == 0.0 { 0.0 } else { all(&[value])[0] });
    let intrinsics =
        camera.with_focal(lens[0], lens[1]).with_principal_point(lens[2], lens[3]).with_lens(camera.model, distortion);
    Scene { means, quats, scales, opacities, sh, background, pose, intrinsics }
}

fn map_weights(weights: &LossWeights, mut map: impl FnMut(f64) -> f64) -> LossWeights {
    let mut all = |values: &[f64]| values.iter().map(|v| map(*v)).collect::<Vec<f64>>();
    LossWeights { image: all(&weights.image), alpha: all(&weights.alpha), depth: all(&weights.depth) }
}

/// Rounds scene, weights and options to f32, as an f32 render receives them.
pub fn rounded(scene: &Scene, weights: &LossWeights, options: &RenderOptions) -> (Scene, LossWeights, RenderOptions) {
    let options = options
        .with_blur(rounded_value(options.blur))
        .with_near(rounded_value(options.near))
        .with_alpha_min(rounded_value(options.alpha_min))
        .with_alpha_max(rounded_value(options.alpha_max))
        .with_transmittance_min(rounded_value(options.transmittance_min));
    (map_scene(scene, rounded_value), map_weights(weights, rounded_value), options)
}

/// Rounds a scene to f32, as an f32 render receives it.
pub fn rounded_scene(scene: &Scene) -> Scene {
    map_scene(scene, rounded_value)
}

/// Returns draws of the scene with every value moved up or down by one f32 ulp.
pub fn moved_scenes(scene: &Scene) -> impl Iterator<Item = Scene> {
    (0..DRAWS).map(|draw| {
        let mut random = Random::new(draw);
        map_scene(scene, |value| moved_value(value, &mut random))
    })
}

/// Compares the result of `compute` in f32 on `device` with its result in f64 on the CPU for the same rounded scene. The ceiling of
/// the error is the change of the f64 result by one ulp in every input. Scene and options must have no threshold to jump over.
pub fn judge(
    what: &str,
    scene: &Scene,
    device: &Device,
    compute: impl Fn(&Scene, &(Device, DType)) -> Vec<(&'static str, Vec<f64>)>,
) {
    let in_f64 = (Device::flex(), DType::F64);
    let scene = rounded_scene(scene);
    let expected = compute(&scene, &in_f64);
    let mut spreads: Vec<Vec<f64>> = expected.iter().map(|(_, values)| vec![0.0; values.len()]).collect();
    for moved in moved_scenes(&scene) {
        for ((spread, (_, plain)), (_, moved)) in spreads.iter_mut().zip(&expected).zip(compute(&moved, &in_f64)) {
            let changes = plain.iter().zip(moved).map(|(plain, moved)| (plain - moved).abs());
            spread.iter_mut().zip(changes).for_each(|(spread, change)| *spread = spread.max(change));
        }
    }
    for (((name, found), (_, expected)), spread) in
        compute(&scene, &(device.clone(), DType::F32)).iter().zip(&expected).zip(&spreads)
    {
        assert!(expected.iter().any(|e| *e != 0.0), "{what}: {name} is all zero, which proves nothing");
        let used = ceiling_used(found, expected, spread);
        assert!(used <= 1.0, "{what}: {name} is at {used:.2} of its ceiling");
    }
}

/// Returns for every element of an evaluation the largest change of the f64 result over several draws, in which every input
/// moves up or down by one f32 ulp. Inputs must be rounded to f32.
pub fn ulp_spread(
    scene: &Scene,
    weights: &LossWeights,
    options: &RenderOptions,
    device: &Device,
    plain: &RenderOutputs,
) -> RenderOutputs {
    let mut spread = plain.clone();
    each(&mut spread).for_each(|tensor| tensor.values.fill(0.0));
    for draw in 0..DRAWS {
        let mut random = Random::new(draw);
        let mut move_one = |value: f64| moved_value(value, &mut random);
        let scene = map_scene(scene, &mut move_one);
        // A weight of zero masks a pixel and stays zero.
        let weights = map_weights(weights, |w| if w == 0.0 { 0.0 } else { move_one(w) });
        let mut moved = evaluate(&scene, &weights, options, device, DType::F64);
        let mut plain = plain.clone();
        for ((spread, moved), plain) in each(&mut spread).zip(each(&mut moved)).zip(each(&mut plain)) {
            for ((spread, moved), plain) in spread.values.iter_mut().zip(&moved.values).zip(&plain.values) {
                *spread = spread.max((moved - plain).abs());
            }
        }
    }
    spread
}

fn each(evaluation: &mut RenderOutputs) -> impl Iterator<Item = &mut Named> {
    evaluation.stages.iter_mut().chain(&mut evaluation.pictures).chain(&mut evaluation.gradients)
}

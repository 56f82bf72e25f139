//! Pixels at which the render is discontinuous within f32 rounding, so that f32 comparisons exclude them.
//!
//! Three decisions make a render jump: whether a Gaussian's alpha reaches `alpha_min`, whether a pixel's transmittance has
//! fallen to `transmittance_min`, and which of two Gaussians is in front. A pixel belongs to the band if any bit of its f64
//! result changes when a threshold moves a little, or when neighbours in depth closer than rounding change places. These moves
//! do not affect smooth terms, so no other pixel is excluded.

use burn::tensor::{DType, Device, Tensor};
use splat_op::{Ellipses, Extras, Intrinsics, RenderOptions, intersect, project, rasterize};

use crate::random::Random;
use crate::scene::{Scene, SceneTensors, host, tensor};

/// Relative change of an alpha near the cut by f32 rounding. The exponent there is -5.5 or less, `u` about 3, and a
/// centre some 100 px from the origin is rounded to 8e-6 px, which is up to 1.5e-5 in `u` of the smallest ellipse
/// (0.55 px). A few such roundings add up.
const ALPHA_SHIFT: f64 = 1e-4;

/// Relative change of a transmittance by f32 rounding: the sum of its layers' `dα / (1 − α)`.
const TRANSMITTANCE_SHIFT: f64 = 1e-4;

/// Depths closer than this number of f32 ulps of their largest summed terms can change places.
const DEPTH_ULPS: f64 = 8.0;

/// Whether each pixel belongs to the band.
pub fn boundary_band(scene: &Scene, options: &RenderOptions, device: &Device) -> Vec<bool> {
    let SceneTensors { splats, camera, .. } = scene.tensors(device, DType::F64);
    let ellipses = project(&splats, &camera, &Extras::default(), options).expect("a valid scene").ellipses();
    // Features that differ from one Gaussian to the next, so that every exchange shows.
    let count = scene.count();
    let features = tensor(&Random::new(7).fill(count, 1.0, 2.0), [count, 1], device, DType::F64);
    let picture = |ellipses: Ellipses, options: &RenderOptions| pixels(ellipses, &features, &scene.intrinsics, options);

    let plain = picture(ellipses.clone(), options);
    let mut variants = Vec::new();
    for sign in [-1.0, 1.0] {
        let alpha_min = options.alpha_min * (1.0 + sign * ALPHA_SHIFT);
        let transmittance_min = options.transmittance_min * (1.0 + sign * TRANSMITTANCE_SHIFT);
        variants.push(picture(ellipses.clone(), &options.with_alpha_min(alpha_min)));
        variants.push(picture(ellipses.clone(), &options.with_transmittance_min(transmittance_min)));
    }
    let depths = host(ellipses.depth.clone());
    for first in [0, 1] {
        let swapped = tensor(&swap_neighbours(&depths, scene, first), [count], device, DType::F64);
        variants.push(picture(Ellipses { depth: swapped, ..ellipses.clone() }, options));
    }
    (0..plain.len()).map(|pixel| variants.iter().any(|variant| variant[pixel] != plain[pixel])).collect()
}

/// Renders `(feature, alpha)` of every pixel, without accumulated depth, which a swap of depths changes smoothly.
fn pixels(
    ellipses: Ellipses,
    features: &Tensor<2>,
    intrinsics: &Intrinsics,
    options: &RenderOptions,
) -> Vec<(f64, f64)> {
    let options = options.with_depth(false);
    let projected = ellipses.pack(intrinsics).expect("columns of one render");
    let intersections = intersect(&projected, &options).expect("valid options");
    let picture =
        rasterize(&projected, features, &intersections, &Extras::default(), &options).expect("valid features");
    host(picture.colour).into_iter().zip(host(picture.alpha)).collect()
}

/// Exchanges the depths of each pair of neighbours in depth that are within [`DEPTH_ULPS`]. Pairs begin at index `first`.
fn swap_neighbours(depths: &[f64], scene: &Scene, first: usize) -> Vec<f64> {
    let p = &scene.pose;
    let terms = |i: usize| {
        let m = &scene.means[3 * i..3 * i + 3];
        (p[8] * m[0]).abs() + (p[9] * m[1]).abs() + (p[10] * m[2]).abs() + p[11].abs()
    };
    let mut order: Vec<usize> = (0..depths.len()).filter(|&i| depths[i] > 0.0).collect();
    order.sort_by(|&a, &b| depths[a].total_cmp(&depths[b]));
    let mut swapped = depths.to_vec();
    for pair in order[first.min(order.len())..].chunks_exact(2) {
        let reach = DEPTH_ULPS * f64::from(f32::EPSILON) * terms(pair[0]).max(terms(pair[1]));
        if depths[pair[1]] - depths[pair[0]] <= reach {
            // The larger depth moves one step further, so that equal depths, ordered by index, change places too.
            (swapped[pair[0]], swapped[pair[1]]) = (depths[pair[1]].next_up(), depths[pair[0]]);
        }
    }
    swapped
}

//! The contributors of pixels and the median depth, against the exact renderer and the picture.

use burn::tensor::Int;
use splat_op::{CameraModel, Contributors, MAX_CONTRIBUTORS, contributors, intersect};

use super::*;

const FISHEYE: Intrinsics = CAMERA.with_lens(CameraModel::Fisheye, [0.0; 8]);

fn contributors_of(
    splats: &Splats,
    view: &Camera,
    k: usize,
    options: &RenderOptions,
) -> Result<Contributors, SplatError> {
    let projected = project(splats, view, &Extras::default(), options)?;
    contributors(&projected, &intersect(&projected, options)?, k, options)
}

fn ints<const D: usize>(ids: &Tensor<D, Int>) -> Vec<i64> {
    ids.clone().into_data().iter::<i64>().collect()
}

/// The weight of each Gaussian at each pixel, in f64.
fn exact_weights(of: &[ExactGaussian], intrinsics: &Intrinsics, options: &RenderOptions) -> Vec<Vec<f64>> {
    let one_hot = |i: usize| (0..of.len()).map(|other| f64::from(u8::from(i == other))).collect();
    let of: Vec<_> = of.iter().enumerate().map(|(i, g)| ExactGaussian { features: one_hot(i), ..g.clone() }).collect();
    let pose = ExactPose { rotation: DMat3::IDENTITY, translation: DVec3::ZERO };
    let pixels = render_exact(&of, &pose, intrinsics, &vec![0.0; of.len()], options);
    pixels.into_iter().map(|pixel| pixel.features).collect()
}

#[test]
fn contributors_are_the_first_of_the_exact_render_with_their_weights() {
    let of = gaussians(60);
    let mut by_depth: Vec<usize> = (0..of.len()).collect();
    by_depth.sort_by(|a, b| of[*a].mean.z.total_cmp(&of[*b].mean.z));
    for (projection, intrinsics) in
        [(Projection::Affine, CAMERA), (Projection::RayMax, CAMERA), (Projection::RayMax, FISHEYE)]
    {
        let options = RenderOptions::exact().with_projection(projection);
        let exact = exact_weights(&of, &intrinsics, &options);
        for at in everywhere() {
            for k in [1, 3, of.len()] {
                let what = format!("{projection:?}, {at:?}, {k} contributors");
                let found = contributors_of(&splats(&of, &at), &camera(intrinsics, &at), k, &options).expect("valid");
                assert_eq!((found.ids.dims(), found.median.dims()), ([32, 48, k], [32, 48]), "{what}");
                let (ids, weights, medians) = (ints(&found.ids), host(found.weights), ints(&found.median));
                let mut several = 0;
                for (pixel, exact) in exact.iter().enumerate() {
                    let of_pixel = pixel * k..(pixel + 1) * k;
                    let pairs: Vec<_> = ids[of_pixel.clone()].iter().zip(&weights[of_pixel]).collect();
                    assert!(pairs.iter().all(|(id, weight)| **id >= 0 || (**id == -1 && **weight == 0.0)), "{what}");
                    let mut next = pairs.iter().take_while(|(id, _)| **id >= 0).peekable();
                    let (mut through, mut halves) = (1.0, [None; 2]);
                    for &i in &by_depth {
                        let alpha = exact[i] / through;
                        match next.next_if(|(id, _)| **id == i as i64) {
                            Some((_, weight)) => {
                                assert!((*weight - exact[i]).abs() < 2e-5, "{what}: {weight} instead of {}", exact[i]);
                                assert!(alpha > 0.98 * options.alpha_min, "{what}: {alpha} is shown");
                            }
                            None => assert!(
                                alpha < 1.02 * options.alpha_min || (next.peek().is_none() && pairs[k - 1].0 >= &0),
                                "{what}: {i} is missing at pixel {pixel}"
                            ),
                        }
                        through -= exact[i];
                        for (half, limit) in halves.iter_mut().zip([0.5 - 1e-4, 0.5 + 1e-4]) {
                            *half = half.or((through <= limit).then_some(i));
                        }
                    }
                    assert!(next.next().is_none(), "{what}: contributors are out of order at pixel {pixel}");
                    let halves = halves.map(|half| half.map_or(-1, |i| i as i64));
                    assert!(halves.contains(&medians[pixel]), "{what}: {} instead of {halves:?}", medians[pixel]);
                    several += usize::from(medians[pixel] >= 0 && medians[pixel] != ids[pixel * k]);
                }
                assert!(several > 40 && medians.iter().any(|id| *id < 0), "{what}: {several} medians prove little");
            }
        }
    }
}

#[test]
fn weights_of_all_contributors_sum_up_to_alpha_and_halve_at_the_median() {
    let of = gaussians(700);
    for options in [RenderOptions::standard(), RenderOptions::standard().with_alpha_min(1e-4)] {
        for projection in [Projection::Affine, Projection::RayMax] {
            let options = options.with_projection(projection);
            for at in everywhere() {
                let (splats, view) = (splats(&of, &at), camera(CAMERA, &at));
                let alpha = render_view(&splats, &view, &Extras::default(), &options).expect("valid").alpha;
                let found = contributors_of(&splats, &view, of.len(), &options).expect("valid");
                let few = contributors_of(&splats, &view, 2, &options).expect("valid");
                let (ids, medians) = (ints(&found.ids), ints(&found.median));
                assert!(ints(&few.median) == medians, "{at:?}");
                let (few, weights) = (host(few.weights), host(found.weights));
                for (pixel, alpha) in host(alpha).into_iter().enumerate() {
                    let all = &weights[pixel * of.len()..][..of.len()];
                    let what = format!("{projection:?}, {at:?}, pixel {pixel}");
                    let sum: f64 = all.iter().sum();
                    assert!((sum - alpha).abs() < 2e-6, "{what}: {sum} instead of {alpha}");
                    assert!(few[2 * pixel..][..2] == all[..2], "{what}: others in front");
                    let place = ids[pixel * of.len()..][..of.len()].iter().position(|id| *id == medians[pixel]);
                    let before: f64 = all.iter().take(place.unwrap_or(0)).sum();
                    let behind = before + place.map_or(0.0, |place| all[place]);
                    let halved = before < 0.5 + 1e-5 && behind > 0.5 - 1e-5;
                    let open = medians[pixel] == -1 && sum < 0.5 + 1e-5;
                    assert!(halved || open, "{what}: from {before} to {behind} of {sum}");
                }
            }
        }
    }
}

#[test]
fn the_median_depth_has_the_gradient_of_its_gaussian() {
    let of = gaussians(60);
    let options = RenderOptions::standard();
    for at in everywhere() {
        let tracked = (at.0.clone().autodiff(), at.1);
        let mut given = splats(&of, &tracked);
        given.means = given.means.require_grad();
        let found = contributors_of(&given, &camera(CAMERA, &at), 1, &options).expect("valid");
        let weights = Random::new(5).fill(48 * 32, -1.0, 1.0);
        let depth = found.median_depth();
        let loss = (depth.clone() * tensor::<3>(&weights, [32, 48, 1], &tracked.0, at.1)).sum();
        let gradient = host(given.means.grad(&loss.backward()).expect("tracked"));
        let mut expected = vec![0.0; of.len()];
        for ((id, depth), weight) in ints(&found.median).into_iter().zip(host(depth)).zip(&weights) {
            let z = usize::try_from(id).map_or(0.0, |id| {
                expected[id] += weight;
                of[id].mean.z
            });
            assert!((depth - z).abs() < 1e-5, "{at:?}: {depth} instead of {z}");
        }
        for (i, expected) in expected.iter().enumerate() {
            let found = &gradient[3 * i..3 * i + 3];
            assert!(found[..2] == [0.0; 2] && (found[2] - expected).abs() < 1e-5, "{at:?}, {i}: {found:?}");
        }
        let none = contributors_of(&splats(&[], &at), &camera(CAMERA, &at), 2, &options).expect("valid");
        assert!(ints(&none.ids).iter().all(|id| *id == -1), "{at:?}");
        assert!(host(none.median_depth()).iter().all(|depth| *depth == 0.0), "{at:?}");
    }
}

#[test]
fn numbers_of_contributors_out_of_range_are_refused() {
    let at = (Device::flex(), DType::F32);
    let (splats, options) = (splats(&gaussians(3), &at), RenderOptions::standard());
    for k in [0, MAX_CONTRIBUTORS + 1, usize::MAX] {
        let refused = contributors_of(&splats, &camera(CAMERA, &at), k, &options).expect_err("out of range");
        assert!(matches!(refused, SplatError::Value { field: "k", .. }), "{refused}");
    }
    let projected = project(&splats, &camera(CAMERA, &at), &Extras::default(), &options).expect("valid");
    let lists = intersect(&projected, &options).expect("valid");
    let refused = contributors(&projected, &lists, 1, &options.with_alpha_min(1e-6)).expect_err("other options");
    assert!(matches!(refused, SplatError::Value { field: "intersections", .. }), "{refused}");
    let Some(device) = gpu() else { return };
    let at = (device, DType::F32);
    let large = camera(Intrinsics::centred(8192, 8192, 4e3), &at);
    let refused =
        contributors_of(&super::splats(&gaussians(3), &at), &large, MAX_CONTRIBUTORS, &options).expect_err("too large");
    assert!(matches!(refused, SplatError::TooLarge { what: "the contributors", .. }), "{refused}");
}

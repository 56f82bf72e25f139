//! Masks of tiles: pictures are the unmasked ones in the tiles of the mask and the background elsewhere, and gradients those of a loss
//! of these tiles.

use burn::tensor::TensorData;
use splat_op::{Accumulation, intersect, intersect_masked};

use super::*;

/// Tiles of 16 px at the picture's borders are cut.
const WIDE: Intrinsics = Intrinsics::centred(200, 150, 160.0);
const TILES: [usize; 2] = [13, 10];

const OPTIONS: RenderOptions = RenderOptions::standard().with_depth(true);

/// Small Gaussians, and some that cover most of the picture.
fn many() -> Vec<ExactGaussian> {
    let mut of = gaussians(200);
    for gaussian in of.iter_mut().step_by(40) {
        gaussian.scale *= 20.0;
        gaussian.opacity *= 0.3;
    }
    of
}

/// A third of the tiles, some of them neighbours.
fn in_mask(tile: usize) -> bool {
    (tile * tile + tile / 3) % 7 < 2 || tile == TILES[0] * TILES[1] - 1
}

fn mask(of: impl Fn(usize) -> bool, device: &Device) -> Tensor<2, Bool> {
    let flags: Vec<bool> = (0..TILES[0] * TILES[1]).map(of).collect();
    Tensor::from_data(TensorData::new(flags, [TILES[1], TILES[0]]), device)
}

/// Whether each pixel is in a tile of the mask.
fn pixels() -> Vec<bool> {
    let tile = |pixel: usize| pixel / WIDE.width / 16 * TILES[0] + pixel % WIDE.width / 16;
    (0..WIDE.width * WIDE.height).map(|pixel| in_mask(tile(pixel))).collect()
}

fn forms() -> impl Iterator<Item = RenderOptions> {
    let sums = [Accumulation::Atomic, Accumulation::Ordered].into_iter();
    sums.flat_map(|sums| {
        [Projection::Affine, Projection::RayMax].map(|of| OPTIONS.with_accumulation(sums).with_projection(of))
    })
}

#[test]
fn masked_tiles_show_the_background_and_no_other_changes() {
    let (of, inside) = (many(), pixels());
    for options in forms() {
        for at in everywhere() {
            let what = format!("{:?}, {at:?}", options.projection);
            let (splats, view) = (splats(&of, &at), camera(WIDE, &at));
            let background = tensor(&[0.25, 0.75], [2], &at.0, at.1);
            let plain = Extras::default().with_background(background);
            let extras = plain.clone().with_tile_mask(mask(in_mask, &at.0));
            let all = render_view(&splats, &view, &plain, &options).expect("valid");
            let found = render_view(&splats, &view, &extras, &options).expect("valid");
            let parts = [
                (host(found.colour), host(all.colour), vec![0.25, 0.75]),
                (host(found.alpha), host(all.alpha), vec![0.0]),
                (host(found.depth.expect("asked for")), host(all.depth.expect("asked for")), vec![0.0]),
            ];
            for (found, all, outside) in parts {
                let channels = outside.len();
                assert!(all.iter().zip(outside.iter().cycle()).filter(|(a, b)| a != b).count() > all.len() / 2);
                for (i, (found, all)) in found.iter().zip(all).enumerate() {
                    let expected = if inside[i / channels] { all } else { outside[i % channels] };
                    assert!(*found == expected, "{what}, value {i}: {found} instead of {expected}");
                }
            }
            let projected = project(&splats, &view, &plain, &options).expect("valid");
            let plain = intersect(&projected, &options).expect("valid").counts.into_data();
            let lists = intersect_masked(&projected, &mask(in_mask, &at.0), &options).expect("valid");
            for (tile, (found, all)) in lists.counts.into_data().iter::<i64>().zip(plain.iter::<i64>()).enumerate() {
                assert_eq!(found, if in_mask(tile) { all } else { 0 }, "{what}, tile {tile}");
            }
        }
    }
}

/// Gradients of a loss of a picture with a mask, or of the same loss of the picture without it.
fn gradients(of: &[ExactGaussian], at: &(Device, DType), options: &RenderOptions, masked: bool) -> Vec<Vec<f64>> {
    let tracked = (at.0.clone().autodiff(), at.1);
    let mut splats = splats(of, &tracked);
    let [means, scales] = [splats.means, splats.scales].map(Tensor::require_grad);
    let (rotations, opacities) = (splats.rotations.require_grad(), splats.opacities.require_grad());
    let Colour::Features(features) = splats.colour else { unreachable!("features") };
    let features = features.require_grad();
    splats = Splats {
        means: means.clone(),
        scales: scales.clone(),
        rotations: rotations.clone(),
        opacities: opacities.clone(),
        colour: Colour::Features(features.clone()),
    };
    let background = tensor::<1>(&[0.25, 0.75], [2], &tracked.0, at.1).require_grad();
    let probe = Tensor::zeros([of.len(), 2], (&tracked.0, at.1)).require_grad();
    let extras = Extras::default()
        .with_background(background.clone())
        .with_mean2d_abs_probe(probe.clone())
        .with_tile_mask(masked.then(|| mask(in_mask, &at.0)));
    let picture = render_view(&splats, &camera(WIDE, at), &extras, options).expect("valid");
    let inside: Vec<f64> = pixels().into_iter().map(|inside| f64::from(u8::from(inside))).collect();
    let size = [WIDE.height, WIDE.width, 1];
    let inside = tensor::<3>(&inside, size, &tracked.0, at.1);
    let mut random = Random::new(8);
    let mut weighted = |picture: Tensor<3>| {
        let channels = picture.dims()[2];
        let weights = random.fill(WIDE.width * WIDE.height * channels, -1.0, 1.0);
        (picture * tensor::<3>(&weights, [WIDE.height, WIDE.width, channels], &tracked.0, at.1)).sum()
    };
    let cut = |picture: Tensor<3>| if masked { picture } else { picture * inside.clone() };
    let behind = background.clone().reshape([1, 1, 2]) * (-inside.clone() + 1.0);
    let colour = if masked { picture.colour } else { cut(picture.colour) + behind };
    let loss = weighted(colour) + weighted(cut(picture.alpha)) + weighted(cut(picture.depth.expect("asked for")));
    let grads = loss.backward();
    let two = [means, scales, rotations, features, probe].map(|leaf| host(leaf.grad(&grads).expect("tracked")));
    let one = [opacities, background].map(|leaf| host(leaf.grad(&grads).expect("tracked")));
    two.into_iter().chain(one).collect()
}

#[test]
fn gradients_are_those_of_the_tiles_of_the_mask() {
    let of = many();
    for options in forms() {
        for at in everywhere() {
            let [found, expected] = [true, false].map(|masked| gradients(&of, &at, &options, masked));
            for (input, (found, expected)) in found.iter().zip(&expected).enumerate() {
                let largest = expected.iter().fold(0.0_f64, |most, g| most.max(g.abs()));
                assert!(largest > 0.0, "input {input} has no gradient");
                let tolerance = largest * if at.1 == DType::F64 { 1e-12 } else { 2e-5 };
                for (i, (found, expected)) in found.iter().zip(expected).enumerate() {
                    let what = format!("{:?}, {at:?}, input {input}, value {i}", options.projection);
                    assert!((found - expected).abs() <= tolerance, "{what}: {found} instead of {expected}");
                }
            }
        }
    }
}

#[test]
fn masks_of_no_tile_and_of_another_picture() {
    for at in everywhere() {
        let (splats, view) = (splats(&many(), &at), camera(WIDE, &at));
        let with = |mask| Extras::default().with_tile_mask(mask);
        let views = [view.clone(), view.clone()];
        let none = render(&splats, &views, &with(mask(|_| false, &at.0)), &OPTIONS).expect("valid");
        assert!(host(none.alpha).iter().chain(&host(none.colour)).all(|value| *value == 0.0), "{at:?}");
        let empty = render_view(&super::splats(&[], &at), &view, &with(mask(in_mask, &at.0)), &OPTIONS).expect("valid");
        assert!(host(empty.alpha).iter().all(|value| *value == 0.0), "{at:?}");
        let every = render_view(&splats, &view, &with(mask(|_| true, &at.0)), &OPTIONS).expect("valid");
        let plain = render_view(&splats, &view, &Extras::default(), &OPTIONS).expect("valid");
        assert!(host(every.colour) == host(plain.colour), "{at:?}");
        let turned = with(mask(in_mask, &at.0).transpose());
        let refused = render_view(&splats, &view, &turned, &OPTIONS).expect_err("columns of rows").to_string();
        assert!(refused.contains("`tile_mask`") && refused.contains("10 rows of 13 tiles"), "{refused}");
    }
}

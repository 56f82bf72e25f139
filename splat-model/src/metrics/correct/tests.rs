use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::*;

fn noise(count: usize) -> Vec<f32> {
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    (0..3 * count).map(|_| rng.random_range(0.0..1.0)).collect()
}

/// Mixes, scales and shifts the channels.
fn exposed(image: &[f32]) -> Vec<f32> {
    let pixels = image.as_chunks::<3>().0.iter();
    pixels.flat_map(|&[r, g, b]| [0.7 * r + 0.1 * g, 1.2 * g - 0.05, 0.2 + 0.5 * b]).collect()
}

fn worst(a: &[f32], b: &[f32]) -> f32 {
    a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max)
}

#[test]
fn an_affine_difference_is_taken_out() {
    let image = noise(200);
    let truth = exposed(&image);
    assert!(worst(&colour_corrected(&image, &truth, None), &truth) < 1e-4);
}

#[test]
fn what_a_mask_excludes_has_no_say() {
    let image = noise(200);
    let mut truth = exposed(&image);
    let kept: Vec<bool> = (0..200).map(|i| i % 3 != 0).collect();
    let clean = colour_corrected(&image, &truth, Some(&kept));
    for (pixel, _) in truth.as_chunks_mut::<3>().0.iter_mut().zip(&kept).filter(|(_, kept)| !**kept) {
        *pixel = [9.0, -5.0, 3.0];
    }
    assert_eq!(colour_corrected(&image, &truth, Some(&kept)), clean);
}

#[test]
fn a_picture_without_colours_becomes_its_mean() {
    let (image, truth) = (vec![0.5; 300], [0.1, 0.4, 0.9].repeat(100));
    assert!(worst(&colour_corrected(&image, &truth, None), &truth) < 1e-3);
    assert_eq!(colour_corrected(&[], &[], None), [] as [f32; 0]);
    // Without pixels that count, the map is the identity.
    assert!(worst(&colour_corrected(&image, &truth, Some(&[false; 100])), &image) < 1e-6);
}

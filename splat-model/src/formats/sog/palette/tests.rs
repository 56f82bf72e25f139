use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::*;

fn error(vectors: &[f32], width: usize, found: &Palette) -> f64 {
    let entry = |label: u32| &found.entries[width * label as usize..][..width];
    let all = vectors
        .chunks_exact(width)
        .zip(&found.labels)
        .map(|(vector, &label)| f64::from(distance(vector, entry(label))));
    all.sum::<f64>()
}

/// Vectors in 300 places, two of them far from the others.
#[test]
fn clusters_get_an_entry_each() {
    let mut random = ChaCha8Rng::seed_from_u64(5);
    let width = 9;
    let places: Vec<f32> =
        (0..300 * width).map(|i| random.random_range(-1.0..1.0) * if i < 2 * width { 1e4 } else { 1.0 }).collect();
    let vectors: Vec<f32> = (0..20_000)
        .flat_map(|_| {
            let place = random.random_range(0..300) * width;
            let noise = random.random_range(-1e-3..1e-3);
            places[place..place + width].iter().map(|x| x + noise).collect::<Vec<f32>>()
        })
        .collect();
    let found = palette(&vectors, width, 1_024);
    assert!(found.entries.len() <= 1_024 * width && found.labels.len() == 20_000);
    let mean = error(&vectors, width, &found) / 20_000.0;
    assert!(mean < 1e-4, "{mean:e}");
    let again = palette(&vectors, width, 1_024);
    assert!(again.entries == found.entries && again.labels == found.labels);
}

#[test]
fn no_more_entries_than_vectors() {
    for count in [0, 1, 3, 65, 1_000] {
        let vectors: Vec<f32> = (0..9 * count).map(|i| (i as f32).sin()).collect();
        let found = palette(&vectors, 9, 4_096);
        assert_eq!((found.entries.len(), found.labels.len()), (9 * count, count));
        assert_eq!(error(&vectors, 9, &found), 0.0);
    }
    let alike = palette(&vec![0.25; 9_000], 9, 128);
    assert_eq!(error(&vec![0.25; 9_000], 9, &alike), 0.0);
}

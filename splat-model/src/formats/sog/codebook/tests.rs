use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::*;

fn error(values: &[f32], quantised: &Quantised) -> f64 {
    let pairs = values.iter().zip(&quantised.indices);
    let squares = pairs.map(|(value, &index)| f64::from(value - quantised.codebook[usize::from(index)]).powi(2));
    squares.sum::<f64>() / values.len() as f64
}

/// Of a uniform distribution the best quantiser has equal steps, with an error of a step squared by twelve.
#[test]
fn the_error_is_near_its_limit() {
    let mut random = ChaCha8Rng::seed_from_u64(3);
    let mut values: Vec<f32> = (0..100_000).map(|_| random.random_range(-1.0..1.0)).collect();
    let limit = (2.0 / 256.0_f64).powi(2) / 12.0;
    let plain = error(&values, &quantise(&values));
    assert!(plain < 1.05 * limit && plain > 0.9 * limit, "{plain:e}, {limit:e}");
    // Values far from the others.
    values.extend([1e6, -3e5, 1e30, 2e6]);
    let quantised = quantise(&values);
    values.truncate(100_000);
    let far = error(&values, &quantised);
    assert!(far < 1.15 * limit, "{far:e}, {limit:e}");
    assert_eq!(quantised.codebook[usize::from(quantised.indices[100_002])], 1e30);
}

#[test]
fn few_values_are_exact() {
    for values in
        [vec![], vec![0.1], vec![0.3; 7], (0..256).map(|i| 0.1 * i as f32).collect::<Vec<f32>>(), vec![-3e38, 3e38]]
    {
        let quantised = quantise(&values);
        assert_eq!((quantised.codebook.len(), quantised.indices.len()), (LEVELS, values.len()));
        assert!(quantised.codebook.is_sorted());
        for (value, index) in values.iter().zip(&quantised.indices) {
            assert_eq!(quantised.codebook[usize::from(*index)], *value);
        }
    }
}

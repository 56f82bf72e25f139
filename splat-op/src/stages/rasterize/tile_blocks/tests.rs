use super::*;
use crate::rasterize::pixels::SIMD_BLOCK;
use crate::simd::dispatch;
use crate::testing::random::Random;

fn met<F: Real>(corner: [f64; 2], middle: [f64; 2], half: [f64; 2]) -> u16 {
    let [corner, middle, half] = [corner, middle, half].map(|pair| pair.map(F::of));
    dispatch!(F, simd => TileBlocks::new(corner).met(simd, middle, half))
}

/// Boxes in, around and beside a tile against its pixels.
#[test]
fn a_box_meets_the_blocks_whose_pixels_it_holds() {
    let mut random = Random::new(5);
    let corner = [32.0, 64.0];
    for _ in 0..2_000 {
        let mut pair = |low, high| [random.between(low, high), random.between(low, high)];
        let (at, half) = (pair(-12.0, 28.0), pair(0.0, 12.0));
        let middle = [corner[0] + at[0], corner[1] + at[1]];
        let holds = |pixel: [usize; 2], margin: f64| {
            (0..2).all(|axis| (corner[axis] + pixel[axis] as f64 + 0.5 - middle[axis]).abs() <= half[axis] + margin)
        };
        for found in [met::<f32>(corner, middle, half), met::<f64>(corner, middle, half)] {
            for block in 0..SIMD_BLOCKS {
                let [x, y] = [block % SIMD_ACROSS * SIMD_WIDTH, block / SIMD_ACROSS * SIMD_ROWS];
                let any = |margin| (0..SIMD_BLOCK).any(|i| holds([x + i % SIMD_WIDTH, y + i / SIMD_WIDTH], margin));
                let is_met = found >> block & 1 == 1;
                assert!(is_met || !any(0.0), "{middle:?} ± {half:?} misses block {block}");
                // A box may lie between the centres of two pixels.
                assert!(!is_met || any(0.52), "{middle:?} ± {half:?} meets block {block}");
            }
        }
    }
    assert_eq!(met::<f32>(corner, [f64::NAN; 2], [1.0; 2]), u16::MAX);
    assert_eq!(met::<f32>(corner, [0.0; 2], [1e30; 2]), u16::MAX);
}

#[test]
fn blocks_are_the_bits_in_turn() {
    for bits in [0, 1, 0x8000, 0x5a3c, u16::MAX] {
        let expected: Vec<usize> = (0..SIMD_BLOCKS).filter(|block| bits >> block & 1 == 1).collect();
        assert_eq!(Blocks(bits).collect::<Vec<_>>(), expected);
    }
}

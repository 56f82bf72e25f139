//! Tests of the device's sums and sort against the standard library, exactly.

use cubecl::prelude::*;

use super::sort::{HIDDEN, Sorted, launch_sort};
use crate::gpu::{Buffer, Gpu, SUM_ROOM, UNITS, cube_exclusive_sum, cubes};
use crate::testing::gpu::gpu;
use crate::testing::random::Random;

/// Lengths around the sizes of a word, a cube and a tile of keys, and one of many chunks.
const LENGTHS: [usize; 15] = [0, 1, 2, 31, 32, 33, 255, 256, 257, 2_047, 2_048, 2_049, 4_097, 65_537, 100_003];

/// Lengths around those from which a chunk has two tiles of keys, and more tiles than are counted at a time.
const LONG: [usize; 6] = [524_287, 524_288, 524_289, 1_572_863, 1_572_864, 1_572_865];

fn random(len: usize, seed: u64, below: f64) -> Vec<u32> {
    Random::new(seed).fill(len, 0.0, below).into_iter().map(|x| x as u32).collect()
}

#[cube(launch_unchecked)]
fn sums_kernel(values: &[u32], sums: &mut [u32], totals: &mut [u32]) {
    let mut shared = Shared::<[u32]>::new_slice(comptime!(SUM_ROOM));
    // Twice, so that the second sum reuses the shared memory of the first.
    let (before, _) = cube_exclusive_sum(values[ABSOLUTE_POS], &mut shared);
    let (again, total) = cube_exclusive_sum(before + values[ABSOLUTE_POS], &mut shared);
    sums[ABSOLUTE_POS] = again;
    totals[ABSOLUTE_POS] = total;
}

#[test]
fn sums_of_a_cube_are_exact_in_the_order_of_units() {
    let Some(gpu) = gpu() else { return };
    let values = random(7 * UNITS, 2, 60_000.0);
    let [sums, totals] = [(); 2].map(|()| Buffer::<u32>::new(&gpu, values.len()));
    // SAFETY: there is a value for each unit.
    unsafe {
        let (given, dim) = (Buffer::from_slice(&gpu, &values), CubeDim::new_1d(UNITS as u32));
        sums_kernel::launch_unchecked(&gpu.client, cubes(7), dim, given.arg(), sums.arg(), totals.arg());
    }
    let (mut expected, mut expected_totals) = (Vec::new(), Vec::new());
    for values in values.chunks(UNITS) {
        let (mut sum, mut sum_of_sums) = (0, 0);
        for value in values {
            expected.push(sum_of_sums);
            sum += value;
            sum_of_sums += sum;
        }
        expected_totals.extend([sum_of_sums; UNITS]);
    }
    assert!(sums.read(&gpu) == expected && totals.read(&gpu) == expected_totals);
}

fn check_sort(gpu: &Gpu, keys: &[u32], bits: u32, what: &str) {
    let name = format!("{} keys of {bits} bits, {what}", keys.len());
    let sorted = launch_sort(gpu, Buffer::from_slice(gpu, keys), None, bits);
    check_sorted(gpu, &sorted, keys, &name);
    // So many keys that the chunks of the shorter list differ from those of the whole.
    let count = keys.len() * 5 / 8;
    let given = Buffer::from_slice(gpu, &[count as u32, 7]);
    let sorted = launch_sort(gpu, Buffer::from_slice(gpu, keys), Some(given), bits);
    check_sorted(gpu, &sorted, &keys[..count], &format!("{name}, the first {count}"));
}

fn check_sorted(gpu: &Gpu, sorted: &Sorted, keys: &[u32], name: &str) {
    let mut expected: Vec<u32> = (0..keys.len() as u32).filter(|&i| keys[i as usize] != HIDDEN).collect();
    expected.sort_by_key(|&i| keys[i as usize]);
    assert_eq!(sorted.kept.read(gpu), [expected.len() as u32], "{name}");
    assert!(sorted.indices.read(gpu)[..expected.len()] == expected, "{name}: not the stable order");
    let expected: Vec<u32> = expected.iter().map(|&i| keys[i as usize]).collect();
    assert!(sorted.keys.read(gpu)[..expected.len()] == expected, "{name}: other keys");
}

fn check_sorts(len: usize) {
    let Some(gpu) = gpu() else { return };
    let all = random(len, len as u64, 4_294_967_295.0);
    check_sort(&gpu, &all, 32, "random");
    let small: Vec<u32> = all.iter().map(|key| key >> 19).collect();
    check_sort(&gpu, &small, 13, "random");
    check_sort(&gpu, &all.iter().map(|key| key >> 24).collect::<Vec<_>>(), 8, "random");
    let few: Vec<u32> = all.iter().map(|key| key % 3 * 0x0110_1001).collect();
    check_sort(&gpu, &few, 32, "three distinct");
    check_sort(&gpu, &vec![77; len], 32, "equal");
    check_sort(&gpu, &(0..len as u32).collect::<Vec<_>>(), 32, "sorted");
    check_sort(&gpu, &(0..len as u32).rev().collect::<Vec<_>>(), 32, "reversed");
    let hide = |key: &u32, share: u32| if key % 64 < share { HIDDEN } else { *key };
    for share in [1, 50] {
        check_sort(&gpu, &all.iter().map(|key| hide(key, share)).collect::<Vec<_>>(), 32, "some hidden");
    }
    check_sort(&gpu, &vec![HIDDEN; len], 32, "all hidden");
}

#[test]
fn sort_is_exact_and_stable() {
    for len in LENGTHS {
        check_sorts(len);
    }
}

#[test]
fn long_chunks_are_sorted() {
    let Some(gpu) = gpu() else { return };
    for len in LONG {
        check_sort(&gpu, &random(len, len as u64, 256.0), 8, "random");
    }
    let all = random(3_000_000, 4, 4_294_967_295.0);
    check_sort(&gpu, &all, 32, "random");
    // All keys have the same digit, so each counter counts as many as it can.
    check_sort(&gpu, &vec![77; all.len()], 8, "equal");
    let hidden: Vec<u32> = all.iter().map(|key| if key % 4 == 0 { *key } else { HIDDEN }).collect();
    check_sort(&gpu, &hidden, 32, "some hidden");
}

#[test]
#[ignore = "long: minutes on a software driver"]
fn ten_million_keys_are_sorted() {
    check_sorts(10_000_019);
}

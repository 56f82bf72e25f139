//! Scan and sort of the device against the standard library's, exactly.

use super::scan::launch_scan;
use super::sort::{Pairs, launch_sort};
use crate::gpu::Buffer;
use crate::testing::gpu::gpus;
use crate::testing::random::Random;

/// Around the sizes of a unit, a block, the blocks that one cube takes, and two levels of blocks.
const LENGTHS: [usize; 12] = [0, 1, 7, 255, 256, 2_047, 2_048, 2_049, 16_384, 16_385, 100_003, 4_200_001];

fn random(len: usize, seed: u64, below: f64) -> Vec<u32> {
    Random::new(seed).fill(len, 0.0, below).into_iter().map(|x| x as u32).collect()
}

fn check_scan(values: &[u32]) {
    for (form, gpu) in gpus() {
        let buffer = Buffer::from_slice(&gpu, values);
        let total = launch_scan(&gpu, &buffer).read(&gpu);
        let mut sum = 0_u32;
        let mut expected = Vec::with_capacity(values.len());
        for value in values {
            expected.push(sum);
            sum = sum.saturating_add(*value);
        }
        assert!(buffer.read(&gpu) == expected, "{} values, {form}", values.len());
        assert_eq!(total[0], sum, "{} values, {form}", values.len());
    }
}

#[test]
fn scan_is_exact() {
    for len in LENGTHS {
        check_scan(&random(len, 1 + len as u64, 50.0));
        check_scan(&vec![1; len]);
    }
}

#[test]
fn scan_saturates() {
    check_scan(&random(100_003, 3, 1e6));
}

fn check_sort(keys: &[u32], bits: u32) {
    for (form, gpu) in gpus() {
        let values: Vec<u32> = (0..keys.len() as u32).collect();
        let pairs = Pairs { keys: Buffer::from_slice(&gpu, keys), values: Buffer::from_slice(&gpu, &values) };
        let sorted = launch_sort(&gpu, pairs, bits);
        let mask = if bits == 32 { u32::MAX } else { (1 << bits) - 1 };
        let mut expected = values;
        expected.sort_by_key(|&i| keys[i as usize] & mask);
        assert!(
            sorted.values.read(&gpu) == expected,
            "{} keys of {bits} bits, {form}: not the stable order",
            keys.len()
        );
        let expected: Vec<u32> = expected.iter().map(|&i| keys[i as usize]).collect();
        assert!(sorted.keys.read(&gpu) == expected, "{} keys of {bits} bits, {form}", keys.len());
    }
}

fn check_sorts(len: usize) {
    check_sort(&random(len, len as u64, 4_294_967_296.0), 32);
    check_sort(&random(len, len as u64, 8_192.0), 13);
    check_sort(&vec![77; len], 32);
    check_sort(&vec![u32::MAX; len], 32);
    check_sort(&(0..len as u32).rev().collect::<Vec<_>>(), 32);
}

#[test]
fn sort_is_exact_and_stable() {
    for len in &LENGTHS[..11] {
        check_sorts(*len);
    }
}

#[test]
#[ignore = "long: minutes on a software driver"]
fn sort_and_scan_of_ten_million_keys() {
    check_sorts(10_000_019);
    check_scan(&random(10_000_019, 5, 100.0));
    check_scan(&vec![u32::MAX; 10_000_019]);
}

//! Tests of the device's scan and sort against the standard library, exactly, and of its lists against the CPU twin.

use super::cpu::intersect_cpu;
use super::launch::launch_intersect;
use super::scan::launch_scan;
use super::sort::{Pairs, launch_sort};
use super::{Cut, IntersectionLists, TILE, tile_grid};
use crate::camera::Intrinsics;
use crate::dials::Culling;
use crate::gpu::Buffer;
use crate::project::{COLUMNS, Ellipse};
use crate::testing::ellipses::ellipses;
use crate::testing::gpu::gpus;
use crate::testing::random::Random;

/// Lengths around the sizes of a unit, a block, the blocks that one cube takes, and two levels of blocks.
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

/// Gaussians of each tile, front to back.
fn by_tile(lists: &IntersectionLists) -> Vec<&[u32]> {
    lists.tile_start.windows(2).map(|w| &lists.gaussian[w[0]..w[1]]).collect()
}

/// Whether a Gaussian's box of tiles is so large that its intersections are listed by cells of several tiles.
fn coarse(row: &[f32], alpha_min: f64) -> bool {
    let ellipse = Ellipse::from_row(row);
    let limit = super::extent::whitened_limit(ellipse.opacity, alpha_min as f32);
    super::extent::half_extent(&ellipse, limit).iter().any(|half| 2.0 * half > (TILE * 6) as f32)
}

fn check_lists(count: usize, size: [usize; 2], alpha_min: f64) {
    check_lists_by(count, size, Cut { alpha_min, culling: Culling::Ellipse });
}

fn check_lists_by(count: usize, [width, height]: [usize; 2], cut: Cut) {
    let alpha_min = cut.alpha_min;
    let camera = Intrinsics::centred(width, height, 30.0);
    let projected: Vec<f32> = ellipses(count as u64, count, &camera, [0.003, 1.0]).iter().map(|&v| v as f32).collect();
    // The device's lists lie between those of a larger and of a smaller threshold: the twin widens an ellipse by a
    // thousandth of a pixel, and the device's margin for the rounding of sheared needles grows with their distance from
    // the tile. A box on the device is wider by a hundredth of a pixel.
    let lower = if cut.culling == Culling::Ellipse { 0.999 } else { 0.8 };
    let [least, most] =
        [1.03, lower].map(|scale| intersect_cpu(&projected, &camera, Cut { alpha_min: alpha_min * scale, ..cut }));
    let tiles = tile_grid(width, height).iter().product::<usize>();
    for (form, gpu) in gpus() {
        let name = format!("{count} splats, {width} × {height}, {cut:?}, {form}");
        let lists = launch_intersect(&gpu, &Buffer::from_slice(&gpu, &projected), &camera, cut);
        let start = lists.tile_start.read(&gpu);
        let (intersection_of_place, gaussian_of_intersection) =
            (lists.intersection_of_place.read(&gpu), lists.gaussian_of_intersection.read(&gpu));
        assert_eq!((start[0], start[tiles]), (0, lists.intersections as u32), "{name}");
        let counts: Vec<i32> = start.windows(2).map(|w| (w[1] - w[0]) as i32).collect();
        assert_eq!(lists.counts.read(&gpu), counts, "{name}");

        // Intersections are numbered by Gaussian, in depth order.
        let (order, first_intersection) = (lists.order.read(&gpu), lists.first_intersection.read(&gpu));
        let key = |i: u32| (projected[i as usize * COLUMNS + 5], i);
        assert!(order[..lists.visible].windows(2).all(|w| key(w[0]) < key(w[1])), "{name}: not in depth order");
        for (rank, &gaussian) in order[..lists.visible].iter().enumerate() {
            let end =
                if rank + 1 < lists.visible { first_intersection[rank + 1] as usize } else { lists.intersections };
            let own = &gaussian_of_intersection[first_intersection[rank] as usize..end];
            assert!(!own.is_empty() && own.iter().all(|&g| g == gaussian), "{name}: intersections of rank {rank}");
        }
        let mut sorted = intersection_of_place.clone();
        sorted.sort_unstable();
        assert!(
            sorted.iter().enumerate().all(|(i, &intersection)| i == intersection as usize),
            "{name}: an intersection twice or nowhere"
        );

        for (tile, (least, most)) in by_tile(&least).into_iter().zip(by_tile(&most)).enumerate() {
            let places = &intersection_of_place[start[tile] as usize..start[tile + 1] as usize];
            let found: Vec<u32> =
                places.iter().map(|&intersection| gaussian_of_intersection[intersection as usize]).collect();
            assert!(found.windows(2).all(|w| key(w[0]) < key(w[1])), "{name}: tile {tile} is not front to back");
            for needed in least {
                assert!(found.contains(needed), "{name}: tile {tile} lacks Gaussian {needed}");
            }
            for listed in &found {
                let row = &projected[*listed as usize * COLUMNS..];
                let allowed = coarse(row, alpha_min) || most.contains(listed);
                assert!(allowed, "{name}: tile {tile} lists Gaussian {listed}, which does not reach it");
            }
        }
    }
}

#[test]
fn lists_agree_with_the_twin() {
    for count in [0, 1, 10, 3_000, 100_000] {
        check_lists(count, [331, 203], 1.0 / 255.0);
    }
    check_lists(500, [1, 1], 1.0 / 255.0);
    check_lists(500, [16, 17], 1.0 / 255.0);
    check_lists(2_000, [1_000, 777], 1e-4);
    check_lists(200, [100, 100], 0.0);
}

#[test]
fn pictures_of_thirty_thousand_px() {
    check_lists(3, [32_768, 20], 1.0 / 255.0);
    check_lists(3, [20, 32_768], 1.0 / 255.0);
}

#[test]
fn boxes_agree_with_the_twin() {
    for culling in [Culling::OpacityBox, Culling::BoundingBox] {
        for alpha_min in [1.0 / 255.0, 1e-4, 0.3] {
            check_lists_by(3_000, [331, 203], Cut { alpha_min, culling });
        }
        check_lists_by(500, [16, 17], Cut { alpha_min: 1.0 / 255.0, culling });
        check_lists_by(200, [100, 100], Cut { alpha_min: 0.0, culling });
    }
}

#[test]
fn each_culling_lists_fewer_than_the_coarser_one() {
    let camera = Intrinsics::centred(331, 203, 30.0);
    let projected: Vec<f32> = ellipses(8, 2_000, &camera, [0.003, 1.0]).iter().map(|&v| v as f32).collect();
    for (form, gpu) in gpus() {
        let projected = Buffer::from_slice(&gpu, &projected);
        let by = |culling| launch_intersect(&gpu, &projected, &camera, Cut { alpha_min: 1.0 / 255.0, culling });
        let [square, opacity, ellipse] =
            [Culling::BoundingBox, Culling::OpacityBox, Culling::Ellipse].map(|culling| by(culling).intersections);
        println!("{form}: {square} intersections by BoundingBox, {opacity} by OpacityBox, {ellipse} by Ellipse");
        assert!(10 * square > 11 * opacity && 10 * opacity > 11 * ellipse, "{form}: {square}, {opacity}, {ellipse}");
    }
}

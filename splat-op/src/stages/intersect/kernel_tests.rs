//! Tests of the device's lists against the CPU twin. The kernels take no optional feature of a device, so they are tested in one form.

use std::collections::BTreeMap;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::{Arc, Mutex};
use std::thread::{self, ThreadId};

use cubecl::logging::{LaunchObservation, LaunchObserver};
use cubecl::prelude::*;

use super::cpu::intersect_cpu;
use super::emit::LIST_BLOCK;
use super::forward::TileCoverage;
use super::launch::{Counted, DeviceIntersections, Room, launch_intersect, launch_intersect_within};
use super::{Cut, IntersectionLists, TILE_SIZE, tile_grid};
use crate::camera::Intrinsics;
use crate::gpu::{Buffer, Gpu, elementwise};
use crate::project::{COLUMNS, Ellipse};
use crate::testing::ellipses::ellipses;
use crate::testing::gpu::gpu;
use crate::testing::random::Random;

/// Counts the launches of one thread by kernel.
struct Launches(ThreadId, Mutex<BTreeMap<String, usize>>);

impl LaunchObserver for Launches {
    fn launched(&self, kernel: &'static str) {
        if thread::current().id() == self.0 {
            let name = kernel.split('<').next().and_then(|path| path.rsplit("::").next()).unwrap_or(kernel);
            *self.1.lock().expect("no other thread panics").entry(name.to_owned()).or_default() += 1;
        }
    }
}

#[test]
fn lists_take_thirteen_launches_and_the_two_sorts_eight_of_them() {
    let Some(gpu) = gpu() else { return };
    let camera = Intrinsics::centred(1_920, 1_080, 1_000.0);
    let launches = |count, capacity| {
        let projected: Vec<f32> = ellipses(4, count, &camera, [0.003, 1.0]).iter().map(|&v| v as f32).collect();
        let projected = Buffer::from_slice(&gpu, &projected);
        let launches = Arc::new(Launches(thread::current().id(), Mutex::default()));
        let observation = LaunchObservation::new(launches.clone());
        launch_intersect_within(&gpu, &projected, &camera, (1.0 / 255.0).into(), capacity);
        drop(observation);
        launches.1.lock().expect("no other thread panics").clone()
    };
    let found = launches(30_000, None);
    println!("{found:?}");
    let sorts = found.get("CountDigitsKernel").unwrap_or(&0) + found.get("ScatterKernel").unwrap_or(&0);
    assert_eq!((sorts, found.values().sum()), (8, 13), "{found:?}");
    assert_eq!(launches(3, None), found, "the number of launches depends on the number of Gaussians");
    assert_eq!(launches(3, Some(40_000)), found, "lists of an expected length take other launches");
}

#[test]
fn more_intersections_than_a_list_holds_are_refused() {
    let Some(gpu) = gpu() else { return };
    // Gaussians that cover all 2,048 × 2,048 tiles. Of 1,024 of them the number of intersections is 2^32, of 1,025 more.
    let camera = Intrinsics::centred(32_768, 32_768, 30.0);
    let row = Ellipse { mean_px: [16e3, 16e3], sigma_u: 1e6, shear: 0.0, sigma_v: 1e6, depth: 1.0, opacity: 1.0_f32 };
    for (count, bytes) in [(1_024, 1_u64 << 34), (1_025, (1 << 34) + (1 << 24))] {
        let projected = Buffer::from_slice(&gpu, &row.to_row().repeat(count));
        for capacity in [None, Some(5_000)] {
            let lists = || launch_intersect_within(&gpu, &projected, &camera, (1.0 / 255.0).into(), capacity);
            let message = catch_unwind(AssertUnwindSafe(lists)).expect_err("too many");
            let message = message.downcast_ref::<String>().expect("a message");
            for part in ["the list of intersections", &bytes.to_string(), "raise `alpha_min`"] {
                assert!(message.contains(part), "{part}: {message}");
            }
        }
    }
}

/// Everything that the lists of a view say.
fn all_of(gpu: &Gpu, lists: &DeviceIntersections) -> (Vec<i32>, [Vec<u32>; 5]) {
    let mut of_gaussians = [&lists.order, &lists.first_intersection].map(|list| list.read(gpu));
    of_gaussians.iter_mut().for_each(|list| list.truncate(lists.visible));
    let [order, first] = of_gaussians;
    let [start, places, gaussians] =
        [&lists.tile_start, &lists.intersection_of_place, &lists.gaussian_of_intersection].map(|list| list.read(gpu));
    (lists.counts.read(gpu), [order, first, start, places, gaussians])
}

#[test]
fn lists_do_not_depend_on_the_expected_length() {
    let Some(gpu) = gpu() else { return };
    let camera = Intrinsics::centred(331, 203, 30.0);
    for count in [0, 1, 20_000] {
        let projected: Vec<f32> = ellipses(9, count, &camera, [0.003, 1.0]).iter().map(|&v| v as f32).collect();
        let projected = Buffer::from_slice(&gpu, &projected);
        let lists = |capacity| launch_intersect_within(&gpu, &projected, &camera, (1.0 / 255.0).into(), capacity);
        let read = lists(None);
        let needed = read.intersections as u64;
        let read = all_of(&gpu, &read);
        for capacity in [1, needed / 2, needed.saturating_sub(1), needed, needed + 1, 2 * needed, 5 * needed + 5_000] {
            let found = lists(Some(capacity));
            assert_eq!(found.intersections as u64, needed, "{count} Gaussians, {capacity} expected");
            assert!(
                all_of(&gpu, &found) == read,
                "{count} Gaussians: lists of {needed} differ if {capacity} are expected"
            );
        }
        // What lies behind the list is not sorted, not even if it could be a tile.
        let capacity = needed as usize + 3_000;
        let room = Room { tiles: Buffer::zeros(&gpu, capacity), ..Room::new(&gpu, capacity) };
        let found = Counted::launch(&gpu, &projected, &camera, (1.0 / 255.0).into()).lists(&gpu, room);
        assert!(found.tile_start.read(&gpu) == read.1[2], "{count} Gaussians: the end of the room is sorted");
    }
}

/// Gaussians of each tile of the device's lists, front to back.
fn by_tile_on(gpu: &Gpu, lists: &DeviceIntersections) -> Vec<Vec<u32>> {
    let (_, [_, _, start, places, gaussians]) = all_of(gpu, lists);
    let of_tile = |ends: &[u32]| &places[ends[0] as usize..ends[1] as usize];
    let gaussian = |place: &u32| gaussians[*place as usize];
    start.windows(2).map(|ends| of_tile(ends).iter().map(gaussian).collect()).collect()
}

#[test]
fn lists_of_a_mask_are_those_of_its_tiles() {
    let Some(gpu) = gpu() else { return };
    let camera = Intrinsics::centred(331, 203, 30.0);
    let mask: Vec<i32> = (0..tile_grid(331, 203).iter().product()).map(|tile| i32::from(tile * tile % 5 < 2)).collect();
    let on_device = Buffer::from_slice(&gpu, &mask);
    let cut = Cut::from(1.0 / 255.0);
    for count in [0, 20_000] {
        let projected: Vec<f32> = ellipses(9, count, &camera, [0.003, 1.0]).iter().map(|&v| v as f32).collect();
        let projected = Buffer::from_slice(&gpu, &projected);
        let all = launch_intersect_within(&gpu, &projected, &camera, cut, None);
        let mut expected = by_tile_on(&gpu, &all);
        expected.iter_mut().zip(&mask).filter(|(_, inside)| **inside == 0).for_each(|(list, _)| list.clear());
        let needed = expected.iter().map(Vec::len).sum::<usize>();
        assert!(count == 0 || (needed > 1_000 && needed < all.intersections));
        for capacity in [None, Some(1), Some(needed as u64 - u64::from(needed > 0)), Some(all.intersections as u64)] {
            let masked = Cut { mask: Some(&on_device), ..cut };
            let found = launch_intersect_within(&gpu, &projected, &camera, masked, capacity);
            assert_eq!(found.intersections, needed, "{count} Gaussians, {capacity:?} expected");
            assert!(by_tile_on(&gpu, &found) == expected, "{count} Gaussians, {capacity:?} expected: other lists");
        }
    }
}

/// A word that no kernel of the lists writes.
const GUARD: u32 = 0xfeed_beef;

/// Checks what is written into room for `capacity` intersections, and that nothing is written behind it.
fn check_room(gpu: &Gpu, counted: &Counted, capacity: usize, all: Option<&[u32]>) {
    let guarded = |len: usize| Buffer::from_slice(gpu, &vec![GUARD; len + 300]);
    let blocks = capacity.div_ceil(LIST_BLOCK);
    let room =
        Room { capacity, rank_of_block: guarded(blocks), tiles: guarded(capacity), gaussians: guarded(capacity) };
    let [_, sizes] = counted.emit(gpu, &room);
    let listed = sizes.read(gpu)[0] as usize;
    assert_eq!(listed, all.map_or(capacity, |all| capacity.min(all.len())), "room for {capacity}");
    for (name, list, len) in [
        ("ranks", &room.rank_of_block, listed.div_ceil(LIST_BLOCK)),
        ("tiles", &room.tiles, listed),
        ("Gaussians", &room.gaussians, listed),
    ] {
        let words = list.read(gpu);
        assert!(words[..len].iter().all(|word| *word != GUARD), "room for {capacity}: {name} are missing");
        assert!(words[len..].iter().all(|word| *word == GUARD), "room for {capacity}: {name} behind {len} are written");
    }
    if let Some(all) = all {
        assert!(room.gaussians.read(gpu)[..listed] == all[..listed], "room for {capacity}: other Gaussians");
    }
}

#[test]
fn nothing_is_written_behind_the_expected_length() {
    let Some(gpu) = gpu() else { return };
    let (camera, cut) = (Intrinsics::centred(331, 203, 30.0), Cut::from(1.0 / 255.0));
    let projected: Vec<f32> = ellipses(9, 3_000, &camera, [0.003, 1.0]).iter().map(|&v| v as f32).collect();
    let projected = Buffer::from_slice(&gpu, &projected);
    let all = launch_intersect_within(&gpu, &projected, &camera, cut, None).gaussian_of_intersection.read(&gpu);
    let counted = Counted::launch(&gpu, &projected, &camera, cut);
    let needed = all.len();
    for capacity in
        [1, 255, LIST_BLOCK, LIST_BLOCK + 1, needed / 2, needed - 1, needed, needed + 1, needed + 3 * LIST_BLOCK]
    {
        check_room(&gpu, &counted, capacity, Some(&all));
    }
    // Numbers of intersections around 2^32, and of 3,000 Gaussians that cover all 2,048 × 2,048 tiles.
    let camera = Intrinsics::centred(32_768, 32_768, 30.0);
    let row = Ellipse { mean_px: [16e3, 16e3], sigma_u: 1e6, shear: 0.0, sigma_v: 1e6, depth: 1.0, opacity: 1.0_f32 };
    for count in [1_023, 1_024, 1_025, 3_000] {
        let projected = Buffer::from_slice(&gpu, &row.to_row().repeat(count));
        check_room(&gpu, &Counted::launch(&gpu, &projected, &camera, cut), 5_000, None);
    }
}

#[cube(launch_unchecked)]
fn tiles_kernel(covers: &[u32], starts: &[u32], counts: &mut [u32], xs: &mut [u32], ys: &mut [u32], len: u32) {
    if ABSOLUTE_POS < len as usize {
        let cover = TileCoverage::load(covers, ABSOLUTE_POS);
        counts[ABSOLUTE_POS] = cover.count();
        let start = starts[ABSOLUTE_POS];
        for index in 0..starts[ABSOLUTE_POS + 1] - start {
            let (x, y) = cover.tile(index);
            xs[(start + index) as usize] = x;
            ys[(start + index) as usize] = y;
        }
    }
}

#[test]
fn a_coverage_counts_and_names_the_tiles_of_its_cells() {
    let Some(gpu) = gpu() else { return };
    let mut random = Random::new(6);
    let (mut covers, mut starts, mut tiles) = (Vec::new(), vec![0], Vec::new());
    for i in 0..600 {
        // Half of the boxes have a tile to a cell.
        let side = if i % 2 == 0 { 8.99 } else { 75.0 };
        let [width, height] = [(); 2].map(|()| random.between(1.0, side) as u32);
        let [x, y] = [(); 2].map(|()| random.between(0.0, 4_000.0) as u32);
        let share = random.between(0.0, 1.2);
        let cells: Vec<bool> = (0..64).map(|_| random.between(0.0, 1.0) < share).collect();
        // A cell is the smallest number of tiles that divides a side into at most eight.
        let of_cell = [width, height].map(|side| (1..).find(|cell| cell * 8 >= side).expect("a size"));
        let [low, high] = [0, 32].map(|from| {
            let inside = |bit: u32| (bit % 8) * of_cell[0] < width && (bit / 8) * of_cell[1] < height;
            (0..32)
                .filter(|&bit| cells[(from + bit) as usize] && inside(from + bit))
                .fold(0_u32, |word, bit| word | 1 << bit)
        });
        covers.extend([x | y << 16, width | height << 16, low, high]);
        for (dy, dx) in (0..height).flat_map(|dy| (0..width).map(move |dx| (dy, dx))) {
            if cells[(dy / of_cell[1] * 8 + dx / of_cell[0]) as usize] {
                tiles.push((x + dx, y + dy));
            }
        }
        starts.push(tiles.len() as u32);
    }
    let len = starts.len() - 1;
    let [xs, ys] = [(); 2].map(|()| Buffer::<u32>::new(&gpu, tiles.len()));
    let counts = Buffer::<u32>::new(&gpu, len);
    let ((grid, dim), given) = (elementwise(len), [&covers, &starts].map(|values| Buffer::from_slice(&gpu, values)));
    let (client, [covers, starts_given]) = (&gpu.client, given);
    // SAFETY: the lengths given guard every access; a coverage has as many tiles as its starts say, whatever it counts.
    unsafe {
        let given = (covers.arg(), starts_given.arg());
        let len = len as u32;
        tiles_kernel::launch_unchecked(client, grid, dim, given.0, given.1, counts.arg(), xs.arg(), ys.arg(), len);
    }
    assert_eq!(counts.read(&gpu), starts.windows(2).map(|w| w[1] - w[0]).collect::<Vec<_>>());
    let found: Vec<(u32, u32)> = xs.read(&gpu).into_iter().zip(ys.read(&gpu)).collect();
    assert!(found == tiles);
}

/// Gaussians of each tile, front to back.
fn by_tile(lists: &IntersectionLists) -> Vec<&[u32]> {
    lists.tile_start.windows(2).map(|w| &lists.gaussian[w[0]..w[1]]).collect()
}

/// Whether a Gaussian's box of tiles is so large that its intersections are listed by cells of several tiles.
fn coarse(row: &[f32], alpha_min: f64) -> bool {
    let ellipse = Ellipse::from_row(row);
    let limit = super::extent::whitened_limit(ellipse.opacity, alpha_min as f32);
    super::extent::half_extent(&ellipse, limit).iter().any(|half| 2.0 * half > (TILE_SIZE * 6) as f32)
}

fn check_lists(count: usize, [width, height]: [usize; 2], alpha_min: f64) {
    let camera = Intrinsics::centred(width, height, 30.0);
    let projected: Vec<f32> = ellipses(count as u64, count, &camera, [0.003, 1.0]).iter().map(|&v| v as f32).collect();
    // The device's lists lie between those of a larger and of a smaller threshold: the twin widens an ellipse by a
    // thousandth of a pixel, and the device's margin for the rounding of sheared needles grows with their distance from
    // the tile.
    let [least, most] = [1.03, 0.999].map(|scale| intersect_cpu(&projected, &camera, (alpha_min * scale).into()));
    let tiles = tile_grid(width, height).iter().product::<usize>();
    if let Some(gpu) = gpu() {
        let name = format!("{count} splats, {width} × {height}, alpha_min {alpha_min}");
        let lists = launch_intersect(&gpu, &Buffer::from_slice(&gpu, &projected), &camera, alpha_min.into());
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
    // Of the largest number each counting cube has more Gaussians than units.
    for count in [0, 1, 10, 3_000, 450_000] {
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

//! Tests of `intersect` against brute force: no Gaussian that shows is missing, and the lists are as documented.

use super::cpu::intersect_cpu;
use super::{IntersectionLists, TILE_SIZE, tile_grid};
use crate::camera::Intrinsics;
use crate::project::{COLUMNS, Ellipse};
use crate::simd::Real;
use crate::testing::random::Random;

/// Sizes that are multiples of a tile, sizes that are not, and sizes of a single pixel along one side or both.
const SIZES: [(usize, usize); 7] = [(64, 48), (75, 33), (1, 1), (1, 50), (50, 1), (16, 16), (17, 15)];

/// Ellipses in and around a picture: round, thin as needles along any direction, and with depths that repeat.
fn ellipses<F: Real>(random: &mut Random, count: usize, (width, height): (usize, usize)) -> Vec<F> {
    let mut packed = Vec::new();
    let opacities = random.fill(count, 0.0, 1.0);
    for (i, opacity) in opacities.into_iter().enumerate() {
        let mean = [random.between(-30.0, width as f64 + 30.0), random.between(-30.0, height as f64 + 30.0)];
        let needle = i % 3 == 0;
        let sigma_u = if needle { random.between(0.55, 60.0) } else { random.between(0.55, 6.0) };
        let shear = if needle { random.between(-30.0, 30.0) } else { random.between(-1.0, 1.0) };
        let sigma_v = if needle { 0.55 } else { random.between(0.55, 6.0) };
        // Few distinct values, so that ties occur.
        let depth = random.between(1.0, 20.0).floor();
        // Some Gaussians hardly show, or not at all.
        let opacity = if i % 7 == 0 { 0.01 * opacity } else { opacity };
        let ellipse = Ellipse { mean_px: mean, sigma_u, shear, sigma_v, depth, opacity };
        packed.extend(ellipse.to_row().map(F::of));
    }
    packed
}

fn alpha<F: Real>(e: &Ellipse<F>, x: usize, y: usize) -> f64 {
    let (dx, dy) = (F::of(x as f64 + 0.5) - e.mean_px[0], F::of(y as f64 + 0.5) - e.mean_px[1]);
    let (u, v) = (dx / e.sigma_u, (dy - e.shear * dx) / e.sigma_v);
    e.opacity.f64() * (-0.5 * (u * u + v * v).f64()).exp()
}

/// Whether each Gaussian is listed in each tile.
fn listed(lists: &IntersectionLists, tiles: usize, count: usize) -> Vec<Vec<bool>> {
    let list = |tile: usize| {
        let mut listed = vec![false; count];
        for &gaussian in &lists.gaussian[lists.tile_start[tile]..lists.tile_start[tile + 1]] {
            assert!(!listed[gaussian as usize], "Gaussian {gaussian} is listed twice in tile {tile}");
            listed[gaussian as usize] = true;
        }
        listed
    };
    (0..tiles).map(list).collect()
}

fn assert_nothing_is_missing<F: Real>(seed: u64) {
    let mut random = Random::new(seed);
    for size in SIZES {
        for alpha_min in [1.0 / 255.0, 1e-6, 0.3] {
            let packed = ellipses::<F>(&mut random, 150, size);
            let lists = intersect_cpu(&packed, &Intrinsics::centred(size.0, size.1, 50.0), alpha_min.into());
            let [tiles_x, tiles_y] = tile_grid(size.0, size.1);
            let listed = listed(&lists, tiles_x * tiles_y, 150);
            let (mut needed, mut intersections) = (0, vec![vec![false; 150]; tiles_x * tiles_y]);
            for (i, row) in packed.chunks_exact(COLUMNS).enumerate() {
                let ellipse = Ellipse::from_row(row);
                for (x, y) in (0..size.1).flat_map(|y| (0..size.0).map(move |x| (x, y))) {
                    let tile = y / TILE_SIZE * tiles_x + x / TILE_SIZE;
                    if alpha(&ellipse, x, y) >= alpha_min {
                        assert!(listed[tile][i], "{size:?}, alpha_min {alpha_min}: Gaussian {i} shows at {x}, {y}");
                        needed += usize::from(!intersections[tile][i]);
                        intersections[tile][i] = true;
                    }
                }
            }
            // The test of a tile is exact for the rectangle of its pixel centres, so Gaussians listed beyond need pass
            // between the centres. (A picture within one tile keeps all that its bounding box meets.)
            if tiles_x * tiles_y > 4 {
                let total = lists.gaussian.len();
                assert!(total <= needed + needed / 5 + 20, "{size:?}: {total} intersections where {needed} would do");
            }
        }
    }
}

#[test]
fn every_pair_that_shows_is_listed_in_f64() {
    assert_nothing_is_missing::<f64>(1);
}

#[test]
fn every_pair_that_shows_is_listed_in_f32() {
    assert_nothing_is_missing::<f32>(2);
}

#[test]
fn without_a_cut_every_gaussian_is_in_every_tile() {
    let packed = ellipses::<f64>(&mut Random::new(3), 60, (40, 40));
    let lists = intersect_cpu(&packed, &Intrinsics::centred(40, 40, 50.0), 0.0.into());
    assert_eq!(lists.gaussian.len(), 60 * 9);
}

#[test]
fn lists_run_front_to_back_and_intersections_are_found_from_both_sides() {
    for (seed, size) in SIZES.into_iter().enumerate() {
        // More Gaussians than one task takes.
        let packed = ellipses::<f32>(&mut Random::new(10 + seed as u64), 5000, size);
        let lists = intersect_cpu(&packed, &Intrinsics::centred(size.0, size.1, 50.0), (1.0 / 255.0).into());
        let key = |gaussian: &u32| (packed[*gaussian as usize * COLUMNS + 5].to_bits(), *gaussian);
        let [tiles_x, tiles_y] = tile_grid(size.0, size.1);
        assert_eq!(lists.tile_start.len(), tiles_x * tiles_y + 1);
        for window in lists.tile_start.windows(2) {
            assert!(lists.gaussian[window[0]..window[1]].is_sorted_by_key(key));
        }
        assert!(lists.visible.is_sorted());
        assert_eq!(lists.visible_start.len(), lists.visible.len() + 1);
        assert_eq!(*lists.visible_start.last().expect("at least one entry") as usize, lists.gaussian.len());

        let mut seen = vec![false; lists.gaussian.len()];
        for (place, &gaussian) in lists.visible.iter().enumerate() {
            let [first, end] = [0, 1].map(|next| lists.visible_start[place + next] as usize);
            assert!(end > first, "Gaussian {gaussian} is listed without an intersection");
            let intersections = &lists.intersection_of_visible[first..end];
            assert!(intersections.is_sorted(), "tile by tile, which fixes the order of sums");
            for &intersection in intersections {
                assert_eq!(lists.gaussian[intersection as usize], gaussian);
                assert!(
                    !std::mem::replace(&mut seen[intersection as usize], true),
                    "intersection {intersection} belongs to one Gaussian"
                );
            }
        }
        assert!(seen.into_iter().all(|seen| seen));
    }
}

#[test]
fn what_cannot_show_is_not_listed() {
    let row = Ellipse { mean_px: [8.0, 8.0], sigma_u: 2.0, shear: 0.0, sigma_v: 2.0, depth: 3.0, opacity: 0.5 };
    let bad = [
        Ellipse { opacity: 0.0, ..row },
        Ellipse { opacity: 1e-3, ..row },
        Ellipse { opacity: f64::NAN, ..row },
        Ellipse { depth: 0.0, ..row },
        Ellipse { depth: -1.0, ..row },
        Ellipse { depth: f64::NAN, ..row },
        Ellipse { sigma_u: f64::INFINITY, ..row },
        Ellipse { shear: f64::NAN, ..row },
        Ellipse { mean_px: [f64::NAN, 8.0], ..row },
        Ellipse { mean_px: [1e300, 8.0], ..row },
        Ellipse { mean_px: [-60.0, 8.0], ..row },
    ];
    let packed: Vec<f64> = bad.iter().chain([&row]).flat_map(|e| e.to_row()).collect();
    let lists = intersect_cpu(&packed, &Intrinsics::centred(16, 16, 50.0), (1.0 / 255.0).into());
    assert_eq!(lists.gaussian, [bad.len() as u32], "only the good one");
    assert_eq!(lists.visible, [bad.len() as u32]);
}

#[test]
fn the_number_of_threads_changes_no_list() {
    let packed = ellipses::<f32>(&mut Random::new(30), 9000, (75, 50));
    let with = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a small pool");
        let lists = pool.install(|| intersect_cpu(&packed, &Intrinsics::centred(75, 50, 50.0), (1.0 / 255.0).into()));
        (lists.tile_start, lists.gaussian, lists.visible, lists.visible_start, lists.intersection_of_visible)
    };
    assert_eq!(with(1), with(2));
}

#[test]
fn the_corners_beside_a_needle_list_nothing() {
    // Along the diagonal. An opacity of a half reaches √(2 ln(0.5 / 0.45)) = 0.459 deviations, 12.98 px: the box holds pixels from 62 to
    // 87 and from 47 to 72, nine tiles.
    let needle = Ellipse {
        mean_px: [75.0, 60.0],
        sigma_u: 800.0_f64.sqrt(),
        shear: 1.0,
        sigma_v: 0.55,
        depth: 2.0,
        opacity: 0.5,
    };
    let lists = intersect_cpu(&needle.to_row(), &Intrinsics::centred(150, 120, 50.0), 0.45.into());
    let tiles = (0..lists.tile_start.len() - 1).filter(|&tile| lists.tile_start[tile] < lists.tile_start[tile + 1]);
    let tiles: Vec<[usize; 2]> = tiles.map(|tile| [tile % 10, tile / 10]).collect();
    assert!(tiles.contains(&[4, 3]) && tiles.len() < 9, "{tiles:?}");
    assert!(tiles.iter().all(|[x, y]| (3..6).contains(x) && (2..5).contains(y)), "{tiles:?}");
}

//! Tests of what numerical dials change on CPUs and what they must not change.

use super::cpu::{rasterize_backward_cpu, rasterize_cpu};
use super::{Layers, PlaneParts, RasterizeSpec};
use crate::camera::Intrinsics;
use crate::dials::{Culling, Exponential};
use crate::intersect::Cut;
use crate::intersect::cpu::intersect_cpu;
use crate::options::RenderOptions;
use crate::project::Ellipse;
use crate::simd::real::Real;
use crate::testing::random::Random;

const ALL: Layers<bool> = Layers { projected: true, features: true, background: true, mean2d_abs: true };

const NAMES: [&str; 5] = ["planes", "ellipse gradient", "feature gradient", "background gradient", "absolute gradient"];

/// Needles in a picture of 64 × 56 px. Their boxes contain tiles that the needles do not reach.
struct Needles {
    packed: Vec<f64>,
    features: Vec<f64>,
    channels: usize,
}

impl Needles {
    fn new(seed: u64, count: usize, opacity: [f64; 2], channels: usize) -> Self {
        let mut random = Random::new(seed);
        let mut packed = Vec::new();
        for i in 0..count {
            let steep = random.between(0.6, 1.6);
            let ellipse = Ellipse {
                mean_px: [random.between(-4.0, 68.0), random.between(-4.0, 60.0)],
                sigma_u: random.between(4.0, 18.0),
                shear: if i % 2 == 0 { steep } else { -steep },
                sigma_v: random.between(0.55, 1.0),
                depth: random.between(1.0, 9.0),
                opacity: random.between(opacity[0], opacity[1]),
            };
            packed.extend(ellipse.to_row());
        }
        let features = random.fill(count * channels, -1.0, 1.0);
        Self { packed, features, channels }
    }

    /// Returns the length of the longest list of a tile, then planes and gradients in the order of [`NAMES`].
    fn outcome<F: Real>(&self, options: RenderOptions) -> (usize, [Vec<F>; 5]) {
        let real = |values: &[f64]| values.iter().map(|v| F::of(*v)).collect::<Vec<F>>();
        let spec = RasterizeSpec { intrinsics: Intrinsics::centred(64, 56, 30.0), options };
        let (packed, features) = (real(&self.packed), real(&self.features));
        let background = real(&Random::new(3).fill(self.channels, -1.0, 1.0));
        let inputs = Layers { projected: &packed[..], features: &features, background: &background, mean2d_abs: &[] };
        let lists = intersect_cpu(&packed, &spec.intrinsics, Cut::of(&options));
        let longest = lists.tile_start.windows(2).map(|ends| ends[1] - ends[0]).max().expect("there are tiles");
        let grad = real(&Random::new(4).fill(spec.planes(self.channels) * 64 * 56, -1.0, 1.0));
        let (planes, trace) = rasterize_cpu(inputs, &spec, &lists, true);
        let grad = PlaneParts::split(&grad, &spec, self.channels);
        let g = rasterize_backward_cpu(inputs, grad, &spec, (&lists, trace.as_ref()), ALL);
        (longest, [planes, g.projected, g.features, g.background, g.mean2d_abs])
    }
}

fn bits<F: Real>(values: &[F]) -> &[u8] {
    bytemuck::cast_slice(values)
}

/// Returns the lengths of the longest list by ellipses and by squares.
fn assert_culling_changes_no_bit<F: Real>(scene: &Needles, options: RenderOptions) -> [usize; 2] {
    let (shortest, expected) = scene.outcome::<F>(options);
    assert!(expected.iter().all(|values| values.iter().any(|v| *v != F::ZERO)), "a scene that proves nothing");
    let mut longest = shortest;
    for culling in [Culling::OpacityBox, Culling::BoundingBox] {
        let (most, found) = scene.outcome::<F>(options.with_culling(culling));
        assert!(most > longest, "{culling:?} lists {most}, a finer one {longest}");
        longest = most;
        for ((found, expected), name) in found.iter().zip(&expected).zip(NAMES) {
            assert!(bits(found) == bits(expected), "{culling:?} changes bits: {name}");
        }
    }
    [shortest, longest]
}

#[test]
fn culling_changes_no_bit_of_short_lists() {
    for (channels, depth) in [(1, false), (3, false), (3, true), (7, false)] {
        let scene = Needles::new(1, 300, [0.1, 1.0], channels);
        assert_culling_changes_no_bit::<f32>(&scene, RenderOptions::standard().with_depth(depth));
        assert_culling_changes_no_bit::<f64>(&scene, RenderOptions::fast().with_depth(depth));
    }
}

const FAINT: RenderOptions = RenderOptions { alpha_min: 1e-4, ..RenderOptions::standard() };

/// Sums over more than 512 Gaussians, 64 if they may be faint, are sums of partial sums. Gaussians listed in vain must
/// not count.
#[test]
fn culling_changes_no_bit_of_sums_of_sums() {
    for (count, options) in [(1_700, FAINT), (2_600, RenderOptions::standard())] {
        let scene = Needles::new(2, count, [0.006, 0.012], 3);
        let [fine, _] = assert_culling_changes_no_bit::<f32>(&scene, options);
        assert!(fine > 512, "lists of up to {fine} prove little");
    }
}

/// Lists of more than 2,048 Gaussians, 256 if they may be faint, use other arithmetic. Gaussians listed in vain must
/// not count.
#[test]
fn culling_changes_no_bit_where_only_boxes_make_a_list_long() {
    for (count, options, long) in [(290, FAINT, 256), (3_600, RenderOptions::standard(), 2_048)] {
        let scene = Needles::new(2, count, [0.006, 0.012], 3);
        let [fine, coarse] = assert_culling_changes_no_bit::<f32>(&scene, options);
        assert!(fine < long && coarse > long, "lists of up to {fine} and {coarse} prove little");
    }
}

fn largest_difference<F: Real>(found: &[F], expected: &[F]) -> f64 {
    let largest = expected.iter().fold(0.0_f64, |most, v| most.max(v.f64().abs()));
    found.iter().zip(expected).map(|(a, b)| (a.f64() - b.f64()).abs()).fold(0.0, f64::max) / largest
}

#[test]
fn exponentials_differ_by_rounding_alone() {
    // Numbers of channels of each specialised version, and lists long enough for sums of partial sums.
    for (channels, count, opacity) in [(1, 300, 0.9), (3, 300, 0.9), (4, 300, 0.9), (6, 300, 0.9), (3, 500, 0.01)] {
        let scene = Needles::new(5, count, [0.005, opacity], channels);
        let options = RenderOptions { transmittance_min: 0.0, alpha_min: 1e-4, ..RenderOptions::standard() };
        let by = |exponential| scene.outcome::<f32>(options.with_exponential(exponential)).1;
        let (standard, polynomial, library) =
            (by(Exponential::Standard), by(Exponential::Polynomial), by(Exponential::Library));
        assert!(standard.iter().zip(&polynomial).all(|(a, b)| bits(a) == bits(b)), "the standard of CPUs");
        assert!(polynomial[0] != library[0], "{channels} channels: the dial changes nothing");
        for ((a, b), name) in polynomial.iter().zip(&library).zip(NAMES) {
            let difference = largest_difference(a, b);
            assert!(difference <= 3e-6, "{channels} channels, {name}: {difference:.1e} of the largest");
        }
        let double = |exponential| scene.outcome::<f64>(options.with_exponential(exponential)).1;
        let (a, b) = (double(Exponential::Polynomial), double(Exponential::Library));
        assert!(a.iter().zip(&b).all(|(a, b)| bits(a) == bits(b)), "f64 is the reference");
    }
}

//! What stands where: houses around courtyards, trees along the streets and in the courtyards.

use glam::{DVec2, DVec3};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use super::super::DemoOptions;
use super::super::options::Stream;
use super::paint::Paint;
use super::solid::Thing;
use super::{BETWEEN_STREETS, HALF, HALF_STREET};

/// Depth of houses from their front, m.
const DEPTH: f64 = 12.0;

/// All houses and trees.
pub(super) fn things(options: &DemoOptions) -> Vec<Thing> {
    let mut random = options.random(Stream::Town);
    let mut things = Vec::new();
    let blocks = (2.0 * HALF / BETWEEN_STREETS) as usize;
    for block in 0..blocks * blocks {
        let at = DVec2::new((block % blocks) as f64, (block / blocks) as f64);
        let low = DVec2::splat(HALF_STREET - HALF) + BETWEEN_STREETS * at;
        let high = low + (BETWEEN_STREETS - 2.0 * HALF_STREET);
        houses(low, high, &mut things, &mut random);
        trees(low, high, &mut things, &mut random);
    }
    things
}

/// Rows of houses along the four sides of a block. Those along x take the corners.
fn houses(low: DVec2, high: DVec2, things: &mut Vec<Thing>, random: &mut ChaCha8Rng) {
    for y in [low.y, high.y - DEPTH] {
        row(DVec2::new(low.x, y), DVec2::X, high.x - low.x, things, random);
    }
    for x in [low.x, high.x - DEPTH] {
        row(DVec2::new(x, low.y + DEPTH), DVec2::Y, high.y - low.y - 2.0 * DEPTH, things, random);
    }
}

fn row(from: DVec2, along: DVec2, length: f64, things: &mut Vec<Thing>, random: &mut ChaCha8Rng) {
    let across = DVec2::new(along.y, along.x);
    let mut at = 0.0;
    while length - at >= 8.0 {
        let left = length - at;
        let width: f64 = random.random_range(9.0..18.0);
        // No gap at the end is too narrow for a house.
        let width = if left - width < 9.0 { left.min(18.0) } else { width };
        let (height, style) = (random.random_range(7.0..17.0), random.random::<f64>());
        let paint = Paint::House { seed: random.random_range(0..1 << 20) };
        let start = from + at * along;
        let end = start + width * along + DEPTH * across;
        let (low, high) = (start.extend(0.0), end.extend(height));
        things.push(match style < 0.6 {
            true => Thing::gabled(low, high, along.extend(0.0), random.random_range(3.0..5.0), paint),
            false => Thing::cuboid(low, high, paint),
        });
        // Every fourth house has a gap beside it, through which the courtyard shows.
        at += width + if random.random::<f64>() < 0.25 { 4.0 } else { 0.0 };
    }
}

fn trees(low: DVec2, high: DVec2, things: &mut Vec<Thing>, random: &mut ChaCha8Rng) {
    for _ in 0..6 {
        let share = DVec2::new(random.random(), random.random());
        let margin = DVec2::splat(DEPTH + 5.0);
        tree(low + margin + share * (high - low - 2.0 * margin), random.random_range(2.5..4.0), things, random);
    }
    // On the pavements before the block, on its sides towards low x and low y.
    for i in 0..4 {
        let along = 10.0 + 20.0 * f64::from(i) + random.random_range(-4.0..4.0);
        tree(DVec2::new(low.x + along, low.y - 2.0), random.random_range(1.3..1.9), things, random);
        tree(DVec2::new(low.x - 2.0, low.y + along), random.random_range(1.3..1.9), things, random);
    }
}

fn tree(at: DVec2, radius: f64, things: &mut Vec<Thing>, random: &mut ChaCha8Rng) {
    let height = radius + random.random_range(2.2..3.2);
    let seed = random.random_range(0..1 << 20);
    let half = DVec3::new(0.25, 0.25, 0.0);
    things.push(Thing::cuboid(at.extend(0.0) - half, at.extend(height) + half, Paint::Trunk));
    things.push(Thing::ball(at.extend(height), radius, Paint::Crown { seed }));
}

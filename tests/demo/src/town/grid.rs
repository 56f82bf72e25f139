//! The grid over the town, in which rays look for things square by square (Amanatides and Woo 1987).

use glam::{DVec2, DVec3};

use super::super::geometry::{Hit, Ray, slab};
use super::solid::Thing;

/// Side of a square, m.
const SQUARE: f64 = 8.0;

/// All things, by the squares that their boxes touch.
#[derive(Clone, Debug)]
pub(super) struct Grid {
    pub things: Vec<Thing>,
    /// Indices of the things in each square, rows of equal y one after the other.
    squares: Vec<Vec<u32>>,
    low: DVec3,
    high: DVec3,
    /// Number of squares along x and y.
    size: [usize; 2],
}

impl Grid {
    pub fn new(things: Vec<Thing>) -> Self {
        let low = things.iter().fold(DVec3::INFINITY, |low, thing| low.min(thing.low));
        let high = things.iter().fold(DVec3::NEG_INFINITY, |high, thing| high.max(thing.high));
        let size = ((high - low).truncate() / SQUARE).to_array().map(|squares| (squares.max(0.0) as usize) + 1);
        let mut grid = Self { things: Vec::new(), squares: vec![Vec::new(); size[0] * size[1]], low, high, size };
        for (i, thing) in things.iter().enumerate() {
            let ([x0, y0], [x1, y1]) = (grid.square_at(thing.low.truncate()), grid.square_at(thing.high.truncate()));
            for y in y0..=y1 {
                // There are far fewer than 2³² things.
                (x0..=x1).for_each(|x| grid.squares[y * size[0] + x].push(i as u32));
            }
        }
        Self { things, ..grid }
    }

    /// The square at a place, or the nearest one.
    fn square_at(&self, at: DVec2) -> [usize; 2] {
        let [x, y] = ((at - self.low.truncate()) / SQUARE).to_array();
        // The cast clamps below.
        [(x as usize).min(self.size[0] - 1), (y as usize).min(self.size[1] - 1)]
    }

    /// The nearest thing ahead, and where the ray meets it.
    pub fn hit(&self, ray: &Ray) -> Option<(usize, Hit)> {
        let (centre, half) = (0.5 * (self.low + self.high), 0.5 * (self.high - self.low));
        let local = Ray { origin: ray.origin - centre, ..*ray };
        let [x, y, z] = DVec3::AXES.map(|axis| slab(&local, axis, half.dot(axis)));
        let inside = x?.intersect(y?).intersect(z?);
        let (start, end) = (inside.enter.0.max(0.0), inside.exit.0);
        if !(start <= end) {
            return None;
        }
        let mut square = self.square_at(ray.at(start).truncate());
        let speed = ray.direction.truncate().to_array();
        // Distance along the ray to the border of the next square, for each axis.
        let border = |axis: usize, square: usize| {
            let ahead = square as f64 + if speed[axis] > 0.0 { 1.0 } else { 0.0 };
            match speed[axis] == 0.0 {
                true => f64::INFINITY,
                false => (self.low[axis] + SQUARE * ahead - ray.origin[axis]) / speed[axis],
            }
        };
        let mut next = [border(0, square[0]), border(1, square[1])];
        let mut nearest: Option<(usize, Hit)> = None;
        loop {
            for &i in &self.squares[square[1] * self.size[0] + square[0]] {
                let hit = self.things[i as usize].hit(ray);
                if let Some(hit) = hit.filter(|hit| nearest.is_none_or(|(_, best)| hit.distance < best.distance)) {
                    nearest = Some((i as usize, hit));
                }
            }
            let axis = if next[0] <= next[1] { 0 } else { 1 };
            // A thing may reach into squares beyond this one, where another may be nearer.
            if next[axis] >= end || nearest.is_some_and(|(_, hit)| hit.distance <= next[axis]) {
                return nearest;
            }
            let moved = if speed[axis] > 0.0 { square[axis].checked_add(1) } else { square[axis].checked_sub(1) };
            match moved.filter(|&moved| moved < self.size[axis]) {
                Some(moved) => square[axis] = moved,
                None => return nearest,
            }
            next[axis] = border(axis, square[axis]);
        }
    }
}

//! The room between the cameras.

use glam::DVec3;

use crate::optim::scene_extent;

/// Smallest margin, relative to the extent of the cameras. Without one, whether a point on the border is inside would be rounding.
const SMALLEST_MARGIN: f64 = 1e-3;

/// Largest number of steps of the search for the nearest point of the hull. A point that is still undecided then lies on the border.
const STEPS: usize = 200;

/// The convex hull of camera centres, widened by a margin on all sides: all points whose distance to the hull is at most the margin.
#[derive(Clone, Debug)]
pub struct CameraHull {
    centres: Vec<DVec3>,
    margin: f64,
}

impl CameraHull {
    /// Makes the hull of `centres`, at least one, world frame. `margin` is relative to the extent of the cameras
    /// ([`scene_extent`]), about the radius of the room that they fill, and is a thousandth at least.
    ///
    /// # Panics
    /// Without centres.
    pub fn new(centres: &[DVec3], margin: f64) -> Self {
        assert!(!centres.is_empty(), "the hull of no cameras");
        Self { centres: centres.to_vec(), margin: margin.max(SMALLEST_MARGIN) * scene_extent(centres) }
    }

    /// Whether a position, world frame, lies inside.
    ///
    /// The nearest point of the hull is a weighted mean of the centres. Each step of the search moves weight from the centre that
    /// lies farthest away along the present difference to the one that lies nearest (Mitchell, Demyanov and Malozemov 1974).
    pub fn holds(&self, position: [f32; 3]) -> bool {
        let position = DVec3::from_array(position.map(f64::from));
        if !position.is_finite() {
            return false;
        }
        let mut weights = vec![0.0; self.centres.len()];
        weights[0] = 1.0;
        let mut difference = self.centres[0] - position;
        for _ in 0..STEPS {
            let distance = difference.length();
            if distance <= self.margin {
                return true;
            }
            let along = |i: usize| difference.dot(self.centres[i] - position);
            let by_place = |a: &usize, b: &usize| along(*a).total_cmp(&along(*b));
            let all = 0..self.centres.len();
            let nearest = all.clone().min_by(by_place).expect("there are centres");
            let farthest = all.filter(|&i| weights[i] > 0.0).max_by(by_place).expect("weights sum to one");
            // No centre, and so no point of the hull, is nearer along the difference.
            if along(nearest) > self.margin * distance {
                return false;
            }
            let way = self.centres[nearest] - self.centres[farthest];
            let share = (-difference.dot(way) / way.length_squared()).clamp(0.0, weights[farthest]);
            if share.is_nan() || share <= 0.0 {
                break;
            }
            weights[nearest] += share;
            weights[farthest] -= share;
            difference += share * way;
        }
        difference.length() <= self.margin
    }
}

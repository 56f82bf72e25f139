//! The town's shapes: convex solids with few sides, and balls.

use glam::DVec3;

use super::super::geometry::{Hit, Ray, Shape};
use super::paint::Paint;

/// A side of a convex solid: the unit normal out of it, and the plane's distance from zero along the normal.
pub(super) type Side = (DVec3, f64);

/// A shape, world frame.
#[derive(Clone, Debug)]
pub(super) enum Body {
    /// The points below all sides.
    Convex(Vec<Side>),
    /// Centre and radius, m.
    Ball(DVec3, f64),
}

/// A body with its paint, and the box that holds it.
#[derive(Clone, Debug)]
pub(super) struct Thing {
    pub body: Body,
    pub low: DVec3,
    pub high: DVec3,
    pub paint: Paint,
}

impl Thing {
    /// A box.
    pub fn cuboid(low: DVec3, high: DVec3, paint: Paint) -> Self {
        Self { body: Body::Convex(sides(low, high)), low, high, paint }
    }

    /// A house whose walls end at the top of the box, with a roof that rises `rise` m to a ridge along x or y.
    pub fn gabled(low: DVec3, eaves: DVec3, ridge_along: DVec3, rise: f64, paint: Paint) -> Self {
        let across = DVec3::new(ridge_along.y, ridge_along.x, 0.0);
        let middle = 0.5 * (low + eaves);
        let half = 0.5 * (eaves - low).dot(across);
        let top = eaves.with_z(eaves.z + rise);
        let mut all = sides(low, top);
        for side in [-across, across] {
            let normal = (rise * side + half * DVec3::Z).normalize();
            all.push((normal, normal.dot(middle.with_z(top.z))));
        }
        Self { body: Body::Convex(all), low, high: top, paint }
    }

    /// A ball.
    pub fn ball(centre: DVec3, radius: f64, paint: Paint) -> Self {
        Self { body: Body::Ball(centre, radius), low: centre - radius, high: centre + radius, paint }
    }

    /// The nearest point of the surface ahead of a ray that starts outside.
    pub fn hit(&self, ray: &Ray) -> Option<Hit> {
        match &self.body {
            Body::Convex(sides) => entry(sides, ray),
            Body::Ball(centre, radius) => {
                let local = Ray { origin: ray.origin - *centre, direction: ray.direction };
                Shape::Sphere { radius: *radius }.hit(&local, f64::INFINITY)
            }
        }
    }
}

fn sides(low: DVec3, high: DVec3) -> Vec<Side> {
    DVec3::AXES.into_iter().flat_map(|axis| [(axis, high.dot(axis)), (-axis, -low.dot(axis))]).collect()
}

/// Where a ray enters a convex solid.
fn entry(sides: &[Side], ray: &Ray) -> Option<Hit> {
    let (mut enter, mut exit, mut normal) = (0.0, f64::INFINITY, None);
    for &(side, height) in sides {
        let (above, speed) = (height - side.dot(ray.origin), side.dot(ray.direction));
        if speed < 0.0 {
            if above / speed > enter {
                (enter, normal) = (above / speed, Some(side));
            }
        } else if speed > 0.0 {
            exit = f64::min(exit, above / speed);
        } else if above < 0.0 {
            return None;
        }
        if exit < enter {
            return None;
        }
    }
    normal.map(|normal| Hit { distance: enter, normal })
}

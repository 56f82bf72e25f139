//! The torus: a tube of radius `minor` around the circle of radius `major` in the plane z = 0. It is the only shape whose
//! intersection is found by marching.

use glam::{DVec2, DVec3};

use super::geometry::{Hit, Occlusion, Ray, slab, tube};

/// Signed distance to the torus.
pub(super) fn distance_to(point: DVec3, major: f64, minor: f64) -> f64 {
    DVec2::new(point.truncate().length() - major, point.z).length() - minor
}

/// The gradient of [`distance_to`], which on the surface is the outward normal.
fn normal_at(point: DVec3, major: f64) -> DVec3 {
    let plane = point.truncate();
    // On the axis and in the middle of the tube any direction serves.
    let outwards = plane.try_normalize().unwrap_or(DVec2::X);
    (outwards * (plane.length() - major)).extend(point.z).try_normalize().unwrap_or(DVec3::Z)
}

/// The segment of a ray that can meet the torus: within its flat hull, without the hole at either end.
fn stretch(ray: &Ray, major: f64, minor: f64) -> Option<(f64, f64)> {
    let hull = tube(ray, major + minor)?.intersect(slab(ray, DVec3::Z, minor)?);
    let (mut start, mut end) = (hull.enter.0.max(0.0), hull.exit.0);
    if major > minor
        && let Some(hole) = tube(ray, major - minor)
    {
        let (from, to) = (hole.enter.0, hole.exit.0);
        if from <= start && to > start {
            start = to;
        }
        if to >= end && from < end {
            end = from;
        }
    }
    (start <= end).then_some((start, end))
}

/// The distance to the torus at which marching ends and Newton's method begins.
const CLOSE: f64 = 1e-4;

const MAX_STEPS: usize = 96;

/// Marches by the distance to the surface, which cannot step over it, then refines with Newton's method.
pub(super) fn hit(ray: &Ray, limit: f64, major: f64, minor: f64) -> Option<Hit> {
    let (mut t, end) = stretch(ray, major, minor)?;
    let end = end.min(limit);
    for _ in 0..MAX_STEPS {
        let distance = distance_to(ray.at(t), major, minor);
        if distance < CLOSE
            && let Some(hit) = polish(ray, t, major, minor)
        {
            return Some(hit);
        }
        // On the way out from a start on the surface the distance is tiny: keep moving.
        t += distance.abs().max(CLOSE);
        if t > end {
            return None;
        }
    }
    None
}

/// Marches along the cone's axis by the distance between the surface and the cone.
pub(super) fn cover(ray: &Ray, spread: f64, major: f64, minor: f64) -> Occlusion {
    // The hull of a torus thickened by the cone's radius at the exit.
    let widest = spread * (ray.origin.length() + major + minor);
    let Some((mut t, end)) = stretch(ray, major, minor + widest) else { return Occlusion::Nothing };
    let mut cover = Occlusion::Nothing;
    for _ in 0..MAX_STEPS {
        let (distance, radius) = (distance_to(ray.at(t), major, minor), spread * t);
        if distance < -radius {
            return Occlusion::All;
        }
        if distance < radius {
            cover = Occlusion::Part;
        }
        // The least step passes over contacts too shallow to darken anything.
        t += ((distance.abs() - radius) / (1.0 + spread)).max(0.02 * minor);
        if t > end {
            return cover;
        }
    }
    Occlusion::Part
}

/// The surface ahead of a point just before it, by Newton's method; `None` if the ray only passes close by.
///
/// Along the ray the distance is convex there, so that the steps stay before the surface.
fn polish(ray: &Ray, mut t: f64, major: f64, minor: f64) -> Option<Hit> {
    for _ in 0..8 {
        let (distance, normal) = (distance_to(ray.at(t), major, minor), normal_at(ray.at(t), major));
        let slope = normal.dot(ray.direction);
        if slope >= 0.0 {
            return None;
        }
        if distance.abs() < 1e-12 {
            break;
        }
        t -= distance / slope;
    }
    let normal = normal_at(ray.at(t), major);
    let met = distance_to(ray.at(t), major, minor).abs() < 1e-8 && normal.dot(ray.direction) < 0.0;
    met.then_some(Hit { distance: t, normal })
}

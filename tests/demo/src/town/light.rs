//! The light of the town: a sun with hard shadows, and a sky.

use glam::DVec3;

use super::super::geometry::Ray;
use super::super::texture::Texture;
use super::grid::Grid;
use super::paint;
use super::solid::Thing;

const SUN: DVec3 = DVec3::new(2.3, 2.1, 1.75);
const SKY_ABOVE: DVec3 = DVec3::new(0.62, 0.72, 0.9);
const BOUNCE_BELOW: DVec3 = DVec3::new(0.36, 0.32, 0.27);

/// Brightness of the sky where its texture is white.
const SKY_GLOW: f64 = 2.0;

/// Offset of shadow rays from the surface, m, so that rounding does not start them inside it.
const LIFT: f64 = 1e-6;

/// Radius of the ground around the town's middle, m, on whose edge the sky stands.
pub(super) const HORIZON: f64 = 900.0;

/// A point that a ray meets.
#[derive(Clone, Copy, Debug)]
pub(super) struct SeenPoint {
    pub distance: f64,
    pub position_world: DVec3,
    normal_world: DVec3,
    /// Index of the thing; none for the ground.
    thing: Option<usize>,
}

/// The town with its light.
#[derive(Clone, Debug)]
pub(super) struct LitTown {
    grid: Grid,
    to_sun: DVec3,
}

impl LitTown {
    pub fn new(things: Vec<Thing>) -> Self {
        Self { grid: Grid::new(things), to_sun: DVec3::new(0.52, -0.38, 0.77).normalize() }
    }

    /// The nearest surface ahead; none where the ray meets the sky.
    pub fn hit(&self, ray: &Ray) -> Option<SeenPoint> {
        if let Some((thing, hit)) = self.grid.hit(ray) {
            let position_world = ray.at(hit.distance);
            let (distance, normal_world) = (hit.distance, hit.normal);
            return Some(SeenPoint { distance, position_world, normal_world, thing: Some(thing) });
        }
        let distance = -ray.origin.z / ray.direction.z;
        let position_world = ray.at(distance).with_z(0.0);
        let ground = distance > 0.0 && position_world.length() <= HORIZON;
        ground.then_some(SeenPoint { distance, position_world, normal_world: DVec3::Z, thing: None })
    }

    /// Linear light along a ray.
    pub fn along(&self, ray: &Ray) -> DVec3 {
        match self.hit(ray) {
            Some(point) => self.matte(&point),
            None => SKY_GLOW * Texture::Sky.colour(ray.direction, DVec3::Z),
        }
    }

    /// Linear light that a point sends in all directions.
    pub fn matte(&self, point: &SeenPoint) -> DVec3 {
        let (at, normal) = (point.position_world, point.normal_world);
        let colour = match point.thing {
            Some(thing) => self.grid.things[thing].paint.colour(at, normal),
            None => paint::ground(at),
        };
        let cosine = normal.dot(self.to_sun);
        let lit = cosine > 0.0 && self.grid.hit(&Ray { origin: at + LIFT * normal, direction: self.to_sun }).is_none();
        let sun = if lit { cosine } else { 0.0 };
        let ambient = BOUNCE_BELOW.lerp(SKY_ABOVE, 0.5 + 0.5 * normal.z);
        colour.min(DVec3::ONE) * (sun * SUN + 0.7 * ambient)
    }
}

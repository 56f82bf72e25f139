//! Shading of the demo's surfaces. Matte light depends on the point alone, not on the viewing direction.

use std::f64::consts::TAU;

use glam::DVec3;

use super::geometry::{Occlusion, Ray, Shape};
use super::scene::{DemoScene, ObjectKind, SceneObject, SurfacePoint};

/// Rays to the sun per shaded point: 16 levels of penumbra, finer than 8 bits show after averaging 9 samples.
const SUN_SAMPLES: usize = 16;

/// Angular radius of the sun: six times the real one, for soft shadows.
const SUN_RADIUS_RAD: f64 = 0.05;

/// Offset of shadow rays from the surface, so that rounding does not start them inside it.
const LIFT: f64 = 1e-4;

const SUN: DVec3 = DVec3::new(2.7, 2.4, 1.95);
const SKY_ABOVE: DVec3 = DVec3::new(0.5, 0.6, 0.78);
const BOUNCE_BELOW: DVec3 = DVec3::new(0.26, 0.22, 0.17);

/// Brightness of the sky where the texture is white.
const SKY_GLOW: f64 = 2.0;

/// The scene with its light.
#[derive(Clone, Debug)]
pub(super) struct LitScene {
    pub scene: DemoScene,
    to_sun: DVec3,
    /// Unit directions, spread evenly over the sun's disc.
    sun_samples: [DVec3; SUN_SAMPLES],
}

impl LitScene {
    pub fn new(scene: DemoScene) -> Self {
        let to_sun = DVec3::new(0.5, -0.42, 0.85).normalize();
        let (side, up) = to_sun.any_orthonormal_pair();
        // A sunflower's spiral: equal areas, no rows.
        let golden_angle = TAU * (1.0 - 0.5 * (5.0_f64.sqrt() - 1.0));
        let sun_samples = std::array::from_fn(|i| {
            let radius = SUN_RADIUS_RAD * ((i as f64 + 0.5) / SUN_SAMPLES as f64).sqrt();
            let (sin, cos) = (golden_angle * i as f64).sin_cos();
            (to_sun + radius * (cos * side + sin * up)).normalize()
        });
        Self { scene, to_sun, sun_samples }
    }

    /// Linear light along a ray of the world frame; [`display`] turns it into picture values.
    pub fn along(&self, ray: &Ray) -> DVec3 {
        let Some(point) = self.scene.hit(ray) else {
            return DVec3::ZERO;
        };
        self.towards(ray, &point)
    }

    /// Linear light that a point reflects along the ray that met it.
    pub fn towards(&self, ray: &Ray, point: &SurfacePoint) -> DVec3 {
        let matte = self.matte(point);
        match self.scene.objects[point.object].kind {
            ObjectKind::Glossy => self.with_reflection(ray, point, matte),
            ObjectKind::Lacquered => matte + self.sheen(ray, point),
            ObjectKind::Matte | ObjectKind::Ground | ObjectKind::Sky => matte,
        }
    }

    /// Linear light that leaves a point equally in all directions.
    pub fn matte(&self, point: &SurfacePoint) -> DVec3 {
        let object = &self.scene.objects[point.object];
        let colour = object.colour(point.position_world, point.normal_world);
        if object.kind == ObjectKind::Sky {
            return SKY_GLOW * colour;
        }
        let cosine = point.normal_world.dot(self.to_sun);
        let sun = if cosine > 0.0 { cosine * self.sun_share(point) } else { 0.0 };
        let above = 0.5 + 0.5 * point.normal_world.z;
        let ambient = BOUNCE_BELOW.lerp(SKY_ABOVE, above) * self.open_share(point);
        colour * (sun * SUN + ambient)
    }

    /// One mirrored ray, weighted by Schlick's approximation of the Fresnel factor, and the sun's highlight.
    fn with_reflection(&self, ray: &Ray, point: &SurfacePoint, matte: DVec3) -> DVec3 {
        let cosine = -ray.direction.dot(point.normal_world);
        let mirrored = ray.direction + 2.0 * cosine * point.normal_world;
        let reflected = Ray { origin: point.position_world + LIFT * point.normal_world, direction: mirrored };
        let seen = self.scene.hit(&reflected).map_or(DVec3::ZERO, |point| self.matte(&point));
        let share = 0.3 + 0.7 * (1.0 - cosine.clamp(0.0, 1.0)).powi(5);
        let highlight = 6.0 * mirrored.dot(self.to_sun).max(0.0).powi(300) * self.sun_share(point);
        matte.lerp(seen, share) + DVec3::splat(highlight)
    }

    /// A highlight of the sun, broad enough for low-degree harmonics to represent (Phong 1975).
    fn sheen(&self, ray: &Ray, point: &SurfacePoint) -> DVec3 {
        let mirrored = ray.direction - 2.0 * ray.direction.dot(point.normal_world) * point.normal_world;
        DVec3::splat(0.6 * mirrored.dot(self.to_sun).max(0.0).powi(3) * self.sun_share(point))
    }

    /// The visible share of the sun's disc.
    fn sun_share(&self, point: &SurfacePoint) -> f64 {
        let origin = point.position_world + LIFT * point.normal_world;
        let middle = Ray { origin, direction: self.to_sun };
        let mut in_the_way: Vec<&SceneObject> = Vec::new();
        for (i, object) in self.scene.objects.iter().enumerate() {
            // A convex solid never stands between the sun and the side of it that faces the sun.
            let itself = i == point.object && !matches!(object.shape, Shape::Torus { .. });
            if itself || !object.casts_shadow() || !object.may_be_near(&middle, SUN_RADIUS_RAD) {
                continue;
            }
            match object.cover(&middle, SUN_RADIUS_RAD) {
                Occlusion::Nothing => {}
                Occlusion::Part => in_the_way.push(object),
                Occlusion::All => return 0.0,
            }
        }
        if in_the_way.is_empty() {
            return 1.0;
        }
        let sees_sun = |&&direction: &&DVec3| {
            let ray = Ray { origin, direction };
            !in_the_way.iter().any(|object| object.hit(&ray, f64::INFINITY).is_some())
        };
        // The spiral ends at the sun's rim: if its last four samples agree, the others almost always do.
        let (inner, rim) = self.sun_samples.split_at(SUN_SAMPLES - 4);
        let open = match rim.iter().filter(sees_sun).count() {
            0 => 0,
            4 => SUN_SAMPLES,
            open => open + inner.iter().filter(sees_sun).count(),
        };
        open as f64 / SUN_SAMPLES as f64
    }

    /// The share of the sky's light that neighbours leave to a point. Each neighbour is approximated by a ball.
    fn open_share(&self, point: &SurfacePoint) -> f64 {
        let mut open = 1.0;
        for (i, object) in self.scene.objects.iter().enumerate() {
            let radius = match object.shape {
                Shape::Sphere { radius } => radius,
                Shape::Cuboid { half } => half.min_element() * 1.2,
                Shape::Cylinder { radius, half_height } if half_height > radius => 1.2 * radius,
                _ => continue,
            };
            if i == point.object {
                continue;
            }
            let towards = object.centre_world - point.position_world;
            let squared = towards.length_squared();
            // Farther than six radii a ball hides less than 3%.
            if squared > 36.0 * radius * radius {
                continue;
            }
            // The form factor of a ball above the horizon (Quilez, "sphere ambient occlusion").
            let hidden = point.normal_world.dot(towards).max(0.0) * radius * radius / (squared * squared.sqrt());
            open *= 1.0 - hidden.min(0.9);
        }
        // Surfaces above the platform that face down see it from close by.
        let height = point.position_world.z.max(0.0);
        let down = 0.5 - 0.5 * point.normal_world.z;
        open * (1.0 - 0.6 * down * (-height / 0.2).exp())
    }
}

/// Display-referred RGB, 0 to 1, of linear light: a soft shoulder instead of clipping, then gamma 2.2.
pub(super) fn display(light: DVec3) -> DVec3 {
    let exposed = DVec3::ONE - (-0.85 * light).exp();
    exposed.max(DVec3::ZERO).powf(1.0 / 2.2)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn display_is_monotonic_and_within_range() {
        let shown: Vec<f64> = (0..100).map(|i| display(DVec3::splat(0.1 * f64::from(i))).x).collect();
        assert!(shown.windows(2).all(|pair| pair[0] < pair[1]));
        assert!(shown[0] == 0.0 && shown[99] <= 1.0);
    }
}

//! Shapes and their intersections with rays. Each shape has its own frame, centred at zero; lengths are in scene units.

use glam::DVec3;

use super::torus;

/// A half line.
#[derive(Clone, Copy, Debug)]
pub(super) struct Ray {
    pub origin: DVec3,
    /// Unit length.
    pub direction: DVec3,
}

impl Ray {
    pub fn at(&self, distance: f64) -> DVec3 {
        self.origin + distance * self.direction
    }
}

/// The intersection of a ray and a surface.
#[derive(Clone, Copy, Debug)]
pub(super) struct Hit {
    /// Distance from the ray's origin, positive.
    pub distance: f64,
    /// Unit normal, out of the solid; up for [`Shape::Disc`], inwards for [`Shape::Dome`].
    pub normal: DVec3,
}

/// A surface.
#[derive(Clone, Copy, Debug)]
pub(super) enum Shape {
    Sphere {
        radius: f64,
    },
    /// Half of its sides along x, y, z.
    Cuboid {
        half: DVec3,
    },
    /// Closed, around the z axis, from `-half_height` to `half_height`.
    Cylinder {
        radius: f64,
        half_height: f64,
    },
    /// A tube of radius `minor` around the circle of radius `major` in the plane z = 0.
    Torus {
        major: f64,
        minor: f64,
    },
    /// The part of the plane z = 0 within `radius` of the z axis.
    Disc {
        radius: f64,
    },
    /// A sphere that is seen from inside only.
    Dome {
        radius: f64,
    },
}

/// The segment of a ray inside a convex solid: two distances, and the side crossed at each.
#[derive(Clone, Copy)]
pub(super) struct Span {
    pub enter: (f64, Side),
    pub exit: (f64, Side),
}

/// A side of a convex solid. The normal is computed for the nearest hit only.
#[derive(Clone, Copy)]
pub(super) enum Side {
    /// Its normal.
    Flat(DVec3),
    /// A sphere around zero of this radius.
    Ball(f64),
    /// A cylinder around the z axis of this radius.
    Tube(f64),
}

impl Span {
    fn first_hit(self, ray: &Ray) -> Option<Hit> {
        if self.enter.0 > self.exit.0 || self.exit.0 <= 0.0 {
            return None;
        }
        Some(hit_on(ray, if self.enter.0 > 0.0 { self.enter } else { self.exit }))
    }

    pub fn intersect(self, other: Span) -> Span {
        Span {
            enter: if self.enter.0 >= other.enter.0 { self.enter } else { other.enter },
            exit: if self.exit.0 <= other.exit.0 { self.exit } else { other.exit },
        }
    }
}

fn hit_on(ray: &Ray, (distance, side): (f64, Side)) -> Hit {
    let normal = match side {
        Side::Flat(normal) => normal,
        Side::Ball(radius) => ray.at(distance) / radius,
        Side::Tube(radius) => (ray.at(distance).truncate() / radius).extend(0.0),
    };
    Hit { distance, normal }
}

impl Shape {
    /// The nearest point of the surface ahead of the ray's origin. The ray is in the shape's frame. Hits beyond `limit`
    /// may be left out, where that saves work.
    pub fn hit(&self, ray: &Ray, limit: f64) -> Option<Hit> {
        match *self {
            Shape::Sphere { radius } => sphere(ray, radius)?.first_hit(ray),
            Shape::Cuboid { half } => {
                let slabs = [DVec3::X, DVec3::Y, DVec3::Z].map(|axis| slab(ray, axis, half.dot(axis)));
                let [x, y, z] = slabs;
                x?.intersect(y?).intersect(z?).first_hit(ray)
            }
            Shape::Cylinder { radius, half_height } => {
                tube(ray, radius)?.intersect(slab(ray, DVec3::Z, half_height)?).first_hit(ray)
            }
            Shape::Torus { major, minor } => torus::hit(ray, limit, major, minor),
            Shape::Disc { radius } => {
                let distance = -ray.origin.z / ray.direction.z;
                let within = distance > 0.0 && ray.at(distance).truncate().length_squared() <= radius * radius;
                within.then_some(Hit { distance, normal: DVec3::Z })
            }
            Shape::Dome { radius } => {
                let exit = hit_on(ray, sphere(ray, radius)?.exit);
                (exit.distance > 0.0).then_some(Hit { normal: -exit.normal, ..exit })
            }
        }
    }

    /// Signed distance to the surface, negative within the solid; below a disc's plane and beyond a dome it is negative too.
    pub fn distance(&self, point: DVec3) -> f64 {
        // Of a box in as many dimensions, from how far the point is beyond each of its sides.
        let boxed = |beyond: DVec3| beyond.max(DVec3::ZERO).length() + beyond.max_element().min(0.0);
        match *self {
            Shape::Sphere { radius } => point.length() - radius,
            Shape::Cuboid { half } => boxed(point.abs() - half),
            Shape::Cylinder { radius, half_height } => {
                let (across, along) = (point.truncate().length() - radius, point.z.abs() - half_height);
                boxed(DVec3::new(across, along, f64::NEG_INFINITY))
            }
            Shape::Torus { major, minor } => torus::distance_to(point, major, minor),
            Shape::Disc { radius } => {
                let beyond = (point.truncate().length() - radius).max(0.0);
                beyond.hypot(point.z) * point.z.signum()
            }
            Shape::Dome { radius } => radius - point.length(),
        }
    }

    /// Radius of a sphere around zero that holds the shape.
    pub fn bounding_radius(&self) -> f64 {
        match *self {
            Shape::Sphere { radius } | Shape::Disc { radius } | Shape::Dome { radius } => radius,
            Shape::Cuboid { half } => half.length(),
            Shape::Cylinder { radius, half_height } => radius.hypot(half_height),
            Shape::Torus { major, minor } => major + minor,
        }
    }
}

fn sphere(ray: &Ray, radius: f64) -> Option<Span> {
    let middle = -ray.origin.dot(ray.direction);
    // Uses the point nearest to the centre; |origin|² − radius² loses digits far away.
    let half_squared = radius * radius - ray.at(middle).length_squared();
    let half = (half_squared > 0.0).then(|| half_squared.sqrt())?;
    Some(Span { enter: (middle - half, Side::Ball(radius)), exit: (middle + half, Side::Ball(radius)) })
}

/// Between the planes at ±`half` along a unit axis.
pub(super) fn slab(ray: &Ray, axis: DVec3, half: f64) -> Option<Span> {
    let (position, speed) = (ray.origin.dot(axis), ray.direction.dot(axis));
    if speed == 0.0 {
        return (position.abs() <= half).then(|| endless(Side::Flat(axis)));
    }
    let away = axis * speed.signum();
    let distance_to = |plane: f64| (plane * speed.signum() - position) / speed;
    Some(Span { enter: (distance_to(-half), Side::Flat(-away)), exit: (distance_to(half), Side::Flat(away)) })
}

/// Inside the infinite cylinder around the z axis.
pub(super) fn tube(ray: &Ray, radius: f64) -> Option<Span> {
    let (origin, direction) = (ray.origin.truncate(), ray.direction.truncate());
    let speed_squared = direction.length_squared();
    if speed_squared == 0.0 {
        return (origin.length() <= radius).then(|| endless(Side::Tube(radius)));
    }
    let middle = -origin.dot(direction) / speed_squared;
    let half_squared = (radius * radius - (origin + middle * direction).length_squared()) / speed_squared;
    let half = (half_squared > 0.0).then(|| half_squared.sqrt())?;
    Some(Span { enter: (middle - half, Side::Tube(radius)), exit: (middle + half, Side::Tube(radius)) })
}

/// The interval of a ray parallel to a side: another side is met first.
fn endless(side: Side) -> Span {
    Span { enter: (f64::NEG_INFINITY, side), exit: (f64::INFINITY, side) }
}

/// The share of a thin cone around a ray that a solid blocks.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Occlusion {
    Nothing,
    Part,
    All,
}

impl Shape {
    /// The share of the cone around `ray` (the shape's frame) that the solid blocks. The cone's radius grows by `spread` per
    /// unit of distance. The answer is `Part` wherever a bounding test does not decide.
    pub fn cover(&self, ray: &Ray, spread: f64) -> Occlusion {
        match *self {
            Shape::Torus { major, minor } => torus::cover(ray, spread, major, minor),
            Shape::Cylinder { half_height, .. } if rises(ray, spread, half_height) => Occlusion::Nothing,
            Shape::Cuboid { half } if rises(ray, spread, half.z) => Occlusion::Nothing,
            _ => self.ball_cover(ray, spread),
        }
    }

    /// By the bounding sphere, which is the solid itself if that is a sphere.
    fn ball_cover(&self, ray: &Ray, spread: f64) -> Occlusion {
        let radius = self.bounding_radius();
        let along = -ray.origin.dot(ray.direction);
        let beside = ray.at(along).length();
        // Where the cone leaves the sphere it is a little wider than at the middle.
        let cone = spread * (along + radius).max(0.0);
        if along < -radius || beside > radius + cone {
            Occlusion::Nothing
        } else if matches!(self, Shape::Sphere { .. }) && along > radius && beside + cone < radius {
            Occlusion::All
        } else {
            Occlusion::Part
        }
    }
}

/// Whether the cone starts above the plane z = `height` and does not come down again.
fn rises(ray: &Ray, spread: f64, height: f64) -> bool {
    ray.origin.z >= height && ray.direction.z > spread
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    const SOLIDS: [Shape; 4] = [
        Shape::Sphere { radius: 0.7 },
        Shape::Cuboid { half: DVec3::new(0.5, 0.3, 0.4) },
        Shape::Cylinder { radius: 0.4, half_height: 0.6 },
        Shape::Torus { major: 0.6, minor: 0.2 },
    ];

    fn hit(shape: Shape, origin: [f64; 3], direction: [f64; 3]) -> Option<Hit> {
        shape.hit(&Ray { origin: DVec3::from(origin), direction: DVec3::from(direction).normalize() }, f64::INFINITY)
    }

    #[track_caller]
    fn assert_hit(shape: Shape, origin: [f64; 3], direction: [f64; 3], distance: f64, normal: [f64; 3]) {
        let found = hit(shape, origin, direction).expect("a hit");
        assert!((found.distance - distance).abs() <= 1e-12, "{found:?}");
        assert!((found.normal - DVec3::from(normal)).length() <= 1e-12, "{found:?}");
    }

    #[test]
    fn hits_have_their_analytic_values() {
        let [sphere, cuboid, cylinder, torus] = SOLIDS;
        assert_hit(sphere, [-3.0, 0.0, 0.0], [1.0, 0.0, 0.0], 2.3, [-1.0, 0.0, 0.0]);
        let (height, half) = (0.42, 0.56); // 0.42² + 0.56² = 0.7²
        assert_hit(sphere, [-3.0, height, 0.0], [1.0, 0.0, 0.0], 3.0 - half, [-0.8, 0.6, 0.0]);
        assert_hit(cuboid, [0.1, 0.2, 5.0], [0.0, 0.0, -1.0], 4.6, [0.0, 0.0, 1.0]);
        assert_hit(cuboid, [2.5, 2.3, 0.0], [-1.0, -1.0, 0.0], 2.0 * 2.0_f64.sqrt(), [1.0, 0.0, 0.0]);
        assert_hit(cylinder, [0.1, 0.0, 3.0], [0.0, 0.0, -1.0], 2.4, [0.0, 0.0, 1.0]);
        assert_hit(cylinder, [0.0, -2.0, 0.5], [0.0, 1.0, 0.0], 1.6, [0.0, -1.0, 0.0]);
        assert_hit(torus, [3.0, 0.0, 0.0], [-1.0, 0.0, 0.0], 2.2, [1.0, 0.0, 0.0]);
        assert_hit(torus, [0.0, 0.0, 0.0], [0.0, -1.0, 0.0], 0.4, [0.0, 1.0, 0.0]);
        assert_hit(torus, [0.6, 0.0, 2.0], [0.0, 0.0, -1.0], 1.8, [0.0, 0.0, 1.0]);
        assert!(hit(torus, [0.0, 0.0, 2.0], [0.0, 0.0, -1.0]).is_none(), "through the hole");
        assert_hit(Shape::Disc { radius: 1.0 }, [0.5, 0.0, 2.0], [0.0, 0.0, -1.0], 2.0, [0.0, 0.0, 1.0]);
        assert!(hit(Shape::Disc { radius: 1.0 }, [1.5, 0.0, 2.0], [0.0, 0.0, -1.0]).is_none());
        assert!(hit(Shape::Disc { radius: 1.0 }, [0.5, 0.0, 2.0], [1.0, 0.0, 0.0]).is_none());
        assert_hit(Shape::Dome { radius: 5.0 }, [1.0, 0.0, 0.0], [1.0, 0.0, 0.0], 4.0, [-1.0, 0.0, 0.0]);
    }

    #[test]
    fn nothing_behind_or_beside_is_hit() {
        for shape in SOLIDS {
            assert!(hit(shape, [3.0, 0.0, 0.0], [1.0, 0.0, 0.0]).is_none(), "{shape:?}");
            assert!(hit(shape, [-3.0, 2.0, 0.0], [1.0, 0.0, 0.0]).is_none(), "{shape:?}");
        }
    }

    /// At a hit the distance is zero, and outside it grows along the normal.
    #[test]
    fn distances_are_those_of_hits() {
        let open = [Shape::Disc { radius: 1.0 }, Shape::Dome { radius: 5.0 }];
        for shape in SOLIDS.into_iter().chain(open) {
            for (origin, direction) in [([0.45, 0.1, 2.0], [0.0, 0.05, -1.0]), ([2.0, 1.0, 1.5], [-1.0, -0.4, -0.8])] {
                let Some(Hit { distance, normal }) = hit(shape, origin, direction) else { continue };
                let at = DVec3::from(origin) + distance * DVec3::from(direction).normalize();
                for (step, expected) in [(0.0, 0.0), (0.01, 0.01), (-0.01, -0.01)] {
                    let found = shape.distance(at + step * normal);
                    assert!((found - expected).abs() <= 1e-9, "{shape:?} {step}: {found}");
                }
            }
        }
    }

    fn unit() -> impl Strategy<Value = DVec3> {
        [-1.0..1.0, -1.0..1.0, -1.0..1.0_f64]
            .prop_map(DVec3::from)
            .prop_filter("too short", |v| v.length() > 0.1)
            .prop_map(DVec3::normalize)
    }

    proptest! {
        /// The hit lies on the surface, its normal is a unit vector against the ray, and just outside of the surface.
        #[test]
        fn normals_are_unit_and_outward(from in unit(), jitter in unit()) {
            let origin = 4.0 * from;
            let ray = Ray { origin, direction: (0.5 * jitter - origin).normalize() };
            for shape in SOLIDS {
                let Some(Hit { distance, normal }) = shape.hit(&ray, f64::INFINITY) else { continue };
                prop_assert!((normal.length() - 1.0).abs() <= 1e-9, "{:?} {}", shape, normal);
                prop_assert!(normal.dot(ray.direction) <= 1e-6, "{:?}", shape);
                // From just above the surface the ray along the normal leaves, and the one against it returns at once.
                let outside = ray.at(distance) + 1e-3 * normal;
                let back = shape.hit(&Ray { origin: outside, direction: -normal }, f64::INFINITY).map(|hit| hit.distance);
                prop_assert!(back.is_some_and(|back| (back - 1e-3).abs() <= 1e-6), "{:?} {:?}", shape, back);
            }
        }

        #[test]
        fn bounding_spheres_hold_their_shapes(from in unit(), jitter in unit()) {
            let origin = 4.0 * from;
            let ray = Ray { origin, direction: (0.5 * jitter - origin).normalize() };
            for shape in SOLIDS {
                if let Some(hit) = shape.hit(&ray, f64::INFINITY) {
                    prop_assert!(ray.at(hit.distance).length() <= shape.bounding_radius() + 1e-9);
                }
            }
        }

        /// What the quick look at a cone says holds for the rays in it.
        #[test]
        fn cover_agrees_with_rays(from in unit(), jitter in unit(), near in 0.0..1.0) {
            const SPREAD: f64 = 0.05;
            for shape in SOLIDS {
                let origin: DVec3 = (shape.bounding_radius() * near + 0.9) * from;
                let direction = (1.2 * shape.bounding_radius() * jitter - origin).normalize();
                let (side, up) = direction.any_orthonormal_pair();
                let hits = (0..40).filter(|&i| {
                    let i = f64::from(i);
                    let (sin, cos) = (2.4 * i).sin_cos();
                    let bent = direction + SPREAD * (i / 40.0).sqrt() * (cos * side + sin * up);
                    shape.hit(&Ray { origin, direction: bent.normalize() }, f64::INFINITY).is_some()
                });
                match (shape.cover(&Ray { origin, direction }, SPREAD), hits.count()) {
                    (Occlusion::Nothing, hits) => prop_assert_eq!(hits, 0, "{:?}", shape),
                    (Occlusion::All, hits) => prop_assert_eq!(hits, 40, "{:?}", shape),
                    (Occlusion::Part, _) => {}
                }
            }
        }
    }
}

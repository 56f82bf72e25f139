//! The still life: its objects, and their intersections with rays. World frame: z up, the platform's top at z = 0.

use glam::{DAffine3, DQuat, DVec3};

use super::DemoOptions;
use super::geometry::{Occlusion, Ray, Shape};
use super::texture::{self, Texture, srgb};

/// One object of the scene.
#[derive(Clone, Debug)]
pub(super) struct SceneObject {
    pub shape: Shape,
    pub texture: Texture,
    pub kind: ObjectKind,
    pub centre_world: DVec3,
    pub bounding_radius: f64,
    /// The rigid transform into the shape's frame.
    local_from_world: DAffine3,
    world_from_local: DAffine3,
}

/// How an object takes part in shading.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum ObjectKind {
    /// Lit, and casts shadows.
    Matte,
    /// As matte, with a mirror reflection added.
    Glossy,
    /// As matte, with a soft highlight added.
    Lacquered,
    /// Lit, too low to cast a shadow.
    Ground,
    /// Emits light.
    Sky,
}

impl SceneObject {
    fn new(shape: Shape, texture: Texture, centre_world: [f64; 3], rotation: DQuat) -> Self {
        let centre_world = DVec3::from(centre_world);
        let world_from_local = DAffine3::from_rotation_translation(rotation, centre_world);
        Self {
            shape,
            texture,
            kind: ObjectKind::Matte,
            centre_world,
            bounding_radius: shape.bounding_radius(),
            local_from_world: world_from_local.inverse(),
            world_from_local,
        }
    }

    fn of_kind(self, kind: ObjectKind) -> Self {
        Self { kind, ..self }
    }

    /// Moves the object by a vector of the world frame.
    fn move_by(&mut self, by_world: DVec3) {
        self.centre_world += by_world;
        self.world_from_local.translation += by_world;
        self.local_from_world = self.world_from_local.inverse();
    }

    /// Distance to the surface, if the ray (world frame) meets it before `limit`, and the normal in the world frame.
    pub fn hit(&self, ray: &Ray, limit: f64) -> Option<(f64, DVec3)> {
        let hit = self.shape.hit(&self.local(ray), limit).filter(|hit| hit.distance < limit)?;
        Some((hit.distance, self.world_from_local.transform_vector3(hit.normal)))
    }

    /// Signed distance to the surface from a point of the world frame; see [`Shape::distance`].
    pub fn distance(&self, point_world: DVec3) -> f64 {
        self.shape.distance(self.local_from_world.transform_point3(point_world))
    }

    /// The share of a cone around a ray of the world frame that the object blocks; see [`Shape::cover`].
    pub fn cover(&self, ray: &Ray, spread: f64) -> Occlusion {
        self.shape.cover(&self.local(ray), spread)
    }

    fn local(&self, ray: &Ray) -> Ray {
        Ray {
            origin: self.local_from_world.transform_point3(ray.origin),
            direction: self.local_from_world.transform_vector3(ray.direction),
        }
    }

    /// Whether the ray passes through the bounding sphere before `limit`: a cheap test that most rays fail.
    pub fn may_be_hit(&self, ray: &Ray, limit: f64) -> bool {
        let towards = self.centre_world - ray.origin;
        let along = towards.dot(ray.direction);
        let radius = self.bounding_radius;
        along - radius < limit && towards.length_squared() - along * along <= radius * radius && along > -radius
    }

    /// Whether a cone around the ray, `spread` wider per unit of distance, comes near the bounding sphere.
    pub fn may_be_near(&self, ray: &Ray, spread: f64) -> bool {
        let towards = self.centre_world - ray.origin;
        let along = towards.dot(ray.direction);
        let reach = self.bounding_radius + spread * (along + self.bounding_radius);
        along > -self.bounding_radius && towards.length_squared() - along * along <= reach * reach
    }

    pub fn casts_shadow(&self) -> bool {
        matches!(self.kind, ObjectKind::Matte | ObjectKind::Glossy | ObjectKind::Lacquered)
    }

    /// The texture's colour at a point of the surface.
    pub fn colour(&self, position_world: DVec3, normal_world: DVec3) -> DVec3 {
        let position = self.local_from_world.transform_point3(position_world);
        self.texture.colour(position, self.local_from_world.transform_vector3(normal_world))
    }
}

/// A point on a surface that a ray met.
#[derive(Clone, Copy, Debug)]
pub(super) struct SurfacePoint {
    pub object: usize,
    pub distance: f64,
    pub position_world: DVec3,
    pub normal_world: DVec3,
}

/// All objects.
#[derive(Clone, Debug)]
pub(super) struct DemoScene {
    pub objects: Vec<SceneObject>,
}

impl DemoScene {
    /// The nearest surface ahead. Within the dome every ray meets one.
    pub fn hit(&self, ray: &Ray) -> Option<SurfacePoint> {
        let mut nearest: Option<SurfacePoint> = None;
        for (i, object) in self.objects.iter().enumerate() {
            let limit = nearest.map_or(f64::INFINITY, |point| point.distance);
            // The sky is behind everything.
            let hidden = object.kind == ObjectKind::Sky && nearest.is_some();
            if hidden || !object.may_be_hit(ray, limit) {
                continue;
            }
            if let Some((distance, normal_world)) = object.hit(ray, limit) {
                nearest = Some(SurfacePoint { object: i, distance, position_world: ray.at(distance), normal_world });
            }
        }
        nearest
    }

    /// Moves the planet in the middle of the still life.
    pub fn move_planet(&mut self, by_world: DVec3) {
        let planets = self.objects.iter_mut().filter(|object| matches!(object.texture, Texture::Planet));
        planets.for_each(|planet| planet.move_by(by_world));
    }

    /// Whether a point lies on the ground or the sky.
    pub fn is_surroundings(&self, point: &SurfacePoint) -> bool {
        matches!(self.objects[point.object].kind, ObjectKind::Ground | ObjectKind::Sky)
    }

    /// Whether a point lies on clear sky, which has no features to match.
    pub fn is_clear_sky(&self, point: &SurfacePoint, options: &DemoOptions) -> bool {
        let is_sky = matches!(self.objects[point.object].kind, ObjectKind::Sky);
        options.far && is_sky && point.position_world.normalize_or_zero().z > texture::VISTA_CREST
    }

    /// The still life. With `glossy`, one sphere reflects its surroundings, and the other objects and the platform are lacquered.
    pub fn still_life(options: &DemoOptions) -> Self {
        // Platform and ground come first: they end most rays, which shortens the search. The sky comes last.
        let [platform, ground, sky] = surroundings(options);
        let mut objects = vec![platform, ground];
        objects.extend(things());
        if options.glossy {
            objects
                .iter_mut()
                .filter(|object| object.kind == ObjectKind::Matte)
                .for_each(|object| object.kind = ObjectKind::Lacquered);
        }
        let mirror = SceneObject::new(
            Shape::Sphere { radius: 0.42 },
            Texture::Marble { scale: 3.0, colours: [srgb(0x6b2c4e), srgb(0xc98aa2)] },
            [-0.72, 1.12, 0.42],
            about_z(40.0),
        );
        objects.push(mirror.of_kind(if options.glossy { ObjectKind::Glossy } else { ObjectKind::Matte }));
        objects.push(sky);
        Self { objects }
    }
}

fn about_z(angle_deg: f64) -> DQuat {
    DQuat::from_rotation_z(angle_deg.to_radians())
}

/// What lies on the platform but for the mirror: large things, then small ones.
fn things() -> Vec<SceneObject> {
    let sphere = |radius| Shape::Sphere { radius };
    let cuboid = |x, y, z| Shape::Cuboid { half: DVec3::new(x, y, z) };
    let torus = |major, minor| Shape::Torus { major, minor };
    let checks = |side, colours: [u32; 2]| Texture::Checks { side, colours: colours.map(srgb) };
    let dots = |colours: [u32; 2]| Texture::Dots { colours: colours.map(srgb) };
    let post = Shape::Cylinder { radius: 0.2, half_height: 0.55 };
    let helix = Texture::Helix { stripes: 2.0, turns_per_unit: 1.6, colours: [0x2c7d5b, 0xf3e6cf].map(srgb) };
    let twist = Texture::Twist { major: 0.36, stripes: 6.0, colours: [0x148a94, 0xe9f0dd].map(srgb) };
    let upright = about_z(-14.0) * DQuat::from_rotation_x(90_f64.to_radians());
    let marble = |radius: f64, colours: [u32; 2], x: f64, y: f64| {
        let texture = Texture::Marble { scale: 0.9 / radius, colours: colours.map(srgb) };
        (sphere(radius), texture, [x, y, radius], about_z(200.0 * x + 90.0 * y))
    };
    let things = [
        (sphere(0.56), Texture::Planet, [0.1, 0.28, 0.56], about_z(70.0)),
        (torus(1.3, 0.13), Texture::Rainbow { segments: 24.0 }, [0.1, 0.28, 0.0], upright),
        (cuboid(0.34, 0.34, 0.3), checks(0.17, [0xc23b32, 0xf3e6cf]), [-0.85, -0.78, 0.3], about_z(28.0)),
        (post, helix, [0.98, -0.72, 0.55], DQuat::IDENTITY),
        (sphere(0.36), dots([0xe8792b, 0xfdf1dc]), [0.86, 1.18, 0.36], DQuat::from_rotation_y(0.5)),
        (sphere(0.23), dots([0xf2c231, 0x2a3d77]), [-0.88, -0.8, 0.83], DQuat::from_rotation_x(0.7)),
        (torus(0.36, 0.13), twist, [0.12, -1.2, 0.13], DQuat::IDENTITY),
        (cuboid(0.3, 0.2, 0.09), checks(0.12, [0x2f4f9e, 0xa9c3ea]), [-1.52, 0.3, 0.09], about_z(-65.0)),
        marble(0.19, [0xb83a8c, 0xf0c4dd], 0.12, -1.2),
        marble(0.15, [0x4d9b3c, 0xd6edb6], -0.2, -0.55),
        marble(0.13, [0xd94f2a, 0xf7d08a], 0.55, -0.3),
        marble(0.14, [0x3a49a8, 0xc4d4f4], 1.55, 0.4),
        marble(0.12, [0xd8a520, 0xfff0c0], 0.1, 1.5),
        marble(0.12, [0x2a9aa8, 0xd9f4f0], -1.3, -0.2),
    ];
    things.map(|(shape, texture, centre, rotation)| SceneObject::new(shape, texture, centre, rotation)).into()
}

/// Radius of the ground and of the sky on its edge, scene units.
const GROUND_RADIUS: f64 = 8.0;

/// Factor on that radius where cameras stand [`DemoOptions::ZOOM_FAR`] times as far away.
const ZOOM_GROUND: f64 = 5.0;

/// Platform, ground and sky.
fn surroundings(options: &DemoOptions) -> [SceneObject; 3] {
    let platform = Shape::Cylinder { radius: 1.95, half_height: 0.18 };
    let radius = if options.zoom { ZOOM_GROUND * GROUND_RADIUS } else { GROUND_RADIUS };
    let (dome, air) = if options.far { (DemoOptions::FAR_RADIUS, Texture::Vista) } else { (radius, Texture::Sky) };
    let ground = SceneObject::new(Shape::Disc { radius }, Texture::Garden, [0.0, 0.0, -0.36], DQuat::IDENTITY);
    let sky = SceneObject::new(Shape::Dome { radius: dome }, air, [0.0, 0.0, -0.36], DQuat::IDENTITY);
    [
        SceneObject::new(platform, Texture::Wood, [0.0, 0.0, -0.18], DQuat::IDENTITY),
        ground.of_kind(ObjectKind::Ground),
        sky.of_kind(ObjectKind::Sky),
    ]
}

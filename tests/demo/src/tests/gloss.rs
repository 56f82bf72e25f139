//! Tests of the light with `glossy`.

use glam::DVec3;

use super::*;

#[test]
fn gloss_shows_only_on_glossy_objects() {
    let (matte, glossy) = (lit(false), lit(true));
    let (mut mirrored, mut lacquered) = (0, 0);
    for camera in cameras(&SMALL) {
        for ray in grid(&camera) {
            let point = glossy.scene.hit(&ray).unwrap();
            let difference = (display(matte.along(&ray)) - display(glossy.along(&ray))).length();
            match glossy.scene.objects[point.object].kind {
                ObjectKind::Glossy => mirrored += usize::from(difference > 0.02),
                ObjectKind::Lacquered => lacquered += usize::from(difference > 0.02),
                ObjectKind::Matte | ObjectKind::Ground | ObjectKind::Sky => assert_eq!(difference, 0.0, "{point:?}"),
            }
        }
    }
    assert!(mirrored > 50 && lacquered > 500, "they show in only {mirrored} and {lacquered} pixels");
    let kinds =
        |scene: &LitScene, kind: ObjectKind| scene.scene.objects.iter().filter(|object| object.kind == kind).count();
    assert_eq!((kinds(&matte, ObjectKind::Glossy), kinds(&matte, ObjectKind::Lacquered)), (0, 0));
    assert_eq!((kinds(&glossy, ObjectKind::Glossy), kinds(&glossy, ObjectKind::Matte)), (1, 0));
}

#[test]
fn gloss_depends_on_the_view() {
    let scene = lit(true);
    let cameras = cameras(&SMALL);
    let mut largest: f64 = 0.0;
    for ray in grid(&cameras[2]) {
        let point = scene.scene.hit(&ray).unwrap();
        for other in &cameras {
            if scene.scene.objects[point.object].kind != ObjectKind::Glossy {
                continue;
            }
            if let Some(at_px) = observation(&scene, &Shot::plain(*other), point.position_world) {
                let there = display(scene.along(&other.ray_through(at_px)));
                largest = largest.max((display(scene.along(&ray)) - there).length());
            }
        }
    }
    assert!(largest > 0.1, "{largest}");
}

/// Checks the law of reflection and Schlick's approximation, with the matte colour of the surface that the mirrored ray meets.
#[test]
fn a_mirror_shows_what_lies_in_the_mirrored_direction() {
    let scene = lit(true);
    let mut compared = 0;
    for ray in grid(&cameras(&SMALL)[2]) {
        let point = scene.scene.hit(&ray).unwrap();
        let normal = point.normal_world;
        if scene.scene.objects[point.object].kind != ObjectKind::Glossy {
            continue;
        }
        let mirrored = Ray { origin: point.position_world + 1e-4 * normal, direction: ray.direction.reflect(normal) };
        let seen = scene.matte(&scene.scene.hit(&mirrored).unwrap());
        let share = 0.3 + 0.7 * (1.0 + ray.direction.dot(normal)).powi(5);
        let expected = (1.0 - share) * scene.matte(&point) + share * seen;
        // The mirror image of the sun is small and white.
        let more = scene.along(&ray) - expected;
        assert!((more - DVec3::splat(more.x)).length() < 1e-9 && more.x > -1e-9, "{more}");
        compared += usize::from(more.x < 1e-6);
    }
    assert!(compared > 5, "{compared}");
}

/// Lacquer has a white highlight, whose position depends on the viewpoint.
#[test]
fn lacquer_shines_towards_the_mirrored_sun() {
    let (matte, glossy) = (lit(false), lit(true));
    let cameras = cameras(&SMALL);
    let mut largest: f64 = 0.0;
    for ray in grid(&cameras[2]) {
        let point = glossy.scene.hit(&ray).unwrap();
        if glossy.scene.objects[point.object].kind != ObjectKind::Lacquered {
            continue;
        }
        let sheen = |ray: &Ray| glossy.along(ray) - matte.along(ray);
        let here = sheen(&ray);
        assert!((here - DVec3::splat(here.x)).length() < 1e-9 && (-1e-9..0.61).contains(&here.x), "{here}");
        for other in &cameras {
            if let Some(at_px) = observation(&glossy, &Shot::plain(*other), point.position_world) {
                largest = largest.max((here - sheen(&other.ray_through(at_px))).x);
            }
        }
    }
    assert!(largest > 0.2, "{largest}");
}

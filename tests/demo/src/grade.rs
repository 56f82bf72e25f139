//! Local processing of a photograph, as phones do it.

use std::f64::consts::{SQRT_2, TAU};

use glam::{DVec2, DVec3};
use rand::{Rng, RngExt};

use super::DemoOptions;
use super::camera::DemoCamera;
use super::light::display;

/// A filter whose strength rises across the picture, and a tone curve that does so in a direction of its own.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Grade {
    /// Stops of light, per channel, gained in the brightest corner; the opposite corner loses as much.
    stops: DVec3,
    /// Direction to that corner in units of half the picture's diagonal, so that it is at most 1 from the middle to a corner.
    brighter: DVec2,
    /// Direction in which the tone curve darkens, in the same units. Stored values are raised to a power, which moves dark values most.
    deeper: DVec2,
}

impl Grade {
    pub fn random(random: &mut impl Rng) -> Self {
        let mut direction = || DVec2::from_angle(TAU * random.random::<f64>()) / SQRT_2;
        let [brighter, deeper] = [direction(), direction()];
        let mut stops = || DemoOptions::GRADE_STOPS * (0.5 + random.random::<f64>());
        Self { stops: DVec3::new(stops(), stops(), stops()), brighter, deeper }
    }

    /// Display-referred RGB, 0 to 1, of linear light at a position of the camera's picture, px.
    pub fn display(&self, light: DVec3, camera: &DemoCamera, at_px: DVec2) -> DVec3 {
        let size_px = DVec2::new(camera.intrinsics.width as f64, camera.intrinsics.height as f64);
        let place = 2.0 * at_px / size_px - 1.0;
        let gain = (self.stops * place.dot(self.brighter) * std::f64::consts::LN_2).exp();
        let power = (DemoOptions::GRADE_TONE * place.dot(self.deeper)).exp2();
        display(gain * light).powf(power)
    }
}

#[cfg(test)]
mod tests {
    use super::super::camera::cameras;
    use super::super::light::LitScene;
    use super::super::picture::render;
    use super::super::scene::DemoScene;
    use super::super::shot::{Shot, shots};
    use super::*;

    const SMALL: DemoOptions = DemoOptions { width: 64, height: 48, views: 18, points: 0, ..DemoOptions::PLAIN };

    #[test]
    fn light_changes_one_way_and_the_tone_another() {
        let camera = cameras(&SMALL)[0];
        let brighter = DVec2::X / SQRT_2;
        let grade = Grade { stops: DVec3::new(1.0, 2.0, 0.5), brighter, deeper: DVec2::Y / SQRT_2 };
        let light = DVec3::new(0.3, 0.02, 0.9);
        let at = |x: f64, y: f64| grade.display(light, &camera, DVec2::new(x, y));
        assert!((at(32.0, 24.0) - display(light)).length() < 1e-12, "in the middle nothing changes");
        let gain = DVec3::new((1.0 / SQRT_2).exp2(), SQRT_2.exp2(), (0.5 / SQRT_2).exp2());
        assert!((at(64.0, 24.0) - display(gain * light)).length() < 1e-12);
        assert!((at(0.0, 24.0) - display(light / gain)).length() < 1e-12);
        let power = (DemoOptions::GRADE_TONE / SQRT_2).exp2();
        assert!((at(32.0, 48.0) - display(light).powf(power)).length() < 1e-12);
        assert!((at(32.0, 0.0) - display(light).powf(1.0 / power)).length() < 1e-12);
    }

    #[test]
    fn photographs_to_train_on_are_graded_each_in_its_own_way() {
        let options = DemoOptions { graded: true, ..SMALL };
        let scene = LitScene::new(DemoScene::still_life(&options));
        let mut grades = Vec::new();
        for (view, shot) in shots(&options).iter().enumerate() {
            let Some(grade) = shot.grade else {
                assert!(DemoOptions::held_out(view));
                continue;
            };
            assert!(!DemoOptions::held_out(view) && !grades.contains(&grade));
            let stops = grade.stops / DemoOptions::GRADE_STOPS;
            assert!(stops.min_element() >= 0.5 && stops.max_element() <= 1.5, "{stops}");
            grades.push(grade);
        }
        assert_eq!(grades.len(), 15);
        // A photograph is what the plain one would be, graded.
        let shot = &shots(&options)[1];
        let [graded, plain] = [shot, &Shot::plain(shot.camera)].map(|shot| render(&scene, shot).into_rgb8());
        let mut changed = 0;
        for (x, y, pixel) in plain.enumerate_pixels() {
            let at_px = DVec2::new(f64::from(x), f64::from(y)) + 0.5;
            // The inverse of `display`.
            let light = pixel.0.map(|level| -(1.0 - (f64::from(level) / 255.0).min(0.999).powf(2.2)).ln() / 0.85);
            let expected = 255.0 * shot.display(DVec3::from(light), at_px);
            let found = graded.get_pixel(x, y).0.map(f64::from);
            assert!((expected - DVec3::from(found)).abs().max_element() < 3.0, "{expected} {found:?}");
            changed += usize::from((0..3).any(|i| pixel.0[i].abs_diff(graded.get_pixel(x, y).0[i]) > 10));
        }
        assert!(changed > 1000, "{changed} of {}", 64 * 48);
    }
}

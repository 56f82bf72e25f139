//! The scene origin, which keeps geo-referenced and other distant captures within the precision of f32.

use glam::{DAffine3, DVec3};

use super::spread::Spread;

/// Beyond this many times the capture's extent from zero, f32 positions are rounded to more than 6e-6 of the extent.
const FAR: f64 = 100.0;

/// The offset to subtract from every position: zero, or the mean camera centre rounded to whole units if that is far from zero.
/// [Strays](Spread) do not count.
///
/// "Far" is relative to the largest distance of a camera from the mean, which counts as at least one unit: a single
/// camera, or several at one place, do not show the scene's extent, and an unnecessary shift costs nothing. Whole units
/// have few digits, so that the origin survives printing.
pub(crate) fn choose(cam_from_world: &[DAffine3]) -> DVec3 {
    let centres: Vec<DVec3> = cam_from_world.iter().map(centre_world).collect();
    let far = |spread: &Spread| spread.middle.length() > FAR * spread.radius.max(1.0);
    Spread::of(&centres).filter(far).map_or(DVec3::ZERO, |spread| spread.middle.round())
}

/// The pose in a world whose zero is at `origin`: `R (x + origin) + t = R x + (t + R origin)`.
pub(crate) fn moved(cam_from_world: &DAffine3, origin: DVec3) -> DAffine3 {
    DAffine3 {
        matrix3: cam_from_world.matrix3,
        translation: cam_from_world.translation + cam_from_world.matrix3 * origin,
    }
}

pub(super) fn centre_world(cam_from_world: &DAffine3) -> DVec3 {
    -(cam_from_world.matrix3.transpose() * cam_from_world.translation)
}

#[cfg(test)]
mod tests;

//! Per-ray rasterization: hard scenes of other groups under the ray-max projection and the per-pixel sort, and
//! scenes that are hard for these two only.
//!
//! The papers' formulas in 106 bits cover neither. The reference is the twin in f64, which is compared with the exact renderer
//! wherever that renderer has digits left.

use glam::DVec2;
use splat_op::{CameraModel, Intrinsics, Order, Projection, RenderOptions};

use super::{near, needles, sizes};
use crate::case::{CaseKind, HardCase};
use crate::random::Random;
use crate::scene::{HardScene, SMOOTH, Splat, TruthSource};

/// Cases of other groups that also run with the ray-max projection.
const PROJECTED: [&str; 17] = [
    "long needle 1e2 in the image plane",
    "long needle 1e2 out of the plane",
    "long needle 1e4 in the image plane",
    "long needle 1e4 out of the plane",
    "thin needle 1e4 in the image plane",
    "thin disc 1e4 out of the plane",
    "far below a pixel",
    "larger than the screen",
    "larger than the scene",
    "log-scale −50",
    "log-scale +50",
    "centre at the near plane ± 1 ulp",
    "crosses the camera plane",
    "camera inside a splat",
    "centre on the optical axis",
    "grazing the border of the view",
    "behind the camera",
];

/// Cases of other groups that also run with the per-pixel sort.
const SORTED: [&str; 9] = [
    "long needle 1e2 out of the plane",
    "long needle 1e4 out of the plane",
    "thin disc 1e4 out of the plane",
    "larger than the screen",
    "larger than the scene",
    "crosses the camera plane",
    "camera inside a splat",
    "grazing the border of the view",
    "behind the camera",
];

pub fn cases() -> Vec<HardCase> {
    let exact = SMOOTH.with_projection(Projection::RayMax);
    let sorted = SMOOTH.with_order(Order::PerPixelSort);
    let both = exact.with_order(Order::PerPixelSort);
    let others = || [needles::cases(), sizes::cases(), near::cases()].into_iter().flatten();
    let again = |names: &'static [&str], what: &str, options: RenderOptions| -> Vec<HardCase> {
        let chosen = others().filter(|case| names.contains(&case.name.as_str()));
        chosen.map(|case| along_rays(case, what, options)).collect()
    };
    let mut cases: Vec<HardCase> = again(&PROJECTED, "ray-max projection", exact);
    cases.extend(again(&SORTED, "per-pixel sort", sorted));
    for (what, options) in [("per-pixel sort", sorted), ("ray-max projection and per-pixel sort", both)] {
        let seen = |scene: HardScene| vec![scene.with_options(options).with_truth(TruthSource::Twin)];
        cases.push(
            HardCase::scenes(
                format!("sheets that cross, {what}"),
                "the order of the sheets changes along a line, where pictures jump and gradients do not exist",
                seen(crossing()),
            )
            .hardness("3 sheets"),
        );
        cases.push(
            HardCase::scenes(
                format!("24 leaning layers in every pixel, {what}"),
                "every pixel has its own order, and there are more layers than a kernel's unit sorts at once",
                seen(leaning()),
            )
            .hardness("24 layers"),
        );
    }
    for (what, options) in [("ray-max projection", exact), ("per-pixel sort", sorted)] {
        let seen = |scene: HardScene| vec![scene.with_options(options).with_truth(TruthSource::Twin)];
        cases.push(
            HardCase::scenes(
                format!("lens that turns back near the border, {what}"),
                "a lens shrinks the picture more and more up to the rim of its domain, and pixels beyond the rim have no ray",
                seen(turning_back()),
            )
            .hardness("1/4 of the magnification"),
        );
        cases.push(
            HardCase::scenes(
                format!("fisheye up to 90° and beyond, {what}"),
                "the slopes of rays reach hundreds, and pixels beyond 90° have no ray",
                seen(fisheye()),
            )
            .hardness("slope 105"),
        );
    }
    cases
}

/// Splats at positions of the picture of a lens.
fn through(lens: Intrinsics, label: &str, at: &[([f64; 2], f64, f64)]) -> HardScene {
    let splat = |&(px, depth, sigma): &([f64; 2], f64, f64)| {
        let ray = lens.cam_from_px(DVec2::from(px));
        let mean = depth * ray / ray.length();
        let splat = Splat::seen_by(&lens, px, depth, sigma);
        let [a, b, c] = splat.scale;
        splat.mean(mean.to_array()).scale([a, 0.3 * b, c])
    };
    HardScene::new(label, &at.iter().map(splat).collect::<Vec<_>>()).with_camera(lens)
}

/// The radius of the lens's domain, `1/√(3·0.4)`, lies 36.5 px from the middle of a picture whose corners are 37.6 px from it.
fn turning_back() -> HardScene {
    let mut lens = Intrinsics { model: CameraModel::OpenCv, ..Intrinsics::centred(60, 45, 60.0) };
    lens.distortion[0] = -0.4;
    through(
        lens,
        "k1 −0.4",
        &[([31.0, 20.5], 3.0, 3.0), ([55.0, 37.7], 4.1, 2.0), ([58.9, 43.2], 5.6, 1.5), ([3.2, 6.1], 7.0, 2.5)],
    )
}

/// 19 px per radian: 90° are 29.8 px from the middle.
fn fisheye() -> HardScene {
    let lens = Intrinsics { model: CameraModel::Fisheye, ..Intrinsics::centred(60, 45, 19.0) };
    through(
        lens,
        "19 px per radian",
        &[([31.0, 20.5], 3.0, 3.0), ([50.4, 12.3], 4.1, 1.0), ([57.9, 24.6], 5.6, 0.8), ([58.7, 30.0], 6.9, 0.5)],
    )
}

/// Runs a case of another group with other options.
fn along_rays(case: HardCase, what: &str, options: RenderOptions) -> HardCase {
    let CaseKind::Scenes(scenes) = case.kind else { return case };
    let scene = |scene: HardScene| scene.with_options(options).with_truth(TruthSource::Twin);
    let scenes = scenes.into_iter().map(scene).collect();
    HardCase { name: format!("{}, {what}", case.name), kind: CaseKind::Scenes(scenes), ..case }
}

/// Discs that intersect each other.
fn crossing() -> HardScene {
    let sheet = |i: usize, quat: [f64; 4]| {
        let colour = std::array::from_fn::<f64, 3, _>(|channel| if channel == i { 0.9 } else { 0.1 });
        let splat = Splat::at([29.0 + i as f64, 22.3], 3.0, 9.0).quat(quat).opacity(0.8);
        let [x, y, _] = splat.scale;
        splat.scale([x, y, 0.02]).colour(&colour)
    };
    let (cos, sin) = (0.9, 0.43);
    HardScene::new(
        "turned",
        &[sheet(0, [cos, 0.0, sin, 0.02]), sheet(1, [cos, 0.03, -sin, 0.0]), sheet(2, [cos, sin, 0.05, 0.01])],
    )
}

/// Wide, flat and randomly rotated layers, so that each pixel has its own order. Pixels and layers are few, so that no two layers
/// change places within rounding error, where the picture would jump.
fn leaning() -> HardScene {
    let lens = Intrinsics { cx: 8.2, cy: 5.9, ..Intrinsics::centred(16, 12, 20.0) };
    let mut random = Random::new(12);
    let splats: Vec<Splat> = (0..24)
        .map(|_| {
            let px = [random.between(0.0, 16.0), random.between(0.0, 12.0)];
            let splat = Splat::seen_by(&lens, px, random.between(2.0, 6.0), random.between(5.0, 12.0));
            let [x, y, z] = splat.scale;
            let quat = [1.0, random.between(-0.4, 0.4), random.between(-0.4, 0.4), random.between(-1.0, 1.0)];
            let colour = random.fill(3, 0.0, 1.0);
            splat.scale([x, y, 0.05 * z]).quat(quat).opacity(random.between(0.05, 0.3)).colour(&colour)
        })
        .collect();
    HardScene::new("16 × 12 px", &splats).with_camera(lens)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_case_that_is_named_is_there() {
        assert_eq!(cases().len(), PROJECTED.len() + SORTED.len() + 8);
    }
}

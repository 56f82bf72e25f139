//! The ray-max projection: hard scenes of other groups under it, and scenes that are hard for it only.
//!
//! The papers' formulas in 106 bits do not cover it. The reference is the twin in f64, which is compared with the exact renderer
//! wherever that renderer has digits left.

use glam::DVec2;
use splat_op::{CameraModel, Intrinsics, Projection, RenderOptions};

use super::{near, needles, sizes};
use crate::case::{CaseKind, HardCase};
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

pub fn cases() -> Vec<HardCase> {
    let options = SMOOTH.with_projection(Projection::RayMax);
    let others = [needles::cases(), sizes::cases(), near::cases()].into_iter().flatten();
    let chosen = others.filter(|case| PROJECTED.contains(&case.name.as_str()));
    let mut cases: Vec<HardCase> = chosen.map(|case| along_rays(case, options)).collect();
    let seen = |scene: HardScene| vec![scene.with_options(options).with_truth(TruthSource::Twin)];
    cases.push(
        HardCase::scenes(
            "lens that turns back near the border, ray-max projection",
            "a lens shrinks the picture more and more up to the rim of its domain, and pixels beyond the rim have no ray",
            seen(turning_back()),
        )
        .hardness("1/4 of the magnification"),
    );
    cases.push(
        HardCase::scenes(
            "fisheye up to 90° and beyond, ray-max projection",
            "the slopes of rays reach hundreds, and pixels beyond 90° have no ray",
            seen(fisheye()),
        )
        .hardness("slope 105"),
    );
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
    let mut lens = Intrinsics::centred(60, 45, 60.0).with_lens(CameraModel::OpenCv, [0.0; 8]);
    lens.distortion[0] = -0.4;
    through(
        lens,
        "k1 −0.4",
        &[([31.0, 20.5], 3.0, 3.0), ([55.0, 37.7], 4.1, 2.0), ([58.9, 43.2], 5.6, 1.5), ([3.2, 6.1], 7.0, 2.5)],
    )
}

/// 19 px per radian: 90° are 29.8 px from the middle.
fn fisheye() -> HardScene {
    let lens = Intrinsics::centred(60, 45, 19.0).with_lens(CameraModel::Fisheye, [0.0; 8]);
    through(
        lens,
        "19 px per radian",
        &[([31.0, 20.5], 3.0, 3.0), ([50.4, 12.3], 4.1, 1.0), ([57.9, 24.6], 5.6, 0.8), ([58.7, 30.0], 6.9, 0.5)],
    )
}

/// Runs a case of another group with the ray-max projection.
fn along_rays(case: HardCase, options: RenderOptions) -> HardCase {
    let CaseKind::Scenes(scenes) = case.kind else { return case };
    let scene = |scene: HardScene| scene.with_options(options).with_truth(TruthSource::Twin);
    let scenes = scenes.into_iter().map(scene).collect();
    HardCase { name: format!("{}, ray-max projection", case.name), kind: CaseKind::Scenes(scenes), ..case }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_case_that_is_named_is_there() {
        assert_eq!(cases().len(), PROJECTED.len() + 2);
    }
}

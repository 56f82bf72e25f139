//! Identification of the scene that a frontier was measured on, so that it is not used for another scene.

use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};
use splat_op::{Intrinsics, RenderOptions};

use super::dials::Judge;
use super::setting::Setting;
use crate::capture::Capture;
use crate::gaussians::GaussianRows;

/// A capture, a scene of that capture and the model choices of its renders. The device and the size of frames are stored beside
/// it.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Provenance {
    /// Digest of the capture, from [`Self::of_capture`].
    pub capture: String,
    /// Digest of the scene, from [`Self::of_scene`].
    pub scene: String,
    /// Model choices, from [`Self::choices`].
    pub choices: Setting,
}

impl Provenance {
    /// Identifies a scene of a capture, rendered with `options`.
    pub fn new(capture: &Capture, scene: &GaussianRows, options: &RenderOptions) -> Self {
        Self { capture: Self::of_capture(capture), scene: Self::of_scene(scene), choices: Self::choices(options) }
    }

    /// Digest of the names of the capture's photographs and of their cameras. The folder has no influence, because it may be
    /// moved.
    pub fn of_capture(capture: &Capture) -> String {
        let mut digest = Sha256::new();
        for view in &capture.views {
            // The length separates the name from the bytes after it.
            digest.update((view.name.len() as u64).to_le_bytes());
            digest.update(&view.name);
            let Intrinsics { width, height, fx, fy, cx, cy, distortion, .. } = view.intrinsics;
            [width, height].iter().for_each(|side| digest.update((*side as u64).to_le_bytes()));
            let camera = [fx, fy, cx, cy].into_iter().chain(distortion);
            camera.chain(view.cam_from_world.to_cols_array()).for_each(|value| digest.update(value.to_le_bytes()));
        }
        hex(digest)
    }

    /// Digest of all parameters of the Gaussians.
    pub fn of_scene(rows: &GaussianRows) -> String {
        let mut digest = Sha256::new();
        for values in [
            rows.means.as_flattened(),
            rows.rotations.as_flattened(),
            rows.log_scales.as_flattened(),
            &rows.logit_opacities,
            rows.sh_dc.as_flattened(),
            &rows.sh_rest,
        ] {
            digest.update((values.len() as u64).to_le_bytes());
            values.iter().for_each(|value| digest.update(value.to_le_bytes()));
        }
        hex(digest)
    }

    /// The model choices of `options` that differ from the standard.
    pub fn choices(options: &RenderOptions) -> Setting {
        Setting::between(&RenderOptions::standard(), options).of(Judge::Photographs)
    }
}

/// The first half of a digest in hexadecimal digits: 128 bits distinguish all inputs that were not constructed to collide.
fn hex(digest: Sha256) -> String {
    digest.finalize()[..16].iter().map(|byte| format!("{byte:02x}")).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::capture::demo::{self, DemoOptions};
    use crate::gaussians::testing::random_rows;
    use splat_op::Projection;

    #[test]
    fn any_number_of_a_scene_makes_it_another() {
        let rows = random_rows(5, 1, 3);
        let same = Provenance::of_scene(&rows);
        assert_eq!((same.len(), Provenance::of_scene(&rows.clone())), (32, same.clone()));
        let changes: [fn(&mut GaussianRows); 6] = [
            |rows| rows.means[4][2] += 1e-3,
            |rows| rows.rotations[0][0] += 1e-3,
            |rows| rows.log_scales[2][1] += 1e-3,
            |rows| rows.logit_opacities[1] += 1e-3,
            |rows| rows.sh_dc[3][0] += 1e-3,
            |rows| rows.sh_rest[7] += 1e-3,
        ];
        for (i, change) in changes.iter().enumerate() {
            let mut other = rows.clone();
            change(&mut other);
            assert_ne!(Provenance::of_scene(&other), same, "change {i}");
        }
    }

    #[test]
    fn a_capture_is_its_photographs_and_cameras_and_not_its_folder() {
        let write = |width| {
            let folder = tempfile::tempdir().unwrap();
            let options = DemoOptions { width, height: 48, views: 4, points: 50, ..DemoOptions::default() };
            demo::write(folder.path(), &options).unwrap();
            Capture::load(folder.path()).unwrap()
        };
        let (first, again, other) = (write(64), write(64), write(65));
        assert_ne!(first.folder, again.folder);
        assert_eq!(Provenance::of_capture(&first), Provenance::of_capture(&again));
        assert_ne!(Provenance::of_capture(&first), Provenance::of_capture(&other));
        let mut renamed = first.clone();
        renamed.views[1].name.push('x');
        let mut moved = first.clone();
        moved.views[3].cam_from_world.translation.x += 1e-6;
        for changed in [renamed, moved] {
            assert_ne!(Provenance::of_capture(&changed), Provenance::of_capture(&first));
        }
    }

    #[test]
    fn choices_are_said_and_dials_are_not() {
        let options = RenderOptions::fast().with_antialias(true).with_projection(Projection::RayMax).with_near(0.2);
        assert_eq!(Provenance::choices(&options).to_string(), "antialias on, projection ray-max");
        assert!(Provenance::choices(&RenderOptions::exact()).is_empty());
    }
}

//! Converts a file's cameras to this crate's.

use std::f64::consts::PI;
use std::path::Path;

use glam::{DAffine3, DMat3, DVec3};
use splat_op::camera::{MAX_COEFFICIENT, MAX_SIDE_PX};
use splat_op::{CameraModel, Intrinsics};

use super::json::{self, Fields};
use crate::capture::read::{MAX_MAGNITUDE, Place, quoted};
use crate::capture::{Cut, Result, image};

/// How far `RᵀR` may be from the identity. Exporters that round to three digits stay below; a scale or a shear is far above.
const RIGID: f64 = 1e-2;

/// nerfstudio's names for cameras that map slopes. The coefficients decide the model, whatever the name.
const PERSPECTIVE: [&str; 5] = ["PINHOLE", "SIMPLE_PINHOLE", "OPENCV", "SIMPLE_RADIAL", "RADIAL"];

/// nerfstudio's name for cameras that see all around (`nerfstudio/cameras/cameras.py`), of which the size alone counts.
pub(in crate::capture) const EQUIRECTANGULAR: &str = "EQUIRECTANGULAR";

/// COLMAP's name for a fisheye with tangential coefficients.
pub(in crate::capture) const THIN_PRISM_FISHEYE: &str = "THIN_PRISM_FISHEYE";

/// The pose of a camera, `cam_from_world`, from the matrix in the `field` of a frame, `[R | c]`.
///
/// The columns of `R` are the camera's axes in the world: right, up, back. Ours are right, down, forward, so that
///
/// ```text
/// world_from_cam = [R D | c],  D = diag(1, −1, −1)        cam_from_world = [D Rᵀ | −D Rᵀ c]
/// ```
///
/// `R` is first replaced by the nearest rotation, because files are rounded.
pub(super) fn pose(place: &Place, field: &'static str, rows: [[f64; 4]; 4]) -> Result<DAffine3> {
    let [x, y, z, last] = rows;
    let shown = |row: [f64; 4]| row.map(|value| value.to_string()).join(" ");
    if last != [0.0, 0.0, 0.0, 1.0] {
        return Err(place.refuse(field, format!("a matrix with {} as its last row", shown(last)), json::MATRIX));
    }
    if let Some(&value) = [x, y, z].as_flattened().iter().find(|value| !(value.abs() <= MAX_MAGNITUDE)) {
        return Err(place.refuse(field, format!("a matrix with {value:e}"), "finite numbers of at most 1e15"));
    }
    let rotation = DMat3::from_cols_array_2d(&[[x[0], y[0], z[0]], [x[1], y[1], z[1]], [x[2], y[2], z[2]]]);
    let strays = (rotation.transpose() * rotation - DMat3::IDENTITY).to_cols_array();
    let strays = strays.iter().fold(0.0, |most: f64, value| most.max(value.abs()));
    let determinant = rotation.determinant();
    if !(strays <= RIGID && determinant > 0.0) {
        let lengths = [rotation.x_axis, rotation.y_axis, rotation.z_axis].map(|axis| format!("{:.4}", axis.length()));
        let found = format!(
            "a matrix whose first three columns have the lengths {} and the determinant {determinant:.4}",
            lengths.join(", ")
        );
        let expected = "a rotation and a position: columns of length 1, at right angles, with the determinant 1";
        return Err(place.refuse(field, found, expected));
    }
    let world_from_cam = nearest_rotation(rotation) * DMat3::from_diagonal(DVec3::new(1.0, -1.0, -1.0));
    let cam_from_world = world_from_cam.transpose();
    Ok(DAffine3 { matrix3: cam_from_world, translation: -(cam_from_world * DVec3::new(x[3], y[3], z[3])) })
}

/// The rotation of the polar decomposition, by Newton's iteration `R ← (R + R⁻ᵀ)/2` (Higham 1986), which doubles the
/// correct digits: four steps from [`RIGID`] give full f64 precision.
fn nearest_rotation(matrix: DMat3) -> DMat3 {
    (0..4).fold(matrix, |matrix, _| (matrix + matrix.inverse().transpose()) * 0.5)
}

/// Reads a field of a file or a frame.
type Field = fn(&Fields) -> Option<f64>;

/// The names and fields of a focal length in px and of the angle of view along the same side.
struct FocalFields {
    length: (&'static str, Field),
    angle: (&'static str, Field),
}

const FOCAL_X: FocalFields =
    FocalFields { length: ("fl_x", |of| of.fl_x), angle: ("camera_angle_x", |of| of.camera_angle_x) };
const FOCAL_Y: FocalFields =
    FocalFields { length: ("fl_y", |of| of.fl_y), angle: ("camera_angle_y", |of| of.camera_angle_y) };

/// The lens fields of a frame: the frame's own, then the file's.
pub(super) struct Lenses<'a> {
    pub place: Place<'a>,
    pub frame: &'a Fields,
    pub file: &'a Fields,
}

impl<'a> Lenses<'a> {
    /// Size and projection, and whether it is a panorama. A missing size comes from the picture's header.
    pub fn intrinsics(&self, picture: &Path) -> Result<(Intrinsics, Cut)> {
        let (width, height) = match (self.side("w", |of| of.w)?, self.side("h", |of| of.h)?) {
            (Some(width), Some(height)) => (width, height),
            (width, height) => {
                let [of_width, of_height] = image::size(picture)?;
                (width.unwrap_or(of_width), height.unwrap_or(of_height))
            }
        };
        if self.model()? == EQUIRECTANGULAR {
            return Ok((Intrinsics::centred(width, height, 1.0), Cut::Panorama));
        }
        let [fx, fy] = match (self.focal(&FOCAL_X, width)?, self.focal(&FOCAL_Y, height)?) {
            (Some(fx), Some(fy)) => [fx, fy],
            (Some(f), None) | (None, Some(f)) => [f, f],
            (None, None) => {
                let expected = "a focal length in px, or an angle `camera_angle_x`";
                return Err(self.place.refuse("fl_x", "missing", expected));
            }
        };
        let centre = |field, value: Option<f64>, side: usize| match value {
            Some(px) if px.abs() <= MAX_MAGNITUDE => Ok(px),
            Some(px) => Err(self.place.refuse(field, px, "a principal point in px")),
            None => Ok(side as f64 / 2.0),
        };
        let cx = centre("cx", self.number(|of| of.cx), width)?;
        let cy = centre("cy", self.number(|of| of.cy), height)?;
        let (model, distortion) = self.lens()?;
        Ok((Intrinsics::pinhole(width, height, [fx, fy], [cx, cy]).with_lens(model, distortion), Cut::Whole))
    }

    /// The field's value from the frame, or else from the file.
    fn number(&self, of: Field) -> Option<f64> {
        of(self.frame).or_else(|| of(self.file))
    }

    fn side(&self, field: &'static str, of: Field) -> Result<Option<usize>> {
        let Some(px) = self.number(of) else { return Ok(None) };
        let whole = px >= 1.0 && px <= MAX_SIDE_PX as f64 && px.fract() == 0.0;
        let refuse = || self.place.refuse(field, px, format!("a whole number of px, 1 to {MAX_SIDE_PX}"));
        whole.then_some(Some(px as usize)).ok_or_else(refuse)
    }

    /// A focal length in px, or from the field of view over `side` px, `f = side / (2 tan(angle/2))`. The length takes precedence over
    /// the angle, and the frame over the file.
    fn focal(&self, from: &FocalFields, side: usize) -> Result<Option<f64>> {
        let FocalFields { length: (length, length_of), angle: (angle, angle_of) } = *from;
        for fields in [self.frame, self.file] {
            if let Some(focal) = length_of(fields) {
                let right = focal > 0.0 && focal <= MAX_MAGNITUDE;
                let refuse = || self.place.refuse(length, focal, "a positive focal length in px");
                return right.then_some(Some(focal)).ok_or_else(refuse);
            }
            if let Some(radians) = angle_of(fields) {
                let focal = side as f64 / (2.0 * (0.5 * radians).tan());
                let right = radians > 0.0 && radians < PI && focal > 0.0 && focal <= MAX_MAGNITUDE;
                let refuse = || self.place.refuse(angle, radians, "an angle in radians, above 0 and below pi");
                return right.then_some(Some(focal)).ok_or_else(refuse);
            }
        }
        Ok(None)
    }

    /// The model and its coefficients, as nerfstudio defines them: OpenCV's for slopes, of which a pinhole is the case without
    /// coefficients, and OpenCV's for angles. `FULL_OPENCV` adds the denominator.
    fn lens(&self) -> Result<(CameraModel, [f64; 8])> {
        let place = &self.place;
        let number = |field, of: Field| -> Result<f64> {
            match self.number(of) {
                Some(value) if value.abs() <= MAX_COEFFICIENT => Ok(value),
                Some(value) => Err(place.refuse(field, value, "a coefficient of the lens from -1e9 to 1e9")),
                None => Ok(0.0),
            }
        };
        let (p1, p2) = (number("p1", |of| of.p1)?, number("p2", |of| of.p2)?);
        let [k1, k2, k3] = [number("k1", |of| of.k1)?, number("k2", |of| of.k2)?, number("k3", |of| of.k3)?];
        let [k4, k5, k6] = [number("k4", |of| of.k4)?, number("k5", |of| of.k5)?, number("k6", |of| of.k6)?];
        let fix = "Fix it at 0 where the lens is calibrated (K4 of Metashape is of another model) and export again, or export photographs \
                   that are undistorted";
        let none = |field, value: f64, expected| match value == 0.0 {
            true => Ok(()),
            false => Err(place.refuse_with(field, value, expected, fix)),
        };
        let name = self.model()?;
        if ["OPENCV_FISHEYE", THIN_PRISM_FISHEYE].contains(&name) {
            let [sx1, sy1] = [number("sx1", |of| of.sx1)?, number("sy1", |of| of.sy1)?];
            let is_thin = name == THIN_PRISM_FISHEYE && [p1, p2, sx1, sy1] != [0.0; 4];
            for (field, value) in &[("k5", k5), ("k6", k6), ("p1", p1), ("p2", p2)][..if is_thin { 2 } else { 4 }] {
                none(field, *value, "0: a fisheye camera has k1 to k4")?;
            }
            return Ok(match is_thin {
                true => (CameraModel::ThinPrismFisheye, [k1, k2, p1, p2, k3, k4, sx1, sy1]),
                false => (CameraModel::Fisheye, [k1, k2, k3, k4, 0.0, 0.0, 0.0, 0.0]),
            });
        }
        if name != "FULL_OPENCV" {
            for (field, value) in [("k4", k4), ("k5", k5), ("k6", k6)] {
                none(field, value, "0, unless `camera_model` is FULL_OPENCV: programs disagree on what it means")?;
            }
        }
        let all = [k1, k2, p1, p2, k3, k4, k5, k6];
        let model = match (all.iter().any(|&value| value != 0.0), all[4..].iter().any(|&value| value != 0.0)) {
            (false, _) => CameraModel::Pinhole,
            (true, false) => CameraModel::OpenCv,
            (true, true) => CameraModel::FullOpenCv,
        };
        Ok((model, all))
    }

    fn model(&self) -> Result<&'a str> {
        for fields in [self.frame, self.file] {
            if let Some(name) = fields.camera_model.as_deref() {
                let others = ["OPENCV_FISHEYE", "FULL_OPENCV", THIN_PRISM_FISHEYE, EQUIRECTANGULAR];
                let known = PERSPECTIVE.contains(&name) || others.contains(&name);
                let refuse = || {
                    self.place.refuse_with(
                        "camera_model",
                        quoted(name),
                        "PINHOLE, SIMPLE_PINHOLE, SIMPLE_RADIAL, RADIAL, OPENCV, FULL_OPENCV, OPENCV_FISHEYE, THIN_PRISM_FISHEYE or EQUIRECTANGULAR",
                        "Export the capture again with one of these, or with photographs that are undistorted",
                    )
                };
                return known.then_some(name).ok_or_else(refuse);
            }
            // instant-ngp's flag for a fisheye.
            if let Some(fisheye) = fields.is_fisheye {
                return Ok(if fisheye { "OPENCV_FISHEYE" } else { "OPENCV" });
            }
        }
        Ok("OPENCV")
    }
}

//! Equirectangular photographs, 360° × 180°, which train as six pinhole views each: the faces of a cube around the camera.
//!
//! A reader marks their views as [`Cut::Panorama`]. The capture then has six views of 90° in the place of each. Their pictures are cut from the
//! photograph as it is decoded. Masks are cut likewise, and observations of points move to the face that shows them.

use std::collections::HashSet;
use std::path::Path;

use glam::{DAffine3, DVec2, DVec3};
use splat_op::{Equirectangular, Intrinsics};

use super::image::Pixels;
use super::{Capture, CaptureError, Observation, Result, Split, View};

/// Names of the faces, in the order of [`Equirectangular::face_from_cam`].
const NAMES: [&str; 6] = ["ahead", "right", "behind", "left", "up", "down"];

/// What part of a photograph the picture of a view is.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub enum Cut {
    /// All of it.
    #[default]
    Whole,
    /// All of an equirectangular photograph, whose size the intrinsics state. Formats return such views; a loaded [`Capture`] has none.
    Panorama,
    /// A face of an equirectangular photograph.
    Face(Face),
}

/// A face of an equirectangular photograph.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Face {
    /// The photograph's name.
    pub photograph: String,
    /// The photograph's size.
    pub panorama: Equirectangular,
    /// Which face it is, in the order of [`Equirectangular::face_from_cam`].
    pub number: usize,
}

impl View {
    /// The name of the photograph of which the view is a part, or all.
    pub fn photograph(&self) -> &str {
        if let Cut::Face(face) = &self.cut { &face.photograph } else { &self.name }
    }

    /// Width and height of the picture's file, px.
    pub fn file_size(&self) -> [usize; 2] {
        match &self.cut {
            Cut::Face(Face { panorama, .. }) => [panorama.width, panorama.height],
            Cut::Whole | Cut::Panorama => [self.intrinsics.width, self.intrinsics.height],
        }
    }

    /// A face of this panorama. `pano.jpg` becomes `pano.ahead.jpg`, so that pictures of faces have different names with any extension.
    fn of_face(&self, number: usize, panorama: Equirectangular) -> Self {
        let extension = Path::new(&self.name).extension().map_or(0, |extension| 1 + extension.len());
        let mut name = self.name.clone();
        name.insert_str(name.len() - extension, &format!(".{}", NAMES[number]));
        let (side, turn) = (panorama.face_side(), Equirectangular::face_from_cam()[number]);
        Self {
            name,
            image_path: self.image_path.clone(),
            intrinsics: Intrinsics::centred(side, side, side as f64 / 2.0),
            cam_from_world: DAffine3::from_mat3(turn) * self.cam_from_world,
            cut: Cut::Face(Face { photograph: self.name.clone(), panorama, number }),
        }
    }
}

/// The capture with six views in the place of each panorama, which stand together. Refuses a panorama that is not twice as wide as high, and a
/// face that has the name of a photograph.
pub(super) fn cut(mut capture: Capture) -> Result<Capture> {
    let panoramas = capture.views.iter().filter(|view| view.cut == Cut::Panorama).count();
    if panoramas == 0 {
        return Ok(capture);
    }
    let refuse = |detail| Err(CaptureError::content(capture.files.first().unwrap_or(&capture.folder), detail));
    // For each photograph its views, and its size if it is a panorama.
    let (mut views, mut places) = (Vec::new(), Vec::new());
    for view in &capture.views {
        let ([width, height], first) = (view.file_size(), views.len());
        let panorama = (view.cut == Cut::Panorama).then_some(Equirectangular { width, height });
        match panorama {
            None => views.push(view.clone()),
            Some(panorama) if width == 2 * height => views.extend((0..6).map(|face| view.of_face(face, panorama))),
            Some(_) => {
                return refuse(format!(
                    "the camera of {} is equirectangular, and the photograph {width} × {height} px, expected twice as wide as high: 360° × 180°. \
                     Export the whole sphere from the program that stitched it",
                    view.name
                ));
            }
        }
        places.push((first..views.len(), panorama));
    }
    let mut names = HashSet::new();
    if let Some(View { name, .. }) = views.iter().find(|view| !names.insert(&view.name)) {
        return refuse(format!("{name} is a photograph and a face of a panorama. Rename one of them"));
    }
    let all_of = |list: Vec<usize>| list.iter().flat_map(|&photograph| places[photograph].0.clone()).collect();
    capture.split = capture.split.map(|Split { train, test }| Split { train: all_of(train), test: all_of(test) });
    let masks = capture.masks.into_iter().zip(&places);
    capture.masks = masks.flat_map(|(mask, (views, _))| vec![mask; views.len()]).collect();
    capture.tracks = capture.tracks.moved(|seen| {
        let first = places[seen.view].0.start;
        let Some(panorama) = places[seen.view].1 else { return Observation { view: first, ..*seen } };
        let px = DVec2::from_array(seen.at_px.map(f64::from));
        let (face, cam) = Equirectangular::face_of(panorama.cam_from_px(px));
        let at_px = (cam.truncate() / cam.z + 1.0) * (panorama.face_side() as f64 / 2.0);
        Observation { view: first + face, at_px: at_px.as_vec2().to_array() }
    });
    capture.remarks.push(format!("{panoramas} panoramas are cut into {} views of 90°", 6 * panoramas));
    Ok(Capture { views, ..capture })
}

impl Face {
    /// For each pixel of the face, row-major, its position in the panorama, px.
    fn positions(&self) -> impl Iterator<Item = DVec2> {
        let (panorama, side) = (self.panorama, self.panorama.face_side());
        let cam_from_face = Equirectangular::face_from_cam()[self.number].transpose();
        (0..side * side).map(move |pixel| {
            let [x, y] = [pixel % side, pixel / side].map(|at| 2.0 * (at as f64 + 0.5) / side as f64 - 1.0);
            panorama.px_from_cam(cam_from_face * DVec3::new(x, y, 1.0))
        })
    }

    /// The index of a pixel of the panorama. Columns go on across the seam, and rows across a pole, half a turn away.
    fn index(&self, x: i64, y: i64) -> usize {
        let [width, height] = [self.panorama.width, self.panorama.height].map(|side| side as i64);
        let beyond = (width / 2, (2 * height - 1 - y) % (2 * height));
        let (turn, y) = if (0..height).contains(&y) { (0, y) } else { beyond };
        (y * width + (x + turn).rem_euclid(width)) as usize
    }

    /// The face of a decoded panorama, interpolated bilinearly, colours weighted by their opacities.
    pub(super) fn pixels(&self, (colours, opacities): &Pixels) -> Pixels {
        let (colours, _) = colours.as_chunks::<3>();
        let (mut rgb, mut alpha) = (Vec::with_capacity(3 * self.panorama.face_side().pow(2)), Vec::new());
        for px in self.positions() {
            let corner = (px - 0.5).floor();
            let share = (px - 0.5 - corner).as_vec2();
            let (mut sum, mut opacity) = ([0.0f32; 3], 0.0f32);
            for (right, below) in [(0, 0), (1, 0), (0, 1), (1, 1)] {
                let at = self.index(corner.x as i64 + right, corner.y as i64 + below);
                let weight = [1.0 - share.x, share.x][right as usize] * [1.0 - share.y, share.y][below as usize];
                let weight = weight * opacities.as_ref().map_or(1.0, |alpha| f32::from(alpha[at]) / 255.0);
                opacity += weight;
                for (sum, level) in sum.iter_mut().zip(colours[at]) {
                    *sum += weight * f32::from(level);
                }
            }
            // Nothing is seen of a pixel without opacity.
            rgb.extend(sum.map(|sum| (sum / opacity.max(f32::MIN_POSITIVE)).round() as u8));
            alpha.extend(opacities.as_ref().map(|_| (255.0 * opacity).round() as u8));
        }
        (rgb, Some(alpha).filter(|alpha| alpha.iter().any(|&opacity| opacity != u8::MAX)))
    }

    /// The face of a mask of the panorama: the nearest of its pixels.
    pub(super) fn mask(&self, of: &[bool]) -> Vec<bool> {
        self.positions().map(|px| of[self.index(px.x.floor() as i64, px.y.floor() as i64)]).collect()
    }
}

#[cfg(test)]
mod tests;

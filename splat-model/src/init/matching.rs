//! Points on the surfaces of a scene, found in photographs of known poses: a start where a capture has few points.
//!
//! A pixel has a ray. At even steps of inverse depth along it, the patch around the pixel is compared with what other photographs show
//! there, by normalised cross-correlation (a plane sweep, Collins 1996). The depth of the best match is taken if the match is good and no
//! other depth matches nearly as well.

use glam::{DAffine3, DVec2, DVec3, Vec2};
use image::imageops::{FilterType, grayscale, resize};
use image::{ImageBuffer, Rgb};
use rand::{Rng, RngExt};
use rayon::prelude::*;
use splat_op::{CameraModel, Projector};

use super::{distance_to, focus_of};
use crate::capture::{Photo, Photograph, PointCloud, Result};

/// Largest number of photographs that are compared, evenly spaced. Their pictures take up to 120 MB.
const MOST_PHOTOGRAPHS: usize = 256;

/// Longer side of the pictures that are compared, px.
const SIDE: f64 = 240.0;

/// Half of a patch's side without the middle, px, and the number of its pixels.
const HALF: i16 = 3;
const PATCH: usize = (2 * HALF as usize + 1).pow(2);

/// Smallest standard deviation of a patch, levels of 255. A patch without detail matches everywhere.
const DETAIL: f32 = 3.0;

/// Number of photographs that each is compared with, and the angle between two rays to the middle of the scene that is preferred, radians.
const NEIGHBOURS: usize = 4;
const ANGLE: f64 = 0.14;

/// Smallest angle of neighbours, radians: at less, a depth is uncertain.
const SMALLEST_ANGLE: f64 = 0.02;

/// Nearest depth, relative to the distance of the point that all cameras look at; the number of depths; and those on either side that belong to a match.
const NEAREST: f64 = 0.3;
const DEPTHS: usize = 128;
const PEAK: usize = 3;

/// Smallest correlation of a match, the mean of the best two photographs, and by how much all other depths are below it.
const MATCH: f32 = 0.8;
const MARGIN: f32 = 0.1;

/// Largest number of pixels that are tried for each wanted point, and how many at a time.
const TRIALS: usize = 4;
const AT_ONCE: usize = 4096;

/// Finds at most `count` points on surfaces that several of these photographs show, with the colours that they have there: world frame.
/// Pixels are drawn at random. Fewer points are found where photographs overlap little or show little detail, and none for orthographic
/// cameras. Masked and transparent pixels are left out.
///
/// # Errors
/// If a photograph cannot be decoded.
pub fn matched_points(photos: &[Photograph], count: usize, rng: &mut impl Rng) -> Result<PointCloud> {
    let step = photos.len().div_ceil(MOST_PHOTOGRAPHS).max(1);
    let is_usable = |photo: &&Photograph| photo.intrinsics.model != CameraModel::Orthographic;
    let of: Vec<&Photograph> = photos.iter().step_by(step).filter(is_usable).collect();
    let poses: Vec<DAffine3> = of.iter().map(|photo| photo.cam_from_world.inverse()).collect();
    let mut points = PointCloud::default();
    let Some((focus, extent, _)) = focus_of(&poses) else { return Ok(points) };
    let picture = |photo: &&Photograph| photo.pixels().map(|photo| Picture::new(&photo, focus, extent));
    let pictures = of.par_iter().map(picture).collect::<Result<Vec<_>>>()?;
    let neighbours: Vec<Vec<Neighbour>> = pictures.par_iter().map(|own| own.neighbours(&pictures)).collect();
    let mut left = TRIALS * count;
    while points.positions.len() < count && left > 0 {
        let drawn: Vec<(usize, DVec2)> = (0..left.min(AT_ONCE))
            .map(|_| {
                let view = rng.random_range(0..pictures.len());
                let [x, y] = pictures[view].size.map(|side| rng.random_range(0.0..side as f64));
                (view, DVec2::new(x, y))
            })
            .collect();
        left -= drawn.len();
        let find = |&(view, at): &(usize, DVec2)| pictures[view].find(at, &neighbours[view]);
        let (positions, colours): (Vec<_>, Vec<_>) = drawn.par_iter().filter_map(find).unzip();
        points.positions.extend(positions);
        points.colours.extend(colours);
    }
    points.truncate(count);
    Ok(points)
}

/// A photograph at the size that is compared. Positions are in its pixels.
struct Picture {
    /// Pixels of the photograph for one of the picture.
    scale: f64,
    /// Width and height.
    size: [usize; 2],
    /// `[H, W]`: levels of 255.
    grey: Vec<f32>,
    /// `[H, W]`: colours, and whether the pixel counts.
    pixels: Vec<([u8; 3], bool)>,
    projector: Projector,
    cam_from_world: DAffine3,
    world_from_cam: DAffine3,
    /// Distance of the point that all cameras look at, scene units.
    distance: f64,
}

/// A picture to compare with, and `cam_from_own`, its camera relative to one's own.
type Neighbour<'a> = (&'a Picture, DAffine3);

impl Picture {
    fn new(photo: &Photo, focus: DVec3, extent: f64) -> Self {
        let (width, height) = (photo.intrinsics.width, photo.intrinsics.height);
        let scale = (width.max(height) as f64 / SIDE).max(1.0);
        let side = |full: usize| ((full as f64 / scale) as usize).max(1);
        let size @ [w, h] = [side(width), side(height)];
        let colours = ImageBuffer::<Rgb<u8>, _>::from_raw(width as u32, height as u32, &photo.rgb[..]);
        let grey = colours.map(|colours| resize(&grayscale(&colours), w as u32, h as u32, FilterType::Triangle));
        let pixel = |slot: usize| {
            let full = |at: usize| ((at as f64 + 0.5) * scale) as usize;
            let at = full(slot / w).min(height - 1) * width + full(slot % w).min(width - 1);
            let counts = photo.mask.as_ref().is_none_or(|mask| mask[at])
                && photo.alpha.as_ref().is_none_or(|alpha| alpha[at] == u8::MAX);
            ([0, 1, 2].map(|channel| photo.rgb[3 * at + channel]), counts)
        };
        let world_from_cam = photo.cam_from_world.inverse();
        Self {
            scale,
            size,
            grey: grey.map(|grey| grey.into_raw().into_iter().map(f32::from).collect()).unwrap_or_default(),
            pixels: (0..w * h).map(pixel).collect(),
            projector: photo.intrinsics.projector(),
            cam_from_world: photo.cam_from_world,
            world_from_cam,
            distance: distance_to(focus, &world_from_cam, extent),
        }
    }

    fn px_from_cam(&self, cam: DVec3) -> Option<Vec2> {
        Some((self.projector.px_from_cam(cam)? / self.scale).as_vec2())
    }

    /// The pictures that show what this one shows in its middle, from directions that differ most nearly by [`ANGLE`].
    fn neighbours<'a>(&self, pictures: &'a [Self]) -> Vec<Neighbour<'a>> {
        let middle = self.world_from_cam.transform_point3(DVec3::Z * self.distance);
        let rated = |picture: &'a Self| {
            let at = picture.px_from_cam(picture.cam_from_world.transform_point3(middle))?;
            let to = |camera: &Self| camera.world_from_cam.translation - middle;
            let angle = to(self).angle_between(to(picture));
            let [width, height] = picture.size.map(|side| side as f32);
            let shows = at.min_element() >= 0.0 && at.x < width && at.y < height;
            (shows && angle > SMALLEST_ANGLE).then(|| ((angle / ANGLE).ln().abs(), picture))
        };
        let mut rated: Vec<(f64, &Self)> = pictures.iter().filter_map(rated).collect();
        rated.sort_by(|a, b| a.0.total_cmp(&b.0));
        let cam_from_own = |picture: &Self| picture.cam_from_world * self.world_from_cam;
        rated.into_iter().take(NEIGHBOURS).map(|(_, picture)| (picture, cam_from_own(picture))).collect()
    }

    /// The surface's position and colour at a position; `None` where nothing is certain.
    fn find(&self, at: DVec2, neighbours: &[Neighbour]) -> Option<([f32; 3], [u8; 3])> {
        let (colour, counts) = self.pixels[at.y as usize * self.size[0] + at.x as usize];
        if !counts || neighbours.len() < 2 {
            return None;
        }
        let own = self.patch(at.as_vec2(), [Vec2::X, Vec2::Y], DETAIL)?;
        let rays = [DVec2::ZERO, DVec2::X, DVec2::Y]
            .map(|offset| self.projector.cam_from_px((at + offset * f64::from(HALF)) * self.scale));
        let inverse_depth = |step: f64| (step + 0.5) / (DEPTHS as f64 * NEAREST * self.distance);
        let seen = |&(picture, cam_from_own): &Neighbour, step: f64| {
            let px =
                |ray| picture.px_from_cam(cam_from_own.matrix3 * ray + cam_from_own.translation * inverse_depth(step));
            let (middle, right, down) = (px(rays[0])?, px(rays[1])?, px(rays[2])?);
            picture.patch(middle, [right, down].map(|side| (side - middle) / f32::from(HALF)), 1.0)
        };
        let score = |step: f64| {
            let mut best = [-1.0_f32; 2];
            for neighbour in neighbours {
                let found = seen(neighbour, step);
                let found = found.map_or(-1.0, |other| other.iter().zip(&own).map(|(a, b)| a * b).sum());
                best = [best[0].max(found), best[1].max(best[0].min(found))];
            }
            (best[0] + best[1]) / 2.0
        };
        let scores: Vec<f32> = (0..DEPTHS).map(|step| score(step as f64)).collect();
        let best = (0..DEPTHS).max_by(|a, b| scores[*a].total_cmp(&scores[*b]))?;
        let others = (0..DEPTHS).filter(|step| step.abs_diff(best) > PEAK).map(|step| scores[step]);
        if scores[best] < MATCH || scores[best] < others.fold(-1.0, f32::max) + MARGIN {
            return None;
        }
        let around = (-4..=4).map(|quarter| (best as f64 + 0.25 * f64::from(quarter)).max(0.0));
        let (step, _) = around.map(|step| (step, score(step))).max_by(|a, b| a.1.total_cmp(&b.1))?;
        let position = self.world_from_cam.transform_point3(rays[0] / inverse_depth(step));
        Some((position.as_vec3().to_array(), colour))
    }

    /// The grey levels around a position in steps of `along`, with mean zero and norm one. `None` where the patch leaves the picture, or where
    /// its standard deviation is below `detail`.
    fn patch(&self, at: Vec2, along: [Vec2; 2], detail: f32) -> Option<[f32; PATCH]> {
        let [width, height] = self.size;
        // Relative to the middle of the first pixel.
        let (at, reach) = (at - 0.5, (along[0].abs() + along[1].abs()) * f32::from(HALF));
        let (low, high) = (at - reach, at + reach);
        if !(low.min_element() >= 0.0 && high.x + 1.001 < width as f32 && high.y + 1.001 < height as f32) {
            return None;
        }
        let mut patch = [0.0; PATCH];
        let side = 2 * HALF + 1;
        for (slot, value) in (0_i16..).zip(&mut patch) {
            let [right, down] = [slot % side - HALF, slot / side - HALF].map(f32::from);
            let position = at + along[0] * right + along[1] * down;
            let (column, row) = (position.x as usize, position.y as usize);
            let (x, y) = (position.x - column as f32, position.y - row as f32);
            let first = row * width + column;
            let mix = |at: usize| self.grey[at] + x * (self.grey[at + 1] - self.grey[at]);
            let (above, below) = (mix(first), mix(first + width));
            *value = above + y * (below - above);
        }
        let mean = patch.iter().sum::<f32>() / PATCH as f32;
        patch.iter_mut().for_each(|value| *value -= mean);
        let norm = patch.iter().map(|value| value * value).sum::<f32>().sqrt();
        (norm > detail * (PATCH as f32).sqrt()).then(|| patch.map(|value| value / norm))
    }
}

#[cfg(test)]
mod tests;

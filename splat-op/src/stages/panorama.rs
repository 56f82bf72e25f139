//! Equirectangular pictures, 360° × 180°: faces of a cube around the camera, resampled.
//!
//! The equirectangular projection has no Jacobian at its poles, and a Gaussian across its seam lies at both borders of the picture. On the
//! faces of a cube, each seen by a pinhole camera of 90°, there is neither pole nor seam. A pixel is interpolated bilinearly on the face
//! that its ray meets. Faces are a pixel larger on all sides than the cube's, so that no pixel needs two of them.
//!
//! The panorama has `W / 2π` px per radian of longitude at its equator and `H / π` px per radian of latitude; a face of `S` px has `S / 2` px
//! per radian at its centre, and more elsewhere. `S = ⌈max(W, 2H) / π⌉` makes faces nowhere coarser than the panorama at its equator.

mod resample;

use std::f64::consts::{PI, TAU};

use burn::tensor::{DType, Device, Int, Tensor, TensorData};
use glam::{DVec2, DVec3};

use self::resample::Resample;
use super::render::render_each;
use super::splats::{Extras, Splats};
use super::Rendered;
use crate::abilities::check_fits;
use crate::backend::apply;
use crate::backend::custom_grad::constant;
use crate::camera::{Camera, Intrinsics};
use crate::check::{Reference, check_positive};
use crate::error::SplatError;
use crate::limits::Need;
use crate::options::RenderOptions;

/// Number of pixels of a face beyond the cube's, on each side.
const MARGIN: usize = 1;

/// For each face, which axis of the camera is its +x, +y and +z, and with which sign: ahead, right, behind, left, up, down.
const FACES: [[(usize, f64); 3]; 6] = [
    [(0, 1.0), (1, 1.0), (2, 1.0)],
    [(2, -1.0), (1, 1.0), (0, 1.0)],
    [(0, -1.0), (1, 1.0), (2, -1.0)],
    [(2, 1.0), (1, 1.0), (0, -1.0)],
    [(0, 1.0), (2, 1.0), (1, -1.0)],
    [(0, 1.0), (2, -1.0), (1, 1.0)],
];

/// An equirectangular camera: the size of its pictures, and on a device the tables by which they are resampled from six faces of a cube.
///
/// The middle of the picture is the camera's +z, +x lies to the right of it, and −y, which is up, is the whole upper border. A position
/// `(x, y)`, px, with pixel centres at +0.5, has the direction
///
/// ```text
/// (cos φ sin λ, −sin φ, cos φ cos λ)        λ = 2π (x / W − ½)        φ = π (½ − y / H)
/// ```
///
/// as in COLMAP's `EQUIRECTANGULAR` (`src/colmap/sensor/models.h`) and OpenSfM's `spherical`. The tables take 32 bytes per pixel and
/// 4 per pixel of the faces.
///
/// ```
/// use burn::tensor::{Device, Tensor};
/// use splat_op::{Colour, Extras, Panorama, RenderOptions, Splats};
///
/// let device = Device::flex();
/// let behind = Splats {
///     means: Tensor::from_floats([[0.0, 0.0, -2.0]], &device),
///     rotations: Tensor::from_floats([[1.0, 0.0, 0.0, 0.0]], &device),
///     scales: Tensor::from_floats([[0.3, 0.3, 0.3]], &device),
///     opacities: Tensor::from_floats([0.9], &device),
///     colour: Colour::Features(Tensor::from_floats([[1.0, 0.5, 0.1]], &device)),
/// };
/// let pose = Tensor::from_floats([[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]], &device);
/// let panorama = Panorama::new(64, 32, &device)?;
/// let picture = panorama.render(&behind, &pose, &Extras::default(), &RenderOptions::standard())?;
/// assert_eq!(picture.colour.dims(), [32, 64, 3]);
/// # Ok::<(), splat_op::SplatError>(())
/// ```
#[derive(Clone, Debug)]
pub struct Panorama {
    width: usize,
    height: usize,
    /// Camera of a face.
    face: Intrinsics,
    tables: Tables,
}

/// Where each pixel lies on the faces, whose pixels are numbered face by face and row by row.
#[derive(Clone, Debug)]
struct Tables {
    /// `[P]`: the first of the four pixels of a face among which a pixel lies.
    corners: Tensor<1, Int>,
    /// `[P, 2]`: its offset from that pixel, px.
    fractions: Tensor<2>,
    /// `[P, 1]`: the length of its ray per camera z of the face.
    lengths: Tensor<2>,
    /// `[T + 1]`: for each pixel of the faces, where its entries begin.
    starts: Tensor<1, Int>,
    /// `[4P]`: the pixels to which a pixel of a face contributes, times four, plus the corner that it is.
    entries: Tensor<1, Int>,
}

impl Panorama {
    /// Makes the tables of pictures of `width` × `height` px.
    ///
    /// # Errors
    /// If a side is zero or above 32,768 px, or if a table is larger than the device allows.
    pub fn new(width: usize, height: usize, device: &Device) -> Result<Self, SplatError> {
        let side = (width.max(2 * height) as f64 / PI).ceil() as usize;
        Self::with_faces(width, height, side, device)
    }

    /// As [`Self::new`], with faces of `side` px for 90°. The error of the interpolation falls with the square of the side.
    ///
    /// # Errors
    /// As [`Self::new`], also for the faces.
    pub fn with_faces(width: usize, height: usize, side: usize, device: &Device) -> Result<Self, SplatError> {
        Intrinsics::centred(width, height, 1.0).check()?;
        check_positive("side", side, "at least 1 px")?;
        let face = Intrinsics::centred(side + 2 * MARGIN, side + 2 * MARGIN, side as f64 / 2.0);
        face.check()?;
        check_fits(device, &[Need::floats("the tables of a panorama", [4, width, height], "make a smaller panorama")])?;
        let tables = Tables::new(width, height, &face, &device.clone().without_autodiff());
        Ok(Self { width, height, face, tables })
    }

    /// Returns the direction, of length one, in the camera's frame of a position of the picture, px.
    pub fn cam_from_px(&self, px: DVec2) -> DVec3 {
        direction(px, self.width, self.height)
    }

    /// Returns the position, px, of a point of the camera's frame; of the camera's centre, an arbitrary one.
    pub fn px_from_cam(&self, point: DVec3) -> DVec2 {
        let (longitude, latitude) = (point.x.atan2(point.z), (-point.y).atan2(point.x.hypot(point.z)));
        DVec2::new((longitude / TAU + 0.5) * self.width as f64, (0.5 - latitude / PI) * self.height as f64)
    }

    /// Returns the cameras of the six faces: ahead, right, behind, left, up, down. `cam_from_world` is the pose, `[3, 4]`, as in
    /// [`Camera`]. Differentiable in it.
    pub fn faces(&self, cam_from_world: &Tensor<2>) -> [Camera; 6] {
        let device = cam_from_world.device();
        let (axes, signs): (Vec<i32>, Vec<f64>) =
            FACES.as_flattened().iter().map(|&(axis, sign)| (axis as i32, sign)).unzip();
        let axes = Tensor::from_data(TensorData::new(axes, [18]), (&device, DType::I32));
        let signs = Tensor::<2>::from_data(TensorData::new(signs, [18, 1]), (&device, cam_from_world.dtype()));
        let rows = cam_from_world.clone().select(0, axes) * signs;
        std::array::from_fn(|i| Camera { intrinsics: self.face, cam_from_world: rows.clone().narrow(0, 3 * i, 3) })
    }

    /// Renders Gaussians as seen in all directions from a pose, `[3, 4]`. Returns one picture, `[H, W, C]`.
    ///
    /// Differentiable in all tensors of `splats`, in the pose and in the background. The depth is the distance along the pixel's ray.
    /// `mean2d_probe` gets the gradients at the projected centres in px of the faces, summed over them.
    ///
    /// Each face renders as a pinhole camera: planes, the order and the Jacobian are those of its own camera z. A Gaussian that is
    /// wide as seen from the camera therefore has slightly different shapes on two faces, with
    /// [`Projection::RayMax`](crate::Projection) the same but for the blur.
    ///
    /// # Errors
    /// As [`render_view`](crate::render_view), and if the tables lie on another device.
    pub fn render(
        &self,
        splats: &Splats,
        cam_from_world: &Tensor<2>,
        extras: &Extras,
        options: &RenderOptions,
    ) -> Result<Rendered<3>, SplatError> {
        let reference = Reference::new("means", &splats.means)?;
        reference.check("cam_from_world", cam_from_world, [Some(3), Some(4)], "[3, 4]")?;
        reference.check_device("panorama", &self.tables.corners.device())?;
        if extras.backgrounds.is_some() {
            let (found, expected) = ("given".into(), "`background`: all faces have one");
            return Err(SplatError::Value { field: "backgrounds", found, expected });
        }
        let faces = render_each(splats, &self.faces(cam_from_world), extras, options)?;
        let [side, _, channels] = faces[0].colour.dims();
        let planes = channels + 1 + usize::from(options.depth);
        let hint = "render a smaller panorama, or fewer channels";
        reference.check_fits(&[
            Need::floats("the faces of a panorama", [6, side, side, planes], hint),
            Need::floats("the panorama", [self.height, self.width, planes], hint),
        ])?;
        let face = |face: Rendered<3>| {
            let parts = [Some(face.colour), Some(face.alpha), face.depth];
            Tensor::cat(parts.into_iter().flatten().collect(), 2).reshape([side * side, planes])
        };
        let texels: Tensor<2> = Tensor::cat(faces.into_iter().map(face).collect(), 0);
        let Tables { corners, fractions, lengths, starts, entries } = &self.tables;
        let fractions = fractions.clone().cast(texels.dtype());
        let inputs = [(&texels).into(), fractions.into(), corners.into(), starts.into(), entries.into()];
        let picture: Tensor<3> = apply(Resample { row: side }, inputs).float::<2>(0).reshape([self.height, self.width, planes]);
        let part = |first: usize, count: usize| picture.clone().narrow(2, first, count);
        let depth = options.depth.then(|| {
            let z = part(channels + 1, 1);
            let lengths = lengths.clone().cast(z.dtype()).reshape([self.height, self.width, 1]);
            z.clone() * constant(&lengths, z.is_autodiff())
        });
        Ok(Rendered { colour: part(0, channels), alpha: part(channels, 1), depth })
    }
}

fn direction(px: DVec2, width: usize, height: usize) -> DVec3 {
    let (longitude, latitude) = (TAU * (px.x / width as f64 - 0.5), PI * (0.5 - px.y / height as f64));
    DVec3::new(latitude.cos() * longitude.sin(), -latitude.sin(), latitude.cos() * longitude.cos())
}

impl Tables {
    fn new(width: usize, height: usize, face: &Intrinsics, device: &Device) -> Self {
        let (row, pixels) = (face.width, width * height);
        let (mut corners, mut fractions, mut lengths) = (Vec::new(), Vec::new(), Vec::new());
        for (y, x) in (0..height).flat_map(|y| (0..width).map(move |x| (y, x))) {
            let ray = direction(DVec2::new(x as f64 + 0.5, y as f64 + 0.5), width, height);
            let in_face = FACES.map(|axes| DVec3::from_array(axes.map(|(axis, sign)| sign * ray[axis])));
            let (number, ray) = in_face.into_iter().enumerate().max_by(|a, b| a.1.z.total_cmp(&b.1.z)).expect("six");
            let at = (ray.truncate() / ray.z) * face.fx + DVec2::new(face.cx, face.cy) - 0.5;
            let corner = at.floor().clamp(DVec2::ZERO, DVec2::splat((row - 2) as f64));
            corners.push(((number * row + corner.y as usize) * row + corner.x as usize) as i32);
            fractions.extend((at - corner).to_array());
            lengths.push(1.0 / ray.z);
        }
        let of_corner = |entry: usize| corners[entry / 4] as usize + resample::offset(entry % 4, row);
        let mut starts = vec![0_i32; 6 * row * row + 1];
        (0..4 * pixels).for_each(|entry| starts[of_corner(entry) + 1] += 1);
        (1..starts.len()).for_each(|i| starts[i] += starts[i - 1]);
        let (mut next, mut entries) = (starts.clone(), vec![0_i32; 4 * pixels]);
        for entry in 0..4 * pixels {
            let next = &mut next[of_corner(entry)];
            entries[*next as usize] = entry as i32;
            *next += 1;
        }
        let ints = |values: Vec<i32>| {
            let count = values.len();
            Tensor::from_data(TensorData::new(values, [count]), (device, DType::I32))
        };
        let floats = |values: Vec<f64>| {
            let columns = values.len() / pixels;
            Tensor::from_data(TensorData::new(values, [pixels, columns]), (device, DType::F32))
        };
        Self {
            fractions: floats(fractions),
            lengths: floats(lengths),
            starts: ints(starts),
            entries: ints(entries),
            corners: ints(corners),
        }
    }
}

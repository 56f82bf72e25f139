//! Equirectangular pictures, 360° × 180°: faces of a cube around the camera, resampled.
//!
//! The equirectangular projection has no Jacobian at its poles, and a Gaussian across its seam lies at both borders of the picture. On the
//! faces of a cube, each seen by a pinhole camera of 90°, there is neither pole nor seam. A pixel is interpolated bilinearly on the face
//! that its ray meets. Faces are a pixel larger on all sides than the cube's, so that no pixel needs two of them.
//!
//! The panorama has `W / 2π` px per radian of longitude at its equator and `H / π` px per radian of latitude; a face of `S` px has `S / 2` px
//! per radian at its centre, and more elsewhere. `S = ⌈max(W, 2H) / π⌉` makes faces nowhere coarser than the panorama at its equator.

use std::f64::consts::{PI, TAU};

use burn::tensor::{DType, Device, Int, Tensor, TensorData};
use glam::{DMat3, DVec2, DVec3};

use super::render::render_each;
use crate::abilities::{check_fits, is_gpu};
use crate::backend::custom_grad::constant;
use crate::check::{Reference, check_value};
use crate::limits::Need;
use crate::{Accumulation, Camera, Extras, Intrinsics, RenderOptions, Rendered, Result, Splats};

/// Number of pixels of a face beyond the cube's, on each side.
const MARGIN: usize = 1;

/// Largest side of a face, px. The pixels of six fit the range of i32.
const MAX_SIDE: usize = 18_916;

/// For each face, which axis of the camera is its +x, +y and +z, and with which sign: ahead, right, behind, left, up, down.
const FACES: [[(usize, f64); 3]; 6] = [
    [(0, 1.0), (1, 1.0), (2, 1.0)],
    [(2, -1.0), (1, 1.0), (0, 1.0)],
    [(0, -1.0), (1, 1.0), (2, -1.0)],
    [(2, 1.0), (1, 1.0), (0, -1.0)],
    [(0, 1.0), (2, 1.0), (1, -1.0)],
    [(0, 1.0), (2, -1.0), (1, 1.0)],
];

/// The geometry of equirectangular pictures, on the host: their size, px, and the faces of a cube around their camera.
///
/// The middle of the picture is the camera's +z, +x lies to the right of it, and −y, which is up, is the whole upper border. A position
/// `(x, y)`, px, with pixel centres at +0.5, has the direction
///
/// ```text
/// (cos φ sin λ, −sin φ, cos φ cos λ)        λ = 2π (x / W − ½)        φ = π (½ − y / H)
/// ```
///
/// as in COLMAP's `EQUIRECTANGULAR` (`src/colmap/sensor/models.h`) and OpenSfM's `spherical`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Equirectangular {
    /// Number of columns, 360°.
    pub width: usize,
    /// Number of rows, 180°.
    pub height: usize,
}

impl Equirectangular {
    /// Returns the direction, of length one, in the camera's frame of a position of the picture, px.
    pub fn cam_from_px(&self, px: DVec2) -> DVec3 {
        let Self { width, height } = *self;
        let (longitude, latitude) = (TAU * (px.x / width as f64 - 0.5), PI * (0.5 - px.y / height as f64));
        DVec3::new(latitude.cos() * longitude.sin(), -latitude.sin(), latitude.cos() * longitude.cos())
    }

    /// Returns the position, px, of a point of the camera's frame; of the camera's centre, an arbitrary one.
    pub fn px_from_cam(&self, point: DVec3) -> DVec2 {
        let (longitude, latitude) = (point.x.atan2(point.z), (-point.y).atan2(point.x.hypot(point.z)));
        DVec2::new((longitude / TAU + 0.5) * self.width as f64, (0.5 - latitude / PI) * self.height as f64)
    }

    /// Returns the least side, px, of faces of 90° that are nowhere coarser than the picture at its equator.
    pub fn face_side(&self) -> usize {
        (self.width.max(2 * self.height) as f64 / PI).ceil() as usize
    }

    /// Returns the rotation of each face's camera: ahead, right, behind, left, up, down.
    pub fn face_from_cam() -> [DMat3; 6] {
        let axis = |(axis, sign): (usize, f64)| DVec3::from_array(std::array::from_fn(|i| f64::from(i == axis) * sign));
        FACES.map(|[x, y, z]| DMat3::from_cols(axis(x), axis(y), axis(z)).transpose())
    }

    /// Returns the face that shows a direction of the camera's frame, and the direction in the frame of the face.
    pub fn face_of(cam: DVec3) -> (usize, DVec3) {
        let in_face = FACES.map(|axes| DVec3::from_array(axes.map(|(axis, sign)| sign * cam[axis])));
        in_face.into_iter().enumerate().max_by(|a, b| a.1.z.total_cmp(&b.1.z)).expect("six")
    }
}

/// An [equirectangular](Equirectangular) camera: the size of its pictures, and on a device the tables by which they are resampled from six
/// faces of a cube. The tables take four numbers per pixel.
#[derive(Clone, Debug)]
pub struct Panorama {
    picture: Equirectangular,
    /// Camera of a face.
    face: Intrinsics,
    /// `[P]`: the first of the four pixels of the faces among which a pixel lies. Pixels are numbered face by face and row by row.
    corners: Tensor<1, Int>,
    /// `[P, 2]`: its offset from that pixel, px.
    fractions: Tensor<2>,
    /// `[P, 1]`: the length of its ray per camera z of the face.
    lengths: Tensor<2>,
}

impl Panorama {
    /// Makes the tables of pictures of `width` × `height` px.
    ///
    /// # Errors
    /// If a side is zero or above 32,768 px, or if a table is larger than the device allows.
    pub fn new(width: usize, height: usize, device: &Device) -> Result<Self> {
        Self::with_faces(width, height, Equirectangular { width, height }.face_side(), device)
    }

    /// As [`Self::new`], with faces of `side` px for 90°. The error of the interpolation falls with the square of the side.
    ///
    /// # Errors
    /// As [`Self::new`], and if `side` is zero or above 18,916 px.
    pub fn with_faces(width: usize, height: usize, side: usize, device: &Device) -> Result<Self> {
        Intrinsics::centred(width, height, 1.0).check()?;
        check_value("side", (1..=MAX_SIDE).contains(&side), side, "1 to 18916 px")?;
        let face = Intrinsics::centred(side + 2 * MARGIN, side + 2 * MARGIN, side as f64 / 2.0);
        check_fits(device, &[Need::floats("the tables of a panorama", [4, width, height], "make a smaller panorama")])?;
        let (row, pixels, picture) = (face.width, width * height, Equirectangular { width, height });
        let (mut corners, mut fractions, mut lengths) = (Vec::new(), Vec::new(), Vec::new());
        for (y, x) in (0..height).flat_map(|y| (0..width).map(move |x| (y, x))) {
            let ray = picture.cam_from_px(DVec2::new(x as f64 + 0.5, y as f64 + 0.5));
            let (number, ray) = Equirectangular::face_of(ray);
            let at = (ray.truncate() / ray.z) * face.fx + DVec2::new(face.cx, face.cy) - 0.5;
            let corner = at.floor().clamp(DVec2::ZERO, DVec2::splat((row - 2) as f64));
            corners.push(((number * row + corner.y as usize) * row + corner.x as usize) as i32);
            fractions.extend((at - corner).to_array());
            lengths.push(1.0 / ray.z);
        }
        let device = device.clone().without_autodiff();
        let dtype = if is_gpu(&device) { DType::F32 } else { DType::F64 };
        let rows = |values: Vec<f64>, columns| TensorData::new(values, [pixels, columns]);
        Ok(Self {
            picture,
            face,
            corners: Tensor::from_data(TensorData::new(corners, [pixels]), (&device, DType::I32)),
            fractions: Tensor::from_data(rows(fractions, 2), (&device, dtype)),
            lengths: Tensor::from_data(rows(lengths, 1), (&device, dtype)),
        })
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
    /// `mean2d_probe` gets the gradients at the projected centres in px of the faces, summed over them. With
    /// [`Accumulation::Ordered`] the gradient of the resampling is slow on a GPU: its additions run one after another.
    ///
    /// Each face renders as a pinhole camera: planes, the order and the Jacobian are those of its own camera z. A Gaussian that is
    /// wide as seen from the camera therefore has slightly different shapes on two faces, with
    /// [`Projection::RayMax`](crate::Projection) the same but for the blur.
    ///
    /// # Errors
    /// As [`render_view`](crate::render_view), if the tables lie on another device, and if radii or visibility are asked for.
    pub fn render(
        &self,
        splats: &Splats,
        cam_from_world: &Tensor<2>,
        extras: &Extras,
        options: &RenderOptions,
    ) -> Result<Rendered<3>> {
        let reference = Reference::new("means", &splats.means)?;
        reference.check("cam_from_world", cam_from_world, [Some(3), Some(4)], "[3, 4]")?;
        reference.check_device("panorama", &self.corners.device())?;
        check_value("backgrounds", extras.backgrounds.is_none(), "given", "`background`: all faces have one")?;
        check_value("tile_mask", extras.tile_mask.is_none(), "given", "none: a panorama has no tiles")?;
        let expected = "false: a panorama has no ellipses, but those of each of its `faces`";
        check_value("radii", !options.radii, true, expected)?;
        check_value("visible", !options.visible, true, expected)?;
        let of_faces = options.of_rasterize().with_expected_depth(false);
        let faces = render_each(splats, &self.faces(cam_from_world), extras, &of_faces)?;
        let ([side, _, channels], Equirectangular { width, height }) = (faces[0].colour.dims(), self.picture);
        let planes = channels + 1 + usize::from(of_faces.depth) + if options.normals { 3 } else { 0 };
        let hint = "render a smaller panorama, or fewer channels";
        reference.check_fits(&[
            Need::floats("the faces of a panorama", [6, side, side, planes], hint),
            Need::floats("the panorama", [height, width, planes], hint),
        ])?;
        let face = |face: Rendered<3>| {
            let parts = [Some(face.colour), Some(face.alpha), face.depth, face.normals];
            Tensor::cat(parts.into_iter().flatten().collect(), 2).reshape([side * side, planes])
        };
        let texels: Tensor<2> = Tensor::cat(faces.into_iter().map(face).collect(), 0);
        let picture: Tensor<3> = self.resampled(texels, options.accumulation).reshape([height, width, planes]);
        let part = |first: usize, count: usize| picture.clone().narrow(2, first, count);
        let alpha = part(channels, 1);
        let depth = of_faces.depth.then(|| {
            let z = part(channels + 1, 1);
            let lengths = self.lengths.clone().cast(z.dtype()).reshape([height, width, 1]);
            z.clone() * constant(&lengths, z.is_autodiff())
        });
        let mut rendered = Rendered::of(part(0, channels), alpha, depth, options);
        rendered.normals = options.normals.then(|| part(planes - 3, 3));
        Ok(rendered)
    }

    /// Interpolates among the pixels `[T, K]` of the faces. Returns `[P, K]`.
    fn resampled(&self, texels: Tensor<2>, accumulation: Accumulation) -> Tensor<2> {
        let (tracked, columns, row) = (texels.is_autodiff(), texels.dims()[1], self.face.width);
        let corner = |offset: usize| {
            let pixels = self.corners.clone().add_scalar(offset as i64);
            let pixels = if tracked { Tensor::from_inner(pixels) } else { pixels };
            match accumulation {
                // The gradient on a GPU is added by atomic additions.
                Accumulation::Atomic => {
                    texels.clone().gather(0, pixels.unsqueeze_dim::<2>(1).expand([-1, columns as i64]))
                }
                // The gradient on a GPU is added in order, by one unit per column.
                Accumulation::Ordered => texels.clone().select(0, pixels),
            }
        };
        let fractions = constant(&self.fractions.clone().cast(texels.dtype()), tracked);
        let [x, y] = [0, 1].map(|axis| fractions.clone().narrow(1, axis, 1));
        let between = |a: Tensor<2>, b: Tensor<2>, share: &Tensor<2>| a.clone() + (b - a) * share.clone();
        between(between(corner(0), corner(1), &x), between(corner(row), corner(row + 1), &x), &y)
    }
}

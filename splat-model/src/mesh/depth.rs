//! Depth and colours of one view.

use burn::tensor::Tensor;
use glam::DAffine3;
use splat_op::{
    Camera, CameraModel, Extras, Intrinsics, RenderOptions, Splats, contributors, intersect, project, rasterize,
    visible_colours,
};

use super::MeshError;
use crate::gaussians::values_of;

/// Alpha from which on a pixel shows a surface.
const SURFACE: f32 = 0.5;

/// What one view sees of the surface.
#[derive(Clone, Debug)]
pub struct DepthPicture {
    /// A pinhole.
    pub intrinsics: Intrinsics,
    /// The pose, rigid.
    pub cam_from_world: DAffine3,
    /// `[H, W]`: camera z of the surface, scene units; 0 where there is none.
    pub depth: Vec<f32>,
    /// `[H, W]`: display-referred colours, 0 to 1.
    pub colour: Vec<[f32; 3]>,
}

impl DepthPicture {
    /// Renders Gaussians, untracked, with a camera's size, focal lengths and principal point, without its lens.
    ///
    /// Depth is the median's ([`Contributors::median_depth`](splat_op::Contributors::median_depth)), which no layers behind or before the
    /// surface move.
    ///
    /// # Errors
    /// If the camera is orthographic, or the renderer refuses the scene, the camera or the options.
    pub fn render(
        splats: &Splats,
        camera: &Intrinsics,
        cam_from_world: DAffine3,
        options: &RenderOptions,
    ) -> Result<Self, MeshError> {
        let Intrinsics { model, width, height, fx, fy, cx, cy, .. } = *camera;
        if model == CameraModel::Orthographic {
            let (found, expected) = (format!("{model:?}"), "a camera with rays through one point");
            return Err(MeshError::Option { field: "camera", found, expected });
        }
        let intrinsics = Intrinsics::pinhole(width, height, [fx, fy], [cx, cy]);
        let camera = Camera::new(intrinsics, &cam_from_world, &splats.means.device());
        let projected = project(splats, &camera, &Extras::default(), options)?;
        let lists = intersect(&projected, options)?;
        let colours = visible_colours(splats, &camera, &projected, options)?;
        let picture = rasterize(&projected, &colours, &lists, &Extras::default(), options)?;
        let depth = contributors(&projected, &lists, 1, options)?.median_depth();
        // Over black: divided by alpha they are the surface's own.
        let colour = picture.colour / picture.alpha.clone().clamp_min(SURFACE);
        let values = values_of(Tensor::cat(vec![colour.clamp(0.0, 1.0), picture.alpha, depth], 2));
        let (pixels, _) = values.as_chunks::<5>();
        let depth = |&[.., alpha, depth]: &[f32; 5]| if alpha >= SURFACE && depth.is_finite() { depth } else { 0.0 };
        Ok(Self {
            intrinsics,
            cam_from_world,
            depth: pixels.iter().map(depth).collect(),
            colour: pixels.iter().map(|&[r, g, b, ..]| [r, g, b]).collect(),
        })
    }
}

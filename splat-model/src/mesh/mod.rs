//! Triangle meshes of scenes: depth pictures, rendered from the cameras of a capture, are fused into a truncated signed distance field, and
//! its zero is the surface.
//!
//! ```text
//! s = clamp((depth(p) − z) / t, −1, 1)       not where s < −1 before clamping: no view sees behind a surface
//! D = Σ w s / Σ w,  C = Σ w c / Σ w          over the views, w = 1 / z²; colours c where |s| < 1
//! ```
//!
//! with the pixel `p` and the camera's depth `z` of a voxel, and the truncation `t`. Source: Curless and Levoy 1996, "A volumetric method for
//! building complex models from range images", §3; for Gaussians, with the median depth, Huang et al. 2024 (2DGS), "Mesh extraction". The surface is
//! naive surface nets (Gibson 1998) of the crate `fast-surface-nets`: one vertex in each cube of eight voxels whose signs differ.
//!
//! [`of_splats`] makes a mesh of a scene; a [`Volume`] takes depth from anywhere, as [`DepthPicture`];
//! [`formats::write_mesh`](crate::formats::write_mesh) writes glTF.
//!
//! - **Depth** is rendered through a pinhole with the focal lengths of each camera. Pixels with an alpha below a half have none. Where depth
//!   jumps by more than the truncation between neighbours, a voxel between the depths learns nothing.
//! - **Voxels** are in blocks of 8³, only near surfaces, so memory grows with area. Depth beyond twice its median makes no blocks.
//! - **Frame** and units are those of the scene. Fusion sums views in their order in each voxel, and so gives the same bits with any number of
//!   threads.

mod components;
mod depth;
mod surface;
#[cfg(test)]
mod tests;
mod volume;

use glam::DAffine3;
use splat_op::{Intrinsics, RenderOptions, SplatError, Splats};
use thiserror::Error;

pub use self::depth::DepthPicture;
pub use self::volume::Volume;

options! {
    /// Options of a mesh.
    #[derive(Copy)]
    pub struct MeshOptions {
        /// Side of a voxel, scene units. `None`: the median width of a pixel on the surface, or larger where the voxels would not fit into
        /// `memory`.
        pub voxel: Option<f64> = None,
        /// Distance from the surface at which the field is cut off, voxels, at least 2. More is smoother, and closes thin things.
        pub truncation: f64 = 4.0,
        /// Connected components of fewer triangles are dropped.
        pub min_component: usize = 200,
        /// Whether voxels that no view has seen count as empty, so that the surface closes: where nothing was seen it is as thick as the
        /// truncation. Otherwise it ends there.
        pub watertight: bool = false,
        /// Bytes that voxels may take.
        pub memory: usize = 1 << 30,
    }
}

/// The reason why there is no mesh.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum MeshError {
    /// An option out of range.
    #[error("`{field}` is {found}, expected {expected}")]
    Option {
        /// The option.
        field: &'static str,
        /// Its value.
        found: String,
        /// Its range.
        expected: &'static str,
    },
    /// The renderer refuses the scene or a camera.
    #[error(transparent)]
    Render(#[from] SplatError),
    /// The voxels do not fit.
    #[error(
        "voxels of {voxel:.3e} scene units near the surface take more than {mib} MiB: give a larger `--voxel`, such as {:.3e}, or \
         fewer `--views`", 2.0 * .voxel
    )]
    Memory {
        /// Side of a voxel, scene units.
        voxel: f64,
        /// The limit.
        mib: usize,
    },
    /// Nothing to extract.
    #[error(
        "the views show no surface: {components} components were found, and each has fewer than {min} triangles; give a smaller \
         `--min-component` or `--voxel`, and check that the scene is of this capture"
    )]
    Empty {
        /// Number of components.
        components: usize,
        /// [`MeshOptions::min_component`].
        min: usize,
    },
}

/// A triangle mesh in the frame of its scene, scene units.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Mesh {
    /// `[V]`: positions.
    pub positions: Vec<[f32; 3]>,
    /// `[V]`: unit normals, out of the surface: the mean of those of the triangles around a vertex, by area.
    pub normals: Vec<[f32; 3]>,
    /// `[V]`: display-referred colours, 0 to 1.
    pub colours: Vec<[f32; 3]>,
    /// Three vertices each, counter-clockwise as seen from outside.
    pub triangles: Vec<[u32; 3]>,
}

/// Views from which the size of a voxel is chosen.
const SURVEYED: usize = 16;

/// Makes a mesh of a scene as `cameras`, intrinsics and `cam_from_world`, see it. `seen` is called after each picture. Where no voxel is given
/// and the chosen one takes too much memory, the fusion begins again with voxels half as large again.
///
/// # Errors
/// If an option is out of range, the renderer refuses the scene or a camera, the voxels need more memory than allowed, or there is no surface.
pub fn of_splats(
    splats: &Splats,
    cameras: &[(Intrinsics, DAffine3)],
    render: &RenderOptions,
    options: &MeshOptions,
    mut seen: impl FnMut(),
) -> Result<Mesh, MeshError> {
    let picture =
        |&(intrinsics, pose): &(Intrinsics, DAffine3)| DepthPicture::render(splats, &intrinsics, pose, render);
    let some = cameras.iter().step_by(cameras.len().div_ceil(SURVEYED).max(1));
    let mut volume = Volume::for_pictures(&some.map(picture).collect::<Result<Vec<_>, _>>()?, options)?;
    let mut next = 0;
    while let Some(camera) = cameras.get(next) {
        match volume.add(&picture(camera)?) {
            // The surveyed views told too little: once more from the first view.
            Err(MeshError::Memory { .. }) if options.voxel.is_none() => (volume, next) = (volume.coarser(), 0),
            added => {
                added?;
                next += 1;
                seen();
            }
        }
    }
    volume.mesh()
}

//! A stand-in for `capture/colmap/write.rs`, which is being written in another branch. Replace at the merge.

use std::fs;
use std::io;
use std::path::Path;

use glam::DQuat;

use crate::capture::{PointCloud, View};

/// COLMAP's number of the model `PINHOLE` (`fx, fy, cx, cy`).
const PINHOLE: i32 = 1;

/// Writes `cameras.bin`, `images.bin` and `points3D.bin` (COLMAP, `src/colmap/scene/reconstruction_io.cc`).
pub(super) fn write(folder: &Path, views: &[View], points: &PointCloud) -> io::Result<()> {
    fs::create_dir_all(folder)?;
    let mut cameras = (views.len() as u64).to_le_bytes().to_vec();
    let mut images = cameras.clone();
    for (id, view) in (1_u32..).zip(views) {
        let camera = &view.intrinsics;
        cameras.extend(id.to_le_bytes());
        cameras.extend(PINHOLE.to_le_bytes());
        cameras.extend([camera.width, camera.height].map(|px| (px as u64).to_le_bytes()).concat());
        cameras.extend([camera.fx, camera.fy, camera.cx, camera.cy].map(f64::to_le_bytes).concat());
        let (q, t) = (DQuat::from_mat3(&view.cam_from_world.matrix3), view.cam_from_world.translation);
        images.extend(id.to_le_bytes());
        images.extend([q.w, q.x, q.y, q.z, t.x, t.y, t.z].map(f64::to_le_bytes).concat());
        images.extend(id.to_le_bytes());
        images.extend(view.name.as_bytes());
        images.push(0);
        images.extend(0_u64.to_le_bytes());
    }
    let mut cloud = (points.positions.len() as u64).to_le_bytes().to_vec();
    for (id, (position, colour)) in (1_u64..).zip(points.positions.iter().zip(&points.colours)) {
        cloud.extend(id.to_le_bytes());
        cloud.extend(position.map(|x| f64::from(x).to_le_bytes()).concat());
        cloud.extend(colour);
        cloud.extend(0.0_f64.to_le_bytes());
        cloud.extend(0_u64.to_le_bytes());
    }
    fs::write(folder.join("cameras.bin"), cameras)?;
    fs::write(folder.join("images.bin"), images)?;
    fs::write(folder.join("points3D.bin"), cloud)
}

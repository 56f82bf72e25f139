//! A capture small enough for unit tests: photographs are renders of a few random Gaussians.

use burn::tensor::{Device, Tensor};
use glam::{DAffine3, DMat3, DVec3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use splat_op::{Camera, Extras, Intrinsics, RenderOptions, render};

use crate::capture::{Photo, PointCloud};
use crate::gaussians::testing::random_rows;
use crate::gaussians::{Gaussians, values_of};

pub(crate) const WIDTH: usize = 32;
pub(crate) const HEIGHT: usize = 24;

/// A camera on a circle around the origin, looking at the origin.
fn pose(angle_rad: f64) -> DAffine3 {
    let centre = DVec3::new(3.0 * angle_rad.sin(), -0.8, -3.0 * angle_rad.cos());
    let z = -centre.normalize();
    let x = DVec3::Y.cross(z).normalize();
    let cam_from_world = DMat3::from_cols(x, z.cross(x), z).transpose();
    DAffine3::from_mat3_translation(cam_from_world, -(cam_from_world * centre))
}

/// The scene, without autodiff.
pub(crate) fn scene(device: &Device) -> Gaussians {
    Gaussians::from_rows(&random_rows(30, 1, 11), device).unwrap()
}

/// Four photographs of [`scene`], not in the order of their names.
pub(crate) fn photos(background: [f32; 3]) -> Vec<Photo> {
    photographed(["c", "a", "d", "b"].map(String::from), background)
}

/// Photographs of [`scene`] from all around, over black.
pub(crate) fn ring(count: usize) -> Vec<Photo> {
    photographed((0..count).map(|i| format!("{i:02}")), [0.0; 3])
}

fn photographed(names: impl IntoIterator<Item = String>, background: [f32; 3]) -> Vec<Photo> {
    let device = Device::flex();
    let splats = scene(&device).splats();
    let photograph = |(i, name): (usize, String)| {
        let intrinsics = Intrinsics::centred(WIDTH, HEIGHT, 40.0);
        let cam_from_world = pose(0.5 * i as f64);
        let camera = Camera::new(intrinsics, &cam_from_world, &device);
        let extras = Extras::default().with_background(Tensor::from_floats(background, &device));
        let rendered = render(&splats, &[camera], &extras, &RenderOptions::standard()).unwrap();
        let rgb = values_of(rendered.colour).into_iter().map(|value| (255.0 * value).round() as u8).collect();
        Photo { name, intrinsics, cam_from_world, rgb, alpha: None, mask: None }
    };
    names.into_iter().enumerate().map(photograph).collect()
}

/// Grey points near the Gaussians of [`scene`].
pub(crate) fn points() -> PointCloud {
    let mut rng = ChaCha8Rng::seed_from_u64(12);
    let rows = random_rows(30, 1, 11);
    let moved = |mean: &[f32; 3]| mean.map(|value| value + rng.random_range(-0.05..0.05));
    PointCloud { positions: rows.means.iter().map(moved).collect(), colours: vec![[128; 3]; 30] }
}

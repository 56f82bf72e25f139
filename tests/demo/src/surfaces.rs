//! The true surfaces of the still life, and how far a mesh is from them.

use std::collections::HashMap;

use glam::{DAffine3, DVec2, DVec3, IVec3};
use rayon::prelude::*;
use splat_op::Intrinsics;

use super::DemoOptions;
use super::geometry::Ray;
use super::scene::{DemoScene, ObjectKind};

/// A point of a surface, world frame.
#[derive(Clone, Copy, Debug)]
pub struct SurfaceSample {
    /// Position.
    pub position: DVec3,
    /// Unit normal, out of the solid.
    pub normal: DVec3,
    /// Whether it belongs to the objects or their platform, and not to the ground or the sky.
    pub is_object: bool,
}

/// The error of a mesh on the objects and their platform.
#[derive(Clone, Copy, Debug)]
pub struct MeshError {
    /// Mean distance of the mesh's vertices to the true surface, scene units.
    pub distance: f64,
    /// Share of the samples that have a vertex within the tolerance.
    pub completeness: f64,
    /// Mean angle between the normals of vertices within the tolerance and of the surface there, degrees.
    pub normal_deg: f64,
}

/// The surfaces of the still life.
#[derive(Clone, Debug)]
pub struct Surfaces(DemoScene);

impl Surfaces {
    /// Those of the capture with these options.
    pub fn of(options: &DemoOptions) -> Self {
        Self(DemoScene::still_life(options))
    }

    /// What the middle of each pixel shows through a pinhole, `[H, W]`, `None` beyond the dome.
    pub fn seen(&self, camera: &Intrinsics, cam_from_world: &DAffine3) -> Vec<Option<SurfaceSample>> {
        let world_from_cam = cam_from_world.inverse();
        let projector = camera.projector();
        let pixel = |i: usize| {
            let at_px = DVec2::new((i % camera.width) as f64 + 0.5, (i / camera.width) as f64 + 0.5);
            let direction = world_from_cam.transform_vector3(projector.cam_from_px(at_px)).normalize();
            let found = self.0.hit(&Ray { origin: world_from_cam.translation, direction })?;
            let is_object = !self.0.is_surroundings(&found);
            Some(SurfaceSample { position: found.position_world, normal: found.normal_world, is_object })
        };
        (0..camera.width * camera.height).into_par_iter().map(pixel).collect()
    }

    /// The nearest point of any surface, and its distance.
    pub fn nearest(&self, position: DVec3) -> (SurfaceSample, f64) {
        let distances = self.0.objects.iter().map(|object| object.distance(position).abs());
        let nearest = distances.enumerate().min_by(|(_, a), (_, b)| a.total_cmp(b));
        let (object, distance) =
            nearest.map(|(i, distance)| (&self.0.objects[i], distance)).expect("there are objects");
        let slope = |axis: DVec3| object.distance(position + 1e-6 * axis) - object.distance(position - 1e-6 * axis);
        let normal = DVec3::new(slope(DVec3::X), slope(DVec3::Y), slope(DVec3::Z)).normalize_or_zero();
        let is_object = !matches!(object.kind, ObjectKind::Ground | ObjectKind::Sky);
        (SurfaceSample { position: position - object.distance(position) * normal, normal, is_object }, distance)
    }

    /// Measures the vertices of a mesh against the surfaces, and against `seen`, samples that some cameras see.
    pub fn error(
        &self,
        positions: &[[f32; 3]],
        normals: &[[f32; 3]],
        seen: &[SurfaceSample],
        tolerance: f64,
    ) -> MeshError {
        let vector = |values: &[f32; 3]| DVec3::from_array(values.map(f64::from));
        let of_vertex = |(position, normal): (&[f32; 3], &[f32; 3])| {
            let (at, distance) = self.nearest(vector(position));
            let angle = at.normal.dot(vector(normal)).clamp(-1.0, 1.0).acos().to_degrees();
            at.is_object.then_some((distance, angle))
        };
        let found: Vec<(f64, f64)> = positions.par_iter().zip(normals).filter_map(of_vertex).collect();
        let near: Vec<f64> = found.iter().filter(|found| found.0 <= tolerance).map(|found| found.1).collect();
        let mut cells: HashMap<IVec3, Vec<DVec3>> = HashMap::new();
        let cell = |position: DVec3| (position / tolerance).floor().as_ivec3();
        for position in positions.iter().map(vector) {
            cells.entry(cell(position)).or_default().push(position);
        }
        let is_covered = |sample: &SurfaceSample| {
            let around = (0..27).map(|i| cell(sample.position) + IVec3::new(i % 3 - 1, i / 3 % 3 - 1, i / 9 - 1));
            let mut vertices = around.filter_map(|cell| cells.get(&cell)).flatten();
            vertices.any(|vertex| vertex.distance(sample.position) <= tolerance)
        };
        let objects: Vec<&SurfaceSample> = seen.iter().filter(|sample| sample.is_object).collect();
        let covered = objects.par_iter().filter(|sample| is_covered(sample)).count();
        let mean = |sum: f64, count: usize| sum / count as f64;
        MeshError {
            distance: mean(found.iter().map(|found| found.0).sum(), found.len()),
            completeness: mean(covered as f64, objects.len()),
            normal_deg: mean(near.iter().sum(), near.len()),
        }
    }
}

//! The kernel of the contributors against its CPU twin in f64.

use super::contributors::launch_contributors;
use super::contributors_cpu::contributors_cpu;
use super::footprint::EllipseFootprint;
use super::{Layers, RasterizeSpec};
use crate::camera::Intrinsics;
use crate::gpu::Buffer;
use crate::intersect::Cut;
use crate::intersect::cpu::intersect_cpu;
use crate::intersect::launch::launch_intersect;
use crate::options::{Projection, RenderOptions};
use crate::rasterize_rays::footprint::RayFootprint;
use crate::ray_space::bounds_cpu;
use crate::ray_space::launch::launch_bounds;
use crate::testing::ceiling::to_f32;
use crate::testing::ellipses::{ellipses, ray_rows};
use crate::testing::gpu::gpu;

const MOST: usize = 5;

#[test]
fn contributors_agree_with_the_twin() {
    let Some(gpu) = gpu() else { return };
    for projection in [Projection::Affine, Projection::RayMax] {
        let options = RenderOptions::standard().with_projection(projection);
        let spec = RasterizeSpec { intrinsics: Intrinsics::centred(70, 45, 30.0), options };
        let projected = ellipses(3, 40, &spec.intrinsics, [0.05, 1.0]);
        let rows = ray_rows(&projected, &[0.05, -0.03, 0.02].repeat(40), &spec.intrinsics);
        let inputs = Layers { projected: &projected[..], ray_space: &rows, ..Layers::default() };
        let bounds = if options.along_rays() { bounds_cpu(&projected, &rows, &spec) } else { projected.clone() };
        let twin = match options.along_rays() {
            true => contributors_cpu::<f64, RayFootprint<f64>>,
            false => contributors_cpu::<f64, EllipseFootprint<f64>>,
        };
        let expected = twin(inputs, &spec, &intersect_cpu(&bounds, &spec.intrinsics, Cut::of(&options)), MOST);

        let buffer = |values: &[f64]| Buffer::from_slice(&gpu, &to_f32(values));
        let inputs = inputs.each_ref().map(|values| buffer(values));
        let bounds = options.along_rays().then(|| launch_bounds(&gpu, &inputs.projected, &inputs.ray_space, &spec));
        let bounds = bounds.as_ref().unwrap_or(&inputs.projected);
        let lists = launch_intersect(&gpu, bounds, &spec.intrinsics, Cut::of(&options));
        let found = launch_contributors(&gpu, &inputs, &lists, &spec, MOST);
        let mut found = found.into_iter().map(|output| output.expect("three outputs"));
        let [ids, weights, median] = [(); 3].map(|()| found.next().expect("three outputs"));
        let count = expected.ids.len();
        let ids = Buffer::<i32>::from_handle(ids, count).read(&gpu);
        let weights = Buffer::<f32>::from_handle(weights, count).read(&gpu);
        let median = Buffer::<i32>::from_handle(median, count / MOST).read(&gpu);

        // Rounding decides where an alpha or a transmittance is at its threshold.
        let differ = |pixel: usize| {
            let of = pixel * MOST..(pixel + 1) * MOST;
            let close = weights[of.clone()].iter().zip(&expected.weights[of.clone()]);
            ids[of.clone()] != expected.ids[of]
                || median[pixel] != expected.median[pixel]
                || !close.into_iter().all(|(found, expected)| (f64::from(*found) - expected).abs() < 1e-5)
        };
        let differing = (0..count / MOST).filter(|pixel| differ(*pixel)).count();
        assert!(differing < count / MOST / 200, "{projection:?}: {differing} of {} pixels differ", count / MOST);
        let full = expected.ids.chunks(MOST).filter(|ids| ids[MOST - 1] >= 0).count();
        assert!(full > 100 && full < count / MOST, "{projection:?}: {full} pixels are full");
    }
}

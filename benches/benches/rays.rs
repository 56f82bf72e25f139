//! Times frames with each projection, forwards and backwards, by a pinhole
//! and through a lens.
//!
//! `cargo bench --workspace --bench rays -- small` takes any of the scenes of `stages`, by default `small`, and a device, by default
//! `flex`: `gpu` for the first graphics card.

use std::error::Error;
use std::time::Duration;

use burn::tensor::Tensor;
use splat_benches::job::{Job, JobSize, OPTIONS};
use splat_benches::measure::{Prepare, time};
use splat_benches::passes::{backward, forward, leaves};
use splat_op::{Camera, CameraModel, Extras, Projection, RenderOptions, Splats, render_view};
use splat_train::device::DeviceName;

splat_train::allocator!();

/// Time budget for all frames of one scene.
const BUDGET: Duration = Duration::from_secs(40);

/// Lens of the second half of the frames; the first half is a pinhole's.
const LENS: (CameraModel, [f64; 8]) = (CameraModel::OpenCv, [-0.12, 0.03, 0.004, -0.006, 0.0, 0.0, 0.0, 0.0]);

fn main() -> Result<(), Box<dyn Error>> {
    let (sizes, name) = JobSize::beside_a_device(&[JobSize::Small]);
    let (device, name) = name.as_deref().unwrap_or("flex").parse::<DeviceName>()?.resolve()?;
    for size in sizes {
        let job = Job::new(size)?;
        let (splats, camera) = (job.gaussians(&device).splats(), job.camera(&device));
        let choices = [("affine (plain)", OPTIONS), ("ray max", OPTIONS.with_projection(Projection::RayMax))];
        println!(
            "\n{size}, {} × {}, {name}, {} threads",
            job.intrinsics.width,
            job.intrinsics.height,
            rayon::current_num_threads()
        );
        let mut bent = camera.clone();
        (bent.intrinsics.model, bent.intrinsics.distortion) = LENS;
        let all: Vec<(String, &Camera, RenderOptions)> = [(&camera, ""), (&bent, ", lens")]
            .into_iter()
            .flat_map(|(camera, what)| choices.map(|(name, options)| (format!("{name}{what}"), camera, options)))
            .collect();
        let mut frames: Vec<Prepare> =
            all.iter().flat_map(|(_, camera, options)| passes(&splats, camera, *options)).collect();
        let times = time(&mut frames, &device, BUDGET)?;
        println!(
            "{:<36} {:>12} {:>12} {:>13} {:>12}",
            "frame", "forwards, ms", "of plain", "backwards, ms", "of plain"
        );
        for ((name, ..), of) in all.iter().zip(times.chunks_exact(2)) {
            let [forwards, backwards] =
                [0, 1].map(|pass| [1e3 * of[pass].median_s, of[pass].median_s / times[pass].median_s]);
            println!(
                "{name:<36} {:>12.2} {:>12.2} {:>13.2} {:>12.2}",
                forwards[0], forwards[1], backwards[0], backwards[1]
            );
        }
    }
    Ok(())
}

/// Returns a frame without gradients, and the backward pass of a frame.
fn passes(splats: &Splats, camera: &Camera, options: RenderOptions) -> [Prepare; 2] {
    let (own, view) = (splats.clone(), camera.clone());
    let see = move |splats: &Splats| -> Tensor<3> {
        render_view(splats, &view, &Extras::default(), &options).expect("the scene's shapes fit").colour
    };
    let seen = see.clone();
    let grad = see(splats);
    [
        forward(move || Ok(see(&own))),
        backward(grad, {
            let own = splats.clone();
            move || seen(&leaves(&own))
        }),
    ]
}

//! Times frames with each projection and order, forwards and backwards, beside the plain frame of the same scene.
//!
//! `cargo bench --workspace --bench rays -- small` takes any of the scenes of `stages`, by default `small`.

use std::error::Error;
use std::time::Duration;

use burn::tensor::{Device, Tensor};
use splat_benches::job::{Job, JobSize, OPTIONS};
use splat_benches::measure::{Prepare, time};
use splat_benches::passes::{backward, forward, leaves};
use splat_op::{Camera, Extras, Order, Projection, RenderOptions, Splats, render_view};

#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

/// Time budget for all frames of one scene.
const BUDGET: Duration = Duration::from_secs(40);

fn main() -> Result<(), Box<dyn Error>> {
    let device = Device::flex();
    for size in JobSize::from_arguments(&[JobSize::Small])? {
        let job = Job::new(size)?;
        let (splats, camera) = (job.gaussians(&device).splats(), job.camera(&device));
        let choices = [
            ("affine, centre depth (plain)", OPTIONS),
            ("ray max, centre depth", OPTIONS.with_projection(Projection::RayMax)),
            ("affine, per-pixel sort", OPTIONS.with_order(Order::PerPixelSort)),
            ("ray max, per-pixel sort", OPTIONS.with_projection(Projection::RayMax).with_order(Order::PerPixelSort)),
        ];
        println!(
            "\n{size}, {} × {}, {} threads",
            job.intrinsics.width,
            job.intrinsics.height,
            rayon::current_num_threads()
        );
        let mut frames: Vec<Prepare> =
            choices.iter().flat_map(|(_, options)| passes(&splats, &camera, *options)).collect();
        let times = time(&mut frames, &device, BUDGET)?;
        println!(
            "{:<30} {:>12} {:>12} {:>13} {:>12}",
            "frame", "forwards, ms", "of plain", "backwards, ms", "of plain"
        );
        for ((name, _), of) in choices.iter().zip(times.chunks_exact(2)) {
            let [forwards, backwards] =
                [0, 1].map(|pass| [1e3 * of[pass].median_s, of[pass].median_s / times[pass].median_s]);
            println!(
                "{name:<30} {:>12.2} {:>12.2} {:>13.2} {:>12.2}",
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

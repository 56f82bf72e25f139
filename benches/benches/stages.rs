//! Times each pass of a training step on the CPU. Before that, f32 results are compared with the f64 path, which tests compare with
//! the exact renderer and the reference vectors. A wrong result is not timed.
//!
//! `cargo bench --workspace --bench stages -- medium` takes any of `small`, `fox_small`, `fox_colmap`, `medium` and `large`,
//! by default `small` and `medium`.

use std::error::Error;
use std::time::Duration;

use burn::tensor::{DType, Device};
use splat_benches::job::{Job, JobSize, OPTIONS};
use splat_benches::limit::Machine;
use splat_benches::measure::table;
use splat_benches::passes::passes;
use splat_benches::{SyntheticView, share_apart, values};
use splat_op::{Colour, Extras, evaluate_sh, intersect, project};

splat_train::allocator!();

/// Time budget for all passes of one size.
const BUDGET: Duration = Duration::from_secs(30);

fn main() -> Result<(), Box<dyn Error>> {
    let sizes = JobSize::from_arguments(&[JobSize::Small, JobSize::Medium])?;
    let (device, machine) = (Device::flex(), Machine::measure());
    println!("{} threads: {machine}", rayon::current_num_threads());
    for size in sizes {
        if let Some(view) = size.view() {
            verify_stages(&view);
            verify_picture(&view);
        }
        let job = Job::new(size)?;
        let load = job.verify_load();
        println!("\n{size}, {} × {}: {load}", job.intrinsics.width, job.intrinsics.height);
        table(&mut passes(&job, &device)?, &device, &machine, &job.sizes(&load), BUDGET, &[])?;
    }
    Ok(())
}

fn verify_stages(view: &SyntheticView) {
    let device = Device::flex();
    let run = |dtype| {
        let (scene, camera) = (view.scene(&device, dtype), view.camera(&device, dtype));
        let projected = project(&scene, &camera, &Extras::default(), &OPTIONS).expect("shapes fit");
        let counts = values(intersect(&projected, &OPTIONS).expect("options are in range").counts.float());
        let Colour::SphericalHarmonics(sh) = &scene.colour else { unreachable!("the scene has harmonics") };
        let colours = values(evaluate_sh(sh, &scene.means, &camera).expect("shapes fit"));
        (projected.ellipses(), counts, colours)
    };
    let (found, expected) = (run(DType::F32), run(DType::F64));
    assert!(share_apart(&values(found.0.sigma_u), &values(expected.0.sigma_u), 1e-4) == 0.0);
    assert!(share_apart(&values(found.0.sigma_v), &values(expected.0.sigma_v), 1e-4) == 0.0);
    assert!(share_apart(&values(found.0.mean2d), &values(expected.0.mean2d), 1e-3) == 0.0);
    // Lists are conservative: rounding may add a Gaussian that just misses a tile, and rarely does the reverse.
    assert!(share_apart(&found.1, &expected.1, 1.0) < 1e-2);
    assert!(share_apart(&found.2, &expected.2, 1e-5) == 0.0);
}

/// Checks that the float types agree in all pixels except those near a threshold.
fn verify_picture(view: &SyntheticView) {
    let picture = |dtype| values(view.picture(&Device::flex(), dtype));
    let (found, expected) = (picture(DType::F32), picture(DType::F64));
    assert!(share_apart(&found, &expected, 1e-4) < 2e-3);
    assert!(share_apart(&found, &expected, 2e-2) == 0.0);
}

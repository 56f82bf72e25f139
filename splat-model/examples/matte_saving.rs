//! What Gaussians without directional colour save: a training step on a scene in which they are stored apart, and on the same
//! scene in which they have zeros, in turn.
//!
//! ```text
//! cargo run --release --workspace --example matte_saving -- CAPTURE SCENE.ply [MAX_SIDE]
//! ```

use std::error::Error;
use std::path::Path;
use std::time::Instant;

use burn::tensor::{Device, Tensor};
use splat_model::capture::{Capture, Split, load_all};
use splat_model::density::rows::{Gradients, StepRates, Trained};
use splat_model::gaussians::Gaussians;
use splat_model::loss::{DEFAULT_LAMBDA, Truth, photometric};
use splat_model::optim::{Adam, LearningRates};
use splat_model::ply;
use splat_op::{Camera, Extras, RenderOptions, render_view};

/// Of each part of a step the fastest of so many counts: what else the machine does only ever adds.
const ROUNDS: usize = 8;
const VIEWS: usize = 8;
const PARTS: [&str; 4] = ["forward", "backward", "Adam", "step"];

/// Nothing moves, so that all rounds do the same.
const STILL: LearningRates = LearningRates {
    means: 0.0,
    means_final_share: 1.0,
    scales: 0.0,
    rotations: 0.0,
    sh_dc: 0.0,
    sh_rest: 0.0,
    opacities: 0.0,
};

/// Milliseconds of each of [`PARTS`], and the picture.
fn step(scene: &mut Trained, camera: &Camera, truth: &Truth) -> Result<([f64; 4], Tensor<3>), Box<dyn Error>> {
    let ms = |start: Instant| 1e3 * start.elapsed().as_secs_f64();
    let start = Instant::now();
    let picture = render_view(&scene.gaussians.splats(), camera, &Extras::default(), &RenderOptions::standard())?;
    let forward = ms(start);
    let loss = photometric(picture.colour.clone(), truth, DEFAULT_LAMBDA);
    let mut grads = loss.backward();
    let gradients = Gradients::take(&scene.gaussians, &mut grads);
    let backward = ms(start) - forward;
    scene.step(gradients, &Adam::default(), &StepRates { rates: STILL, means: 0.0 }, 1, None);
    let step = ms(start);
    Ok(([forward, backward, step - forward - backward, step], picture.colour.inner()))
}

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [folder, file, ..] = &arguments[..] else { return Err("give a capture and a scene".into()) };
    let side = arguments.get(2).map(|side| side.parse()).transpose()?;
    let device = Device::flex();
    let capture = Capture::load(Path::new(folder))?;
    let split = Split::every(&capture.views, 8);
    let photos = load_all(split.train.iter().take(VIEWS).map(|view| &capture.views[*view]), side, |_| ())?;
    let views = photos.iter().map(|photo| {
        let camera = Camera::new(photo.intrinsics, &photo.cam_from_world, &device);
        (camera, Truth::new(photo.rgb_over([0.0; 3], &device)))
    });
    let views: Vec<_> = views.collect();
    let (rows, _) = ply::read(Path::new(file))?;
    let tracked = device.clone().autodiff();
    let mut scenes = [
        Trained::new(Gaussians::from_rows(&rows, &tracked)?),
        Trained::new(Gaussians::from_rows_apart(&rows, &tracked)?),
    ];
    let mut fastest = [[[f64::INFINITY; 4]; VIEWS]; 2];
    let mut apart = 0.0_f32;
    for _ in 0..ROUNDS {
        for (view, (camera, truth)) in views.iter().enumerate() {
            let mut pictures = Vec::new();
            for (scene, fastest) in scenes.iter_mut().zip(&mut fastest) {
                let (found, picture) = step(scene, camera, truth)?;
                pictures.push(picture);
                fastest[view].iter_mut().zip(found).for_each(|(least, found)| *least = least.min(found));
            }
            let difference = (pictures.remove(0) - pictures.remove(0)).abs().max().into_scalar::<f32>();
            apart = apart.max(difference);
        }
    }
    let [whole, parted] = &scenes;
    let (count, directional) = (whole.gaussians.len(), parted.gaussians.directional());
    let coefficients = (whole.gaussians.sh_degree() + 1).pow(2);
    // Parameter and two moments.
    let mib = |rows: usize, each: usize| (3 * 3 * size_of::<f32>() * rows * each) as f64 / f64::from(1 << 20);
    println!("{count} Gaussians of degree {}, {} matte", whole.gaussians.sh_degree(), count - directional);
    println!("pictures differ by at most {apart:.1e}");
    let (all, some) = (mib(count, coefficients), mib(directional, coefficients) + mib(count - directional, 1));
    println!("coefficients with their moments: {all:.2} MiB and {some:.2} MiB");
    for (part, name) in PARTS.iter().enumerate() {
        let [one, two] = [0, 1].map(|i| fastest[i].iter().take(views.len()).map(|view| view[part]).sum::<f64>());
        let each = views.len() as f64;
        println!("{name}: {:.2} ms and {:.2} ms, {:+.1}%", one / each, two / each, 100.0 * (two / one - 1.0));
    }
    Ok(())
}

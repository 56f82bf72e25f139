//! Times each operation outside the rasterizer, forwards and backwards, beside the same in tensor code, in turns, and prints which share
//! of a step it saves, and the kernels that a GPU launches. `benches/operations.tsv` has the results of two CPU cores and of a driver in
//! software (2026-11-27).
//!
//! `cargo bench --workspace --bench operations -- cpu medium` takes a device, by default the CPU, and any of `tiny`, `small`, `fox_small`,
//! `fox_colmap`, `medium` and `large`, by default `fox_colmap`.

use std::error::Error;
use std::time::Duration;

use burn::tensor::{Device, Distribution, Int, Tensor};
use splat_benches::job::{Job, JobSize, OPTIONS};
use splat_benches::limit::PassKind;
use splat_benches::measure::{Prepare, time};
use splat_benches::passes::{backward, forward, leaf, passes, whole_step};
use splat_op::test_hooks::{self, of_packed, packed};
use splat_op::{Extras, Projected, SplatError, argsort, bilateral, environment, in_tensor_code, optics};
use splat_train::device::DeviceName;

splat_train::allocator!();

/// Time budget for all operations of a size.
const BUDGET: Duration = Duration::from_secs(120);

/// Operations of every step, and their passes.
const OF_A_STEP: [(&str, &[PassKind]); 4] = [
    ("activation", &[PassKind::Activate, PassKind::ActivateBackward]),
    ("loss", &[PassKind::Loss, PassKind::LossBackward]),
    ("search for values that are not finite", &[PassKind::Guard]),
    ("Adam", &[PassKind::Adam]),
];

/// An operation of a picture, `[H, W, 3]`, and of an effect's parameters.
type Op = fn(&Tensor<3>, &Constants) -> Result<Tensor<3>, SplatError>;

/// What the effects take besides the picture. The parameters among them have gradients.
#[derive(Clone)]
struct Constants {
    grid: Tensor<4>,
    coefficients: Tensor<2>,
    directions: Tensor<3>,
    alpha: Tensor<3>,
}

const ON_PICTURES: [(&str, Op); 2] = [
    ("bilateral grid", |picture, of| bilateral::slice(picture, &of.grid)),
    ("environment", |picture, of| environment::over(picture, &of.alpha, &of.directions, &of.coefficients)),
];

type Optics = fn(&Projected, &Tensor<1>, f64) -> Result<Projected, SplatError>;

const ON_ELLIPSES: [(&str, Optics); 2] = [("motion blur", optics::blurred), ("rolling shutter", optics::rolled)];

/// An operation with the passes of both forms.
struct Compared {
    name: &'static str,
    /// Whether the timed step contains it.
    in_step: bool,
    operation: Vec<Prepare>,
    tensors: Vec<Prepare>,
}

fn main() -> Result<(), Box<dyn Error>> {
    let (sizes, name) = JobSize::beside_a_device(&[JobSize::FoxColmap]);
    let (device, name) = name.as_deref().unwrap_or("flex").parse::<DeviceName>()?.resolve()?;
    println!("{name}, {} threads", rayon::current_num_threads());
    println!(
        "scene\toperation\tms\tms in tensor code\tsaves, share of a step without it\tlaunches\tlaunches in tensor code"
    );
    sizes.into_iter().try_for_each(|size| measure(&Job::new(size)?, &device))
}

fn measure(job: &Job, device: &Device) -> Result<(), Box<dyn Error>> {
    let mut all = operations(job, device)?;
    let lengths: Vec<usize> = all.iter().map(|of| of.operation.len()).collect();
    let passes = all.iter_mut().flat_map(|of| of.operation.iter_mut().chain(&mut of.tensors));
    let times = time(passes, device, BUDGET)?;
    let mut left = times.iter().map(|of| 1e3 * of.median_s);
    let mut sum = |length| left.by_ref().take(length).sum::<f64>();
    let found: Vec<[f64; 2]> = lengths.iter().map(|&length| [sum(length), sum(length)]).collect();
    let step = found.last().expect("the step is the last")[0];
    for (Compared { name, in_step, operation: passes, tensors: plain }, [operation, tensors]) in
        all.iter_mut().zip(found)
    {
        let saved = tensors - operation;
        let share = saved / (step + if *in_step { saved } else { tensors });
        let [own, others] = [launches(passes, device)?, launches(plain, device)?];
        println!("{}\t{name}\t{operation:.2}\t{tensors:.2}\t{share:.2}\t{own}\t{others}", job.size);
    }
    Ok(())
}

/// Returns the number of kernels that a GPU launches, Burn's included.
fn launches(passes: &mut [Prepare], device: &Device) -> Result<usize, Box<dyn Error>> {
    let mut count = 0;
    for prepare in passes {
        let timed = prepare()?;
        device.sync()?;
        let mut done = Ok(());
        let found = test_hooks::launches(|| done = timed().and_then(|_| Ok(device.sync()?)));
        done?;
        count += found.into_values().sum::<usize>();
    }
    Ok(count)
}

/// The operations, then the whole step.
fn operations(job: &Job, device: &Device) -> Result<Vec<Compared>, Box<dyn Error>> {
    let mut all = of_a_step(job, device)?;
    all.extend(on_pictures(job, device)?);
    all.extend(on_ellipses(job, device)?);
    let keys = Tensor::<1>::random([job.rows.len()], Distribution::Uniform(0.0, 1.0), device);
    all.push(compared("sort of rows (not in every step)", false, || {
        let keys = keys.clone();
        Ok(vec![forward(move || Ok(argsort::argsort_floats(keys.clone())))])
    })?);
    all.push(compared("whole step", true, || Ok(vec![whole_step(job, device).prepare]))?);
    Ok(all)
}

fn compared(
    name: &'static str,
    in_step: bool,
    build: impl Fn() -> Result<Vec<Prepare>, Box<dyn Error>>,
) -> Result<Compared, Box<dyn Error>> {
    let in_tensors = |mut prepare: Prepare| -> Prepare {
        Box::new(move || {
            let timed = in_tensor_code(&mut prepare)?;
            Ok(Box::new(move || in_tensor_code(timed)))
        })
    };
    Ok(Compared { name, in_step, operation: build()?, tensors: build()?.into_iter().map(in_tensors).collect() })
}

fn of_a_step(job: &Job, device: &Device) -> Result<Vec<Compared>, Box<dyn Error>> {
    let of = |(name, kinds): (&'static str, &[PassKind])| {
        compared(name, true, || {
            let passes = passes(job, device)?.into_iter();
            Ok(passes.filter(|pass| kinds.contains(&pass.kind)).map(|pass| pass.prepare).collect())
        })
    };
    OF_A_STEP.into_iter().map(of).collect()
}

fn on_pictures(job: &Job, device: &Device) -> Result<Vec<Compared>, Box<dyn Error>> {
    let (width, height) = (job.intrinsics.width, job.intrinsics.height);
    let random = |shape: &[usize]| {
        Tensor::<1>::random([shape.iter().product::<usize>()], Distribution::Uniform(0.5, 1.0), device)
    };
    let constants = Constants {
        grid: leaf(&random(&[12, 8, 16, 16]).reshape([12, 8, 16, 16])),
        coefficients: leaf(&random(&[16, 3]).reshape([16, 3])),
        directions: random(&[3, height, width]).reshape([3, height, width]),
        alpha: random(&[height, width, 1]).reshape([height, width, 1]),
    };
    // Planes of slow waves, as renders lie in memory and as brightness changes in photographs.
    let waves = Tensor::<1, Int>::arange(0..(3 * height * width) as i64, device).float() * 0.02;
    let picture = (waves.sin() * 0.4 + 0.5).reshape([3, height, width]).permute([1, 2, 0]);
    let of = |(name, op): (&'static str, Op)| {
        let (picture, constants) = (picture.clone(), constants.clone());
        let [height, width, channels] = op(&picture, &constants)?.dims();
        // In the order of the picture's planes, as the loss gives it.
        let grad = Tensor::<3>::ones([channels, height, width], device).permute([1, 2, 0]);
        compared(name, false, move || {
            let [(own, of), (leaves, parameters)] = [0; 2].map(|_| (picture.clone(), constants.clone()));
            let run = move || op(&leaf(&leaves), &parameters).expect("as forwards");
            Ok(vec![forward(move || op(&leaf(&own), &of)), backward(grad.clone(), run)])
        })
    };
    ON_PICTURES.into_iter().map(of).collect()
}

fn on_ellipses(job: &Job, device: &Device) -> Result<Vec<Compared>, Box<dyn Error>> {
    let projected =
        splat_op::project(&job.gaussians(device).splats(), &job.camera(device), &Extras::default(), &OPTIONS)?;
    let (rows, intrinsics) = (packed(&projected).clone(), job.intrinsics);
    let twist = leaf(&(Tensor::<1>::ones([6], device) * 0.01));
    let of = |(name, op): (&'static str, Optics)| {
        compared(name, false, || {
            let [of_forward, of_backward] = [0; 2].map(|_| {
                let (rows, twist) = (rows.clone(), twist.clone());
                move || -> Result<Tensor<2>, SplatError> {
                    let projected = of_packed(leaf(&rows), intrinsics);
                    Ok(packed(&op(&projected, &twist, OPTIONS.jacobian_margin)?).clone())
                }
            });
            Ok(vec![forward(of_forward), backward(rows.clone(), move || of_backward().expect("as forwards"))])
        })
    };
    ON_ELLIPSES.into_iter().map(of).collect()
}

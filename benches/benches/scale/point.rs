//! One measurement, in a separate process.

use std::error::Error;
use std::fmt::{self, Display};
use std::fs;
use std::time::{Duration, Instant};

use burn::tensor::{DType, Device, Tensor};
use splat_benches::allocations::{allocated, held};
use splat_benches::job::OPTIONS;
use splat_benches::measure::{PassResult, Prepare, RunTimes, stateful, time};
use splat_benches::passes::leaves;
use splat_benches::step::Step;
use splat_benches::{SyntheticView, values};
use splat_model::optim::MomentBits;
use splat_model::trainer::Trainer;
use splat_op::{Extras, intersect, project, render, with_gradient};

/// Kind of work that is timed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum ScaleWork {
    /// A render and its backward pass, with gradients of all parameters.
    Render,
    /// A training step.
    Step,
    /// A refinement that divides a fifth of the Gaussians, so that there are [`SyntheticView::splats`] afterwards.
    Refinement,
}

impl ScaleWork {
    /// The kinds whose growth is recorded.
    pub const RECORDED: [Self; 2] = [Self::Render, Self::Step];

    pub fn name(self) -> &'static str {
        match self {
            Self::Render => "render and backward",
            Self::Step => "training step",
            Self::Refinement => "refinement",
        }
    }

    pub fn parse(text: &str) -> Option<Self> {
        [Self::Render, Self::Step, Self::Refinement].into_iter().find(|work| work.name() == text)
    }
}

#[derive(Clone, Debug, PartialEq)]
pub struct ScalePoint {
    pub work: ScaleWork,
    pub view: SyntheticView,
    /// Number of photographs.
    pub views: usize,
    /// Bits of Adam's moments in a step on one photograph, and in a refinement.
    pub moments: MomentBits,
}

impl Display for ScalePoint {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { work, view: SyntheticView { splats, width, height, .. }, views, moments } = self;
        write!(f, "{}, {splats} Gaussians, {width} × {height}, {views} views", work.name())?;
        match moments {
            MomentBits::ThirtyTwo => Ok(()),
            bits => write!(f, ", moments of {bits} bits"),
        }
    }
}

impl ScalePoint {
    pub fn pixels(&self) -> usize {
        self.view.width * self.view.height
    }

    /// Number of visible Gaussians, by construction of the scenes; see [`SyntheticView::splats`].
    pub fn visible(&self) -> f64 {
        0.8 * self.view.splats as f64
    }

    /// Writes the point as words for [`Self::read`].
    pub fn write(&self) -> Vec<String> {
        let SyntheticView { splats, width, height, sigma_px, opacity: [low, high] } = self.view;
        let numbers = [splats, width, height, self.views].map(|number| number.to_string());
        let fractions = [sigma_px, low, high].map(|number| number.to_string());
        let moments = (self.moments != MomentBits::ThirtyTwo).then(|| self.moments.to_string());
        [self.work.name().to_owned()].into_iter().chain(numbers).chain(fractions).chain(moments).collect()
    }

    pub fn read(words: &[String]) -> Result<Self, Box<dyn Error>> {
        let [work, splats, width, height, views, sigma_px, low, high, moments @ ..] = words else {
            return Err("eight words, and the bits of moments".into());
        };
        let moments = moments.first().map_or(Ok(MomentBits::ThirtyTwo), |bits| bits.parse())?;
        let view = SyntheticView {
            splats: splats.parse()?,
            width: width.parse()?,
            height: height.parse()?,
            sigma_px: sigma_px.parse()?,
            opacity: [low.parse()?, high.parse()?],
        };
        Ok(Self { work: ScaleWork::parse(work).ok_or("no such work")?, view, views: views.parse()?, moments })
    }
}

/// Time budget for the runs of a point.
const BUDGET: Duration = Duration::from_secs(15);

/// Measures a point and prints seconds, runs, intersections, peak bytes held, and peak bytes of the process's resident memory.
pub fn run(point: &ScalePoint) -> Result<(), Box<dyn Error>> {
    if point.work == ScaleWork::Refinement {
        return refinement(point);
    }
    let intersections = intersections(&point.view);
    let empty = held();
    let mut prepare = match (point.work, point.views) {
        (ScaleWork::Render, _) => render_and_backward(&point.view),
        (_, 1) => stateful(Step::of(&point.view, point.moments), Step::run),
        (_, views) => stateful(point.view.trainer(views), Trainer::step),
    };
    let set_up = held() - empty;
    forget_peak();
    let (times, during) = allocated(|| time([&mut prepare], &Device::flex(), BUDGET));
    let RunTimes { median_s, runs, .. } = times?[0];
    println!("{median_s} {runs} {intersections} {} {}", set_up + during.peak, peak_rss());
    Ok(())
}

fn intersections(view: &SyntheticView) -> usize {
    let device = Device::flex();
    let scene = view.scene(&device, DType::F32);
    let projected =
        project(&scene, &view.camera(&device, DType::F32), &Extras::default(), &OPTIONS).expect("shapes fit");
    let counts = intersect(&projected, &OPTIONS).expect("options are in range").counts;
    values(counts.float()).iter().sum::<f64>() as usize
}

fn render_and_backward(view: &SyntheticView) -> Prepare {
    let device = Device::flex();
    let scene = leaves(&view.scene(&device, DType::F32));
    let camera = view.camera(&device, DType::F32);
    let grad = Tensor::<4>::ones([1, view.height, view.width, 3], &device) / (view.height * view.width) as f64;
    let scene = std::rc::Rc::new(scene);
    Box::new(move || {
        let (scene, camera, grad) = (scene.clone(), camera.clone(), grad.clone());
        Ok(Box::new(move || {
            let rendered = render(&scene, &[camera], &Extras::default(), &OPTIONS)?;
            let value = Tensor::<1>::zeros([1], &grad.device());
            Ok(Box::new(with_gradient(rendered.colour, value, grad).backward()) as PassResult)
        }))
    })
}

/// As [`run`]; once, because it changes the number of Gaussians.
fn refinement(point: &ScalePoint) -> Result<(), Box<dyn Error>> {
    let empty = held();
    let mut step = Step::of(&SyntheticView { splats: point.view.splats * 5 / 6, ..point.view }, point.moments);
    let set_up = held() - empty;
    forget_peak();
    let start = Instant::now();
    let (refined, during) = allocated(|| step.refine());
    let seconds = start.elapsed().as_secs_f64();
    refined?;
    println!("{seconds} 1 0 {} {}", set_up + during.peak, peak_rss());
    Ok(())
}

/// Resets the system's peak of the resident memory. On systems without a reset, the peak covers the whole process.
fn forget_peak() {
    let _ = fs::write("/proc/self/clear_refs", "5");
}

/// Returns the peak of the resident memory in bytes; 0 if the system does not report it.
fn peak_rss() -> usize {
    let kib = || {
        let status = fs::read_to_string("/proc/self/status").ok()?;
        let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"))?;
        line.split_whitespace().next()?.parse::<usize>().ok()
    };
    kib().unwrap_or(0) * 1024
}

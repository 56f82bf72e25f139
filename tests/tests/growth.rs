//! What growth does to the picture: the loss of the same views right before and right after each refinement.

use std::cell::RefCell;
use std::rc::Rc;

use burn::tensor::{Device, Tensor};
use rand::Rng;
use splat_demo::DemoOptions;
use splat_hard_cases::scratch;
use splat_model::capture::Photo;
use splat_model::density::rows::Trained;
use splat_model::density::{AdaptiveConfig, DensityConfig, Observed, Refined, Signals, Strategy, StrategyContext};
use splat_model::loss::{DEFAULT_LAMBDA, Truth, photometric};
use splat_model::optim::scene_extent;
use splat_model::trainer::{TrainConfig, Trainer};
use splat_op::{Camera, Extras, RenderOptions, render_view};

const DEMO: DemoOptions = DemoOptions { width: 96, height: 72, views: 12, points: 1_500, ..DemoOptions::PLAIN };

const STEPS: usize = 1_000;

/// Largest rise of the loss in a refinement.
const LARGEST_RISE: f64 = 0.05;

/// A refinement: its step, the loss before and after, and the number of Gaussians that it added.
type Refinement = (usize, f64, f64, usize);

/// A strategy that is observed.
struct Observing {
    strategy: Box<dyn Strategy>,
    photos: Vec<Photo>,
    seen: Rc<RefCell<Vec<Refinement>>>,
}

impl Observing {
    /// The mean loss of the photographs.
    fn loss(&self, scene: &Trained) -> f64 {
        let device = Device::flex();
        let splats = scene.gaussians.untracked().splats();
        let loss = |photo: &Photo| {
            let (width, height) = (photo.intrinsics.width, photo.intrinsics.height);
            let values: Vec<f32> = photo.rgb.iter().map(|byte| f32::from(*byte) / 255.0).collect();
            let truth = Tensor::<1>::from_floats(values.as_slice(), &device).reshape([height, width, 3]);
            let camera = Camera::new(photo.intrinsics, &photo.cam_from_world, &device);
            let rendered = render_view(&splats, &camera, &Extras::default(), &RenderOptions::standard());
            let image = rendered.expect("a sound scene").colour;
            f64::from(photometric(image, &Truth::new(truth), DEFAULT_LAMBDA).into_scalar::<f32>())
        };
        self.photos.iter().map(loss).sum::<f64>() / self.photos.len() as f64
    }
}

impl Strategy for Observing {
    fn listens_at(&self, step: usize) -> Signals {
        self.strategy.listens_at(step)
    }

    fn observe(&mut self, seen: Observed) {
        self.strategy.observe(seen);
    }

    fn acts_at(&self, step: usize) -> bool {
        self.strategy.acts_at(step)
    }

    fn act(&mut self, scene: &mut Trained, at: &StrategyContext, rng: &mut dyn Rng) -> Refined {
        let before = self.acts_at(at.step).then(|| self.loss(scene));
        let report = self.strategy.act(scene, at, rng)?;
        if let Some((before, report)) = before.zip(report) {
            self.seen.borrow_mut().push((at.step, before, self.loss(scene), report.cloned + report.split));
        }
        Ok(report)
    }
}

/// The refinements of a run on the demo capture.
fn refinements(density: DensityConfig) -> Vec<Refinement> {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let (capture, photos) = scratch::demo(folder.path(), &DEMO).expect("the demo capture");
    let config = TrainConfig { sh_degree: 0, density, ..TrainConfig::for_steps(STEPS) };
    let seen = Rc::default();
    let mut run = Trainer::new(photos.clone(), &capture.points, config.clone(), &Device::flex()).expect("photographs");
    let centres: Vec<_> = photos.iter().map(|photo| photo.cam_from_world.inverse().translation).collect();
    let strategy = config.density.strategy(scene_extent(&centres), STEPS);
    run =
        run.with_strategy(Observing { strategy, photos: photos[..3].to_vec(), seen: Rc::clone(&seen) }).expect("rows");
    while run.steps_done() < STEPS / 2 {
        run.step().expect("a sound run");
    }
    seen.take()
}

#[test]
fn gradual_growth_hardly_changes_the_picture() {
    let gradual = refinements(AdaptiveConfig::gradual().into());
    let added: usize = gradual.iter().map(|(.., added)| added).sum();
    println!("gradual: {gradual:?}");
    assert!(gradual.len() >= 8 && added > 300, "{} refinements, {added} added", gradual.len());
    for (step, before, after, _) in gradual {
        assert!(after <= (1.0 + LARGEST_RISE) * before, "step {step}: the loss rises from {before} to {after}");
    }
    let original = refinements(AdaptiveConfig { from: 100, ..AdaptiveConfig::default() }.into());
    println!("original: {original:?}");
    assert!(original.iter().any(|(_, before, after, _)| *after > (1.0 + LARGEST_RISE) * before), "{original:?}");
}

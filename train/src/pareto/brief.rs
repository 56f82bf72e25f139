//! Choice of a setting for a scene that nobody measured.

use std::ops::Range;
use std::time::{Duration, Instant};

use anyhow::{Context, Result};
use burn::tensor::{Device, Tensor};
use splat_model::accuracy::{ChosenSetting, Dial, Frontier, Measured, Provenance, Spread, Target, Workload, decibels};
use splat_model::gaussians::GaussianRows;
use splat_op::RenderOptions;

use super::dials::{Candidate, candidates};
use super::errors::PictureError;
use super::measure::Bench;
use super::reference::check;
use super::subject::{MeasuredView, cotangent, host};
use super::time::{Budget, FrameTimes};
use crate::progress;

/// Number of views on which errors are measured, at least. More are added while [`SURE_DB`] asks for them.
const VIEWS: usize = 8;

/// The standard's error over all views may be larger than that over the measured ones by so much, dB, for its setting to promise
/// anything. Tried on five scenes, from every view on: no promise then was off by more than 2.8 dB.
const SURE_DB: f64 = 1.0;

/// PSNR above which views say nothing about others, dB, so that all are measured for a higher target. Two splats at nearly the same depth may change places in f32, which few
/// views show: of 40 views of a trained demo scene, 35 have 131 dB or more at the most accurate setting and one has 76 dB.
const ORDER_DB: f64 = 70.0;

/// Number of views on which all settings are timed, at most.
const VIEWS_TIMED: usize = 2;

/// Time after which no further view is rendered exactly.
const EXACT_TIME: Duration = Duration::from_secs(20);

/// Duration of the timing of all settings, and of each setting that is timed again.
const BUDGET: Budget = Budget { time: Duration::from_secs(8), rounds: 20 };

/// A scene and the views of it that are going to be rendered.
pub struct UnmeasuredScene<'a> {
    pub rows: &'a GaussianRows,
    pub shots: Vec<MeasuredView<'a>>,
    pub background: [f32; 3],
    /// The standard with the scene's model choices.
    pub base: RenderOptions,
    /// The device and its name.
    pub device: (&'a Device, &'a str),
    pub work: Workload,
}

/// Some views of a scene with their exact pictures.
struct ExactViews<'a> {
    bench: Bench<'a>,
    pictures: Vec<Vec<f64>>,
    /// Cotangents of the pictures where training is timed.
    cotangents: Vec<Tensor<3>>,
    /// By how many dB the standard's error may be larger over all views, from [`unseen_db`].
    more_db: f64,
    /// Number of views that some were taken from.
    of: usize,
}

/// Chooses a setting. `why` says on how many views it was measured and how much they differ.
///
/// Errors are those of all views at hand. Times are those of the first two; where a time is asked for, the chosen setting is
/// timed again on all views, until it stays the choice.
///
/// # Errors
/// If no measured setting meets the target, or measuring fails.
pub fn choose(scene: &UnmeasuredScene, target: &Target) -> Result<ChosenSetting> {
    progress::note("measuring what accuracy costs here (`splat pareto` measures it thoroughly, for `--frontier`)");
    let views = ExactViews::new(scene, target.error_db)?;
    let gpu = splat_op::is_gpu(scene.device.0);
    let candidates = candidates(&scene.base, [gpu, false]);
    let (first, every) = (0..VIEWS_TIMED.min(views.pictures.len()), 0..views.pictures.len());
    let counter = progress::counter("checking settings", candidates.len());
    let mut errors = Vec::new();
    for candidate in &candidates {
        errors.push(views.errors(&candidate.options)?);
        counter.inc(1);
    }
    counter.finish_and_clear();
    let options: Vec<RenderOptions> = candidates.iter().map(|candidate| candidate.options).collect();
    let rows = candidates.iter().zip(&errors).zip(views.time(&options, &first)?);
    let mut frontier = Frontier {
        device: scene.device.1.into(),
        // The frontier is not saved, so that nobody can take it for another scene's.
        provenance: Provenance::default(),
        splats: scene.rows.len(),
        pixels: MeasuredView::pixels(&scene.shots),
        settings: rows.map(|((candidate, errors), times)| measured(candidate, errors, times)).collect(),
    };
    let mut timed = vec![first == every || target.ms.is_none(); candidates.len()];
    loop {
        let mut choice = frontier.choose(target, scene.work)?;
        let name = &choice.measured.name;
        let at = candidates.iter().position(|candidate| candidate.name == *name).context("a setting without a name")?;
        if timed[at] {
            choice.why.push_str(&views.seen(&errors[at]));
            return Ok(choice);
        }
        let again = measured(&candidates[at], &errors[at], views.time(&options[at..=at], &every)?.remove(0));
        let factor = scene.work.time(&again).median / scene.work.time(&choice.measured).median;
        // The other views take the other settings longer, too.
        for (setting, _) in frontier.settings.iter_mut().zip(&timed).filter(|(_, timed)| !**timed) {
            for spread in [&mut setting.forward_ms, &mut setting.backward_ms, &mut setting.step_ms] {
                *spread = spread.scaled(factor);
            }
        }
        (frontier.settings[at], timed[at]) = (again, true);
    }
}

/// Returns the PSNR of a setting against the exact render on some views of a scene, dB, where `target_db` was asked for.
///
/// # Errors
/// If a view cannot be rendered.
pub fn error_db(scene: &UnmeasuredScene, options: &RenderOptions, target_db: f64) -> Result<f64> {
    let views = ExactViews::new(scene, Some(target_db))?;
    Ok(decibels(total(&views.errors(options)?).rms()))
}

/// What cannot be promised of views that were not measured, for a setting of this PSNR, dB.
pub fn beyond_f32(error_db: f64) -> String {
    let said = || {
        format!(
            "; no promise above {ORDER_DB} dB for other views, in which splats at the same depth may change places in f32"
        )
    };
    (error_db > ORDER_DB).then(said).unwrap_or_default()
}

fn total(errors: &[PictureError]) -> PictureError {
    errors.iter().fold(PictureError::default(), |all, error| all.and(*error))
}

fn measured(candidate: &Candidate, errors: &[PictureError], times: FrameTimes) -> Measured {
    let error = total(errors);
    Measured {
        name: candidate.name.clone(),
        turned: candidate.setting.clone(),
        error_db: decibels(error.rms()),
        max_error: error.max,
        gradient_error: None,
        gradient_cosine: None,
        forward_ms: times.forward,
        backward_ms: times.backward,
        step_ms: times.step,
    }
}

impl<'a> ExactViews<'a> {
    /// Takes views evenly, as many as the target needs, and renders them exactly.
    fn new(scene: &UnmeasuredScene<'a>, target_db: Option<f64>) -> Result<Self> {
        let (of, all_needed) = (scene.shots.len(), target_db.is_some_and(|least| least > ORDER_DB));
        let mut order: Vec<usize> = (0..of).collect();
        // However many are taken, they are spread evenly.
        order.sort_by_key(|view| view.reverse_bits());
        let shots = order.iter().map(|&view| scene.shots[view]).collect();
        let bench = Bench::new(scene.rows, shots, scene.background, scene.base, scene.device.0)?;
        let exact = Dial::all_exact(scene.base);
        let (mut pictures, mut cotangents, mut standard) = (Vec::new(), Vec::new(), Vec::new());
        let (counter, begin) = (progress::counter("rendering exactly", bench.shots.len()), Instant::now());
        for (view, shot) in bench.shots.iter().enumerate() {
            let enough = view >= VIEWS && !all_needed && unseen_db(&standard, of) <= SURE_DB;
            if enough || (view >= VIEWS_TIMED && begin.elapsed() > EXACT_TIME) {
                break;
            }
            let picture = host(bench.exact.render(view, &exact)?.colour);
            check(&bench.exact, (view, shot), &exact, &picture)?;
            if scene.work == Workload::Train {
                cotangents.push(bench.place.picture(view, &cotangent(shot, &picture, scene.background)));
            }
            standard.push(PictureError::between(&host(bench.place.render(view, &scene.base)?.colour), &picture));
            pictures.push(picture);
            counter.inc(1);
        }
        counter.finish_and_clear();
        Ok(Self { bench, pictures, cotangents, more_db: unseen_db(&standard, of), of })
    }

    /// The deviation of each view.
    fn errors(&self, options: &RenderOptions) -> Result<Vec<PictureError>> {
        let error = |(view, exact): (usize, &Vec<f64>)| {
            Ok(PictureError::between(&host(self.bench.place.render(view, options)?.colour), exact))
        };
        self.pictures.iter().enumerate().map(error).collect()
    }

    fn time(&self, options: &[RenderOptions], views: &Range<usize>) -> Result<Vec<FrameTimes>> {
        let cotangents = self.cotangents.get(views.clone()).unwrap_or_default();
        Ok(self.bench.time(options, views, cotangents, BUDGET)?.0)
    }

    /// Describes the views that a setting was checked on, and says where they do not allow a promise for the others.
    fn seen(&self, errors: &[PictureError]) -> String {
        let each = Spread::of(&errors.iter().map(|error| decibels(error.rms())).collect::<Vec<_>>());
        let (count, of) = (errors.len(), self.of);
        let mut said = match each.filter(|_| of > 1) {
            Some(Spread { lower, upper, .. }) => {
                format!(" ({count} of {of} views were measured, half of them with {lower:.1} to {upper:.1} dB)")
            }
            None => String::new(),
        };
        if count < of {
            said.push_str(&beyond_f32(decibels(total(errors).rms())));
        }
        let more_db = self.more_db.max(unseen_db(errors, of));
        if self.more_db > SURE_DB {
            said.push_str(&format!("; no promise for all views: their error may be {more_db:.0} dB larger or more"));
        }
        said
    }
}

/// By how many dB the error over `of` views may be larger than that over some of them: two standard errors of a mean of squares
/// over a sample without replacement. Infinite for one view of several.
fn unseen_db(errors: &[PictureError], of: usize) -> f64 {
    let count = errors.len() as f64;
    match errors.len() {
        all if all == of => return 0.0,
        0 | 1 => return f64::INFINITY,
        _ => {}
    }
    let squares = || errors.iter().map(|error| error.rms().powi(2));
    let mean = squares().sum::<f64>() / count;
    let variance = squares().map(|square| (square - mean).powi(2)).sum::<f64>() / (count - 1.0);
    let error = (variance / count * (1.0 - count / of as f64)).sqrt();
    10.0 * (1.0 + 2.0 * error / mean).log10()
}

#[cfg(test)]
mod tests {
    use glam::{DAffine3, DVec3};

    use super::super::reference::tests::{CAMERA, rows};
    use super::*;

    #[test]
    fn what_other_views_may_add_falls_with_their_number() {
        let view = |error: f64| PictureError::between(&[error], &[0.0]);
        let alike = [view(1e-3); 8];
        assert!(unseen_db(&alike, 100) < 1e-9);
        let mut differing = alike;
        differing[3] = view(1e-2);
        let more_db = unseen_db(&differing, 100);
        assert!(more_db > SURE_DB && more_db < 6.0, "{more_db}");
        assert_eq!(unseen_db(&differing, 8), 0.0, "every view was measured");
        assert!(unseen_db(&differing, 9) < more_db);
        assert!(unseen_db(&alike[..1], 9).is_infinite() && unseen_db(&alike[..1], 1) == 0.0);
    }

    /// What a target above the reach of f32 promises is what all views have, or it is no promise.
    #[test]
    fn a_high_target_is_measured_on_all_views() {
        let (rows, device) = (rows(20), Device::flex());
        let shot = |view: u8| MeasuredView {
            intrinsics: CAMERA,
            cam_from_world: DAffine3::from_translation(DVec3::new(0.02 * f64::from(view), 0.0, 0.1)),
            photo: None,
        };
        let (base, background) = (RenderOptions::standard(), [0.0; 3]);
        let (device, work, shots) = ((&device, "flex"), Workload::Render, (0..12).map(shot).collect());
        let scene = UnmeasuredScene { rows: &rows, shots, background, base, device, work };
        let why = |least| choose(&scene, &Target { error_db: Some(least), ms: None }).unwrap().why;
        assert!(why(75.0).contains("(12 of 12 views were measured"), "{}", why(75.0));
        assert!(why(60.0).contains("(8 of 12 views were measured"), "{}", why(60.0));
        let late = choose(&scene, &Target { error_db: None, ms: Some(1e9) }).unwrap().why;
        assert!(late.contains("8 of 12") && late.contains("no promise above 70 dB"), "{late}");
    }
}

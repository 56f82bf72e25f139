//! `splat inspect`: describes a scene or a capture, and of a capture which effects it calls for and what they would cost.

mod describe;

use std::path::PathBuf;
use std::time::Instant;

use anyhow::Result;
use serde::Serialize;
use splat_model::capture::{Capture, PointsSeen, Scale};
use splat_model::effects::plan::{self, Decision, EffectVerdict, Plan};
use splat_model::effects::survey::{Survey, ViewExposure};

use self::describe::CaptureInfo;
use crate::reconstruct::scale_said;
use crate::report::metrics::seconds_since;
use crate::{input, progress};

/// Columns of the chart on each side of the middle.
const HALF_CHART: usize = 24;

/// Largest number of lines in the chart. Photographs beyond it are left out evenly.
const CHART_LINES: usize = 60;

/// Options of `splat inspect`.
#[derive(Clone, Debug, clap::Args)]
pub struct InspectArgs {
    /// Scene file, or folder of a capture
    pub path: PathBuf,
    /// Print the report as JSON
    #[arg(long)]
    pub json: bool,
}

/// What `--json` prints of a capture.
#[derive(Serialize)]
struct CaptureReport<'a> {
    #[serde(flatten)]
    info: &'a CaptureInfo,
    #[serde(skip_serializing_if = "Option::is_none")]
    scale: Option<&'a Scale>,
    points_seen: &'a PointsSeen,
    /// Null where photographs are missing.
    survey: Option<&'a Survey>,
    plan: Option<&'a Plan>,
    seconds: f64,
}

/// Describes a scene or a capture on standard output.
///
/// # Errors
/// If the file is no scene, or the folder no capture, or one of its pictures cannot be read.
pub fn run(args: &InspectArgs) -> Result<()> {
    let (shown, start) = (args.path.display(), Instant::now());
    if args.path.is_file() && !Capture::is_in(&args.path) {
        let info = describe::of_scene(&args.path)?;
        let text = || format!("{shown}: {}", describe::scene_text(&info));
        progress::say(&if args.json { serde_json::to_string_pretty(&info)? } else { text() });
        return Ok(());
    }
    let capture = input::capture(&args.path)?;
    let cameras: Vec<_> = capture.views.iter().map(|view| (view.intrinsics, view.cam_from_world)).collect();
    let points_seen = PointsSeen::of(&cameras, &capture.points.positions);
    let info = describe::of_capture(&capture, &points_seen);
    let all: Vec<usize> = (0..capture.views.len()).collect();
    // The description names what is missing.
    let is_whole = capture.check_photographs(&all).is_ok();
    let survey = if is_whole { Some(Survey::of(&capture)?) } else { None };
    let plan = survey.as_ref().map(Plan::from);
    if args.json {
        progress::say(&serde_json::to_string_pretty(&CaptureReport {
            info: &info,
            scale: capture.scale.as_ref(),
            points_seen: &points_seen,
            survey: survey.as_ref(),
            plan: plan.as_ref(),
            seconds: seconds_since(start),
        })?);
        return Ok(());
    }
    let scale = capture.scale.as_ref().map(scale_said);
    let seen = (!capture.points.positions.is_empty()).then(|| points_seen.said(|view| &capture.views[view].name));
    let effects = survey.as_ref().zip(plan.as_ref()).map(|(survey, plan)| text(survey, plan));
    let parts = [Some(describe::capture_text(&info)), scale, seen, effects];
    progress::say(&format!("{shown}: {}", parts.into_iter().flatten().collect::<Vec<_>>().join("\n")));
    Ok(())
}

/// Formats a survey and its plan for people.
pub fn text(survey: &Survey, plan: &Plan) -> String {
    let looked = match survey.views_surveyed == survey.views {
        true => String::new(),
        false => format!(", {} of them surveyed", survey.views_surveyed),
    };
    let head = format!("{} photographs{looked}, {} points", survey.views, survey.points);
    let decisions: Vec<String> = plan.decisions.iter().map(line).collect();
    let chart = survey.exposure.as_ref().map(|exposure| chart(&exposure.views)).unwrap_or_default();
    format!("{head}\n{}\n\n{}\n{chart}", plan::source(survey), decisions.join("\n"))
}

/// Formats a decision for people.
fn line(decision: &Decision) -> String {
    let verdict = match decision.verdict {
        EffectVerdict::On => "ON",
        EffectVerdict::Off => "off",
        EffectVerdict::AsConfigured => "as configured",
    };
    format!("{:18}  {verdict}: {}\n{:18}  ({})", decision.name, decision.evidence, "", decision.rule)
}

/// Chart of the photographs' exposure. A bar of `#` to the left of the middle means darker than the capture's median,
/// to the right brighter; `r`, `g` and `b` mark the channels.
fn chart(views: &[ViewExposure]) -> String {
    let values = views.iter().flat_map(|view| view.stops_rgb);
    let largest = values.map(f64::abs).fold(0.05, f64::max);
    let every = views.len().div_ceil(CHART_LINES).max(1);
    let mut text = format!("\nexposure by photograph, -{largest:.2} to +{largest:.2} stops of stored values");
    for view in views.iter().step_by(every) {
        let column = |stops: f64| (HALF_CHART as f64 * (1.0 + stops / largest)).round() as usize;
        let mut bar = vec![' '; 2 * HALF_CHART + 1];
        let (from, to) = (column(view.stops()).min(HALF_CHART), column(view.stops()).max(HALF_CHART));
        bar[from..=to].fill('#');
        bar[HALF_CHART] = '|';
        for (stops, mark) in view.stops_rgb.into_iter().zip(['r', 'g', 'b']) {
            bar[column(stops).min(2 * HALF_CHART)] = mark;
        }
        let bar: String = bar.into_iter().collect();
        text.push_str(&format!("\n[{bar}] {:+.2}  {}", view.stops(), view.name));
    }
    text
}

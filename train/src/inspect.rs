//! `splat inspect`: reports what a capture shows, which effects it calls for, and what they would cost.

use std::path::PathBuf;
use std::time::Instant;

use anyhow::Result;
use clap::value_parser;
use serde::Serialize;
use splat_model::capture::{PointsSeen, Scale};
use splat_model::effects::plan::{self, Cost, Decision, EffectVerdict, Plan, slowness};
use splat_model::effects::survey::{Survey, ViewExposure};

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
    /// Capture folder, with `images/` and COLMAP's `sparse/0/`, or with `transforms.json` or `transforms_train.json`
    pub capture: PathBuf,
    /// Predict costs for photographs whose longer side is at most this, px, as `splat train --max-side` has them
    #[arg(long, value_name = "PX", value_parser = value_parser!(u32).range(1..))]
    pub max_side: Option<u32>,
    /// Print the report as JSON
    #[arg(long)]
    pub json: bool,
}

#[derive(Serialize)]
struct Report<'a> {
    #[serde(skip_serializing_if = "Option::is_none")]
    scale: Option<&'a Scale>,
    points_seen: &'a PointsSeen,
    survey: &'a Survey,
    plan: &'a Plan,
    seconds: f64,
}

/// Surveys a capture and prints the report.
///
/// # Errors
/// If the capture or one of its pictures cannot be read.
pub fn run(args: &InspectArgs) -> Result<()> {
    let start = Instant::now();
    let capture = input::capture(&args.capture)?;
    let survey = Survey::of(&capture)?;
    let all: Vec<usize> = (0..capture.views.len()).collect();
    let plan = Plan::of(&survey, capture.mean_pixels(&all, args.max_side), slowness()?);
    let cameras: Vec<_> = capture.views.iter().map(|view| (view.intrinsics, view.cam_from_world)).collect();
    let points_seen = PointsSeen::of(&cameras, &capture.points.positions);
    let seconds = seconds_since(start);
    if args.json {
        progress::say(&serde_json::to_string_pretty(&Report {
            scale: capture.scale.as_ref(),
            points_seen: &points_seen,
            survey: &survey,
            plan: &plan,
            seconds,
        })?);
        return Ok(());
    }
    let scale = capture.scale.as_ref().map(|scale| format!("{}\n", scale_said(scale))).unwrap_or_default();
    let seen = match capture.points.positions.is_empty() {
        true => String::new(),
        false => format!("{}\n", points_seen.said(|view| &capture.views[view].name)),
    };
    progress::say(&format!("{}: {seconds:.1} s\n{scale}{seen}{}", args.capture.display(), text(&survey, &plan)));
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
    let cost = decision.predicted.filter(|_| decision.verdict == EffectVerdict::On).map_or(String::new(), |cost| {
        let Cost { ms_per_step, mib } = cost;
        format!("\n{:18}  predicted cost: {ms_per_step:.1} ms a step, {mib:.2} MiB", "")
    });
    format!("{:18}  {verdict}: {}\n{:18}  ({}){cost}", decision.name, decision.evidence, "", decision.rule)
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

//! `splat inspect`: describes a scene or a capture, and of a capture which effects it calls for and what they would cost.

mod describe;

use std::path::PathBuf;
use std::time::Instant;

use anyhow::Result;
use serde::Serialize;
use splat_model::capture::{Capture, PointsSeen, Scale};
use splat_model::effects::plan::{self, Decision, EffectVerdict, Plan};
use splat_model::effects::survey::Survey;

use self::describe::CaptureInfo;
use crate::reconstruct::scale_said;
use crate::report::metrics::seconds_since;
use crate::{input, progress};

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

/// Describes a scene or a capture on standard output. An error if the file is no scene, or the folder no capture, or
/// one of its pictures cannot be read.
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
    let exposures = survey.exposure.iter().flat_map(|exposure| &exposure.views);
    let odd = exposures.max_by(|a, b| a.stops().abs().total_cmp(&b.stops().abs()));
    let odd = odd.map(|view| {
        let (name, stops) = (&view.name, view.stops());
        format!("\n\nthe exposure of {name:?} differs most from the median, by {stops:+.2} stops of stored values")
    });
    format!("{head}\n{}\n\n{}{}", plan::source(survey), decisions.join("\n"), odd.unwrap_or_default())
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

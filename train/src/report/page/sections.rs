//! Text and tables of the page.

use std::fmt::Write;

use splat_model::evaluate::Scores;

use super::super::{METRICS, Metrics, Seconds, VIEWS, escape, perceived, table};
use super::comparisons::{Comparisons, MOST};
use crate::effects::ChosenEffects;
use crate::inspect;

/// The main results of a run.
pub fn summary(metrics: &Metrics) -> String {
    let mut tiles: Vec<(String, &str)> = Vec::new();
    if let Some(test) = &metrics.test {
        tiles.push((format!("{:.2} dB", test.psnr), "PSNR, mean of the test views"));
        tiles.push((format!("{:.4}", test.ssim), "SSIM"));
        tiles.push((test.lpips.map_or_else(|| "not measured".into(), |lpips| format!("{lpips:.4}")), "LPIPS"));
    }
    tiles.push((metrics.splats.to_string(), "splats"));
    tiles.extend(metrics.steps.map(|steps| (steps.to_string(), "steps")));
    tiles.extend(metrics.seconds.train.map(|seconds| (duration(seconds), "training")));
    tiles.extend(metrics.peak_rss_mib.map(|mib| (format!("{mib:.0} MiB"), "peak memory")));
    let mut text = String::from("<ul class=\"tiles\">\n");
    for (value, what) in tiles {
        // Writing to a string does not fail.
        let _ = writeln!(text, "<li><strong>{value}</strong> {what}</li>");
    }
    let (device, version) = (escape(&metrics.device), metrics.version);
    text + &format!("</ul>\n<p>Device: {device}. splat {version}.</p>\n")
}

fn duration(seconds: f64) -> String {
    match seconds {
        ..120.0 => format!("{seconds:.1} s"),
        ..7200.0 => format!("{:.1} min", seconds / 60.0),
        _ => format!("{:.1} h", seconds / 3600.0),
    }
}

/// Table of the scores by view, the worst first, and pictures to compare.
pub fn views(scores: Option<&Scores>, comparisons: &Comparisons) -> String {
    let Some(scores) = scores else {
        return "<section>\n<h2>Test views</h2>\n<p>None: <code>--test-every 0</code> holds out no photograph.</p>\n</section>\n".into();
    };
    let titles = [
        ("view", ""),
        ("PSNR, dB", "number"),
        ("SSIM", "number"),
        ("LPIPS", "number"),
        ("PSNR after colour correction, dB", "number"),
        ("SSIM after it", "number"),
    ];
    let rows = comparisons.order.iter().map(|&i| {
        let view = &scores.views[i];
        let name = escape(&view.name);
        let name = match comparisons.shown.iter().any(|shown| shown.view == i) {
            true => format!("<a href=\"#view-{i}\">{name}</a>"),
            false => name,
        };
        let number = |value: f64, digits: usize| format!("{value:.digits$}");
        let lpips = view.lpips.map_or_else(|| "not measured".into(), |lpips| number(lpips, 4));
        let corrected = [number(view.psnr_corrected, 2), number(view.ssim_corrected, 4)];
        [name, number(view.psnr, 2), number(view.ssim, 4), lpips].into_iter().chain(corrected).collect()
    });
    let mut text = format!("<section>\n<h2>Test views, the worst first</h2>\n{}", table(&titles, rows));
    let _ = writeln!(text, "<p>LPIPS: {}.</p>", escape(&perceived(scores)));
    if comparisons.shown.len() < scores.views.len() {
        let (shown, of) = (comparisons.shown.len(), scores.views.len());
        let half = MOST / 2;
        let _ = writeln!(text, "<p>Pictures of {shown} of {of} views: the {half} worst and the {half} best.</p>");
    }
    let _ = writeln!(
        text,
        "<p>The photograph is left of the line, the render right. <code>{VIEWS}/</code> has lossless copies.</p>"
    );
    text.push_str("<div class=\"comparisons\">\n");
    for shown in &comparisons.shown {
        let view = &scores.views[shown.view];
        let (name, id) = (escape(&view.name), shown.view);
        let _ = writeln!(
            text,
            "<figure id=\"view-{id}\">\n<div class=\"comparison\" style=\"aspect-ratio: {} / {}\">\n\
             <img alt=\"render of {name}\" src=\"{}\">\n<img class=\"truth\" alt=\"photograph {name}\" src=\"{}\">\n\
             <input type=\"range\" min=\"0\" max=\"100\" step=\"0.1\" value=\"50\" aria-label=\"share of the photograph\">\n</div>\n\
             <figcaption>{name}: {:.2} dB, {:.4}</figcaption>\n</figure>",
            shown.width, shown.height, shown.render, shown.truth, view.psnr, view.ssim,
        );
    }
    text + "</div>\n</section>\n"
}

/// The survey of the capture and the decisions on effects.
pub fn effects(chosen: Option<&ChosenEffects>) -> String {
    let Some(chosen) = chosen else { return String::new() };
    let names: Vec<&str> = chosen.on.iter().map(|effect| effect.name()).collect();
    let on = if names.is_empty() { "none".into() } else { names.join(", ") };
    let mut text = format!(
        "<section>\n<h2>Survey and effects</h2>\n<p>Effects: {on} (<code>--effects {}</code>).</p>\n",
        escape(&chosen.asked)
    );
    match chosen.survey.as_ref().zip(chosen.plan.as_ref()) {
        Some((survey, plan)) => _ = writeln!(text, "<pre>{}</pre>", escape(&inspect::text(survey, plan))),
        None => text.push_str("<p>The capture was not surveyed: nothing was left to decide.</p>\n"),
    }
    text + "</section>\n"
}

/// Table of the times by stage.
pub fn times(seconds: &Seconds) -> String {
    let all = [("loading", Some(seconds.load)), ("training", seconds.train), ("measuring", Some(seconds.eval))];
    let rows = all.into_iter().filter_map(|(what, time)| Some(vec![what.to_owned(), format!("{:.2}", time?)]));
    format!("<section>\n<h2>Time</h2>\n{}</section>\n", table(&[("stage", ""), ("s", "number")], rows))
}

pub fn options(metrics: &Metrics) -> serde_json::Result<String> {
    let text = serde_json::to_string_pretty(&metrics.options)?;
    let seed = metrics.seed.map(|seed| format!("Seed {seed}. ")).unwrap_or_default();
    Ok(format!(
        "<section>\n<h2>Options</h2>\n<p>{seed}<code>{METRICS}</code> has them too.</p>\n<details><summary>all options</summary>\n\
         <pre>{}</pre>\n</details>\n</section>\n",
        escape(&text)
    ))
}

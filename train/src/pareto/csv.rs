//! `pareto.csv`: all measurements, a line per setting (RFC 4180).

use splat_model::accuracy::Judge;

use super::dials::Role;
use super::measure::SettingMeasurements;
use super::quartiles::Quartiles;

const HEADER: &str = "name,role,judged_by,turned,error_db,rms_error,max_error,psnr_db,ssim,gradient_error,\
    gradient_error_of,gradient_cosine,forward_ms_lower,forward_ms,forward_ms_upper,backward_ms_lower,backward_ms,\
    backward_ms_upper,step_ms_lower,step_ms,step_ms_upper,on_frontier\r\n";

/// Returns the file's text. `members` are the rows on the frontier of renders.
pub fn text(rows: &[SettingMeasurements], members: &[usize]) -> String {
    let mut text = HEADER.to_owned();
    for (i, row) in rows.iter().enumerate() {
        text.push_str(&line(row, members.contains(&i)));
        text.push_str("\r\n");
    }
    text
}

fn line(row: &SettingMeasurements, on_frontier: bool) -> String {
    let number = |value: Option<f64>| value.map(|value| format!("{value:.6e}")).unwrap_or_default();
    let candidate = &row.candidate;
    let role = match candidate.role {
        Role::Preset => "preset".into(),
        Role::Dial(name) => format!("dial {name}"),
        Role::Combination => "combination".into(),
    };
    let judge = if candidate.setting.judge() == Judge::Exact { "exact" } else { "photographs" };
    let accuracy = row.accuracy.as_ref();
    let mut fields = vec![candidate.name.clone(), role, judge.into(), candidate.setting.to_string()];
    fields.extend([row.error_db(), accuracy.map(|a| a.rms), accuracy.map(|a| a.max)].map(number));
    fields.extend([row.psnr_db, row.ssim].map(|score| number(Some(score))));
    fields.push(number(accuracy.map(|a| a.gradient_error)));
    fields.push(accuracy.map(|a| a.worst.to_owned()).unwrap_or_default());
    fields.push(number(accuracy.map(|a| a.gradient_cosine)));
    for Quartiles { lower, median, upper } in [row.times.forward, row.times.backward, row.times.step] {
        fields.extend([lower, median, upper].map(|ms| number(Some(ms))));
    }
    fields.push(if on_frontier { "1" } else { "0" }.into());
    fields.iter().map(|field| quoted(field)).collect::<Vec<_>>().join(",")
}

fn quoted(field: &str) -> String {
    if field.contains([',', '"', '\n', '\r']) { format!("\"{}\"", field.replace('"', "\"\"")) } else { field.into() }
}

#[cfg(test)]
pub mod tests;

//! Settings to measure: presets, every value of every dial on its own, and combinations. The dials are the library's
//! table [`DIALS`]; a dial added there is measured here without further code.

use splat_model::accuracy::{DIALS, Dial, Judge, Preset, Setting};
use splat_op::RenderOptions;

/// Reason to measure a setting.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Role {
    Preset,
    /// One dial turned, the others at the standard.
    Dial(&'static str),
    /// Several dials turned.
    Combination,
}

#[derive(Clone, Debug)]
pub struct Candidate {
    /// Name in reports.
    pub name: String,
    pub role: Role,
    /// The dials that are turned.
    pub setting: Setting,
    pub options: RenderOptions,
}

impl Candidate {
    fn new(name: impl Into<String>, role: Role, setting: Setting, base: &RenderOptions) -> Self {
        Self { name: name.into(), role, options: setting.apply(*base), setting }
    }
}

/// Returns all settings around `base`, the standard with the scene's own model choices. `gpu`: with the dials that matter on a GPU only.
pub fn candidates(base: &RenderOptions, gpu: bool) -> Vec<Candidate> {
    let dials = || DIALS.iter().filter(move |dial| gpu || !dial.gpu_only);
    let presets =
        Preset::ALL.into_iter().map(|preset| Candidate::new(preset.name(), Role::Preset, preset.setting(), base));
    let mut all: Vec<Candidate> = presets.collect();
    for dial in dials() {
        // The base's own value would give the base again.
        let others = dial.values.iter().filter(|value| (value.set)(*base) != *base);
        all.extend(others.filter_map(|value| {
            let setting = Setting::new([(dial.name, value.name)]).ok()?;
            Some(Candidate::new(format!("{} {}", dial.name, value.name), Role::Dial(dial.name), setting, base))
        }));
    }
    let numerical = || dials().filter(|dial| dial.judge == Judge::Exact);
    let every = |which: fn(&Dial) -> Option<&'static splat_model::accuracy::DialValue>| {
        let turned = numerical().filter_map(move |dial| {
            let value = which(dial)?;
            ((value.set)(*base) != *base).then_some((dial.name, value.name))
        });
        turned.collect::<Vec<_>>()
    };
    let ends = [("all accurate", every(|dial| dial.values.first())), ("all coarse", every(|dial| dial.values.last()))];
    for (name, turned) in ends {
        if let Ok(setting) = Setting::new(turned) {
            all.push(Candidate::new(name, Role::Combination, setting, base));
        }
    }
    let mut seen: Vec<RenderOptions> = Vec::new();
    all.retain(|candidate| {
        let new = !seen.contains(&candidate.options);
        seen.push(candidate.options);
        new
    });
    all
}

#[cfg(test)]
mod tests;

//! Examines every WGSL module that the kernels' tests compile: its limits, its barriers, and its translations for the platforms
//! that no machine here has; with `--spirv FOLDER` it writes them there for the compilers of cards. The arguments are logs that CubeCL writes where `CUBECL_DEBUG_LOG` names a file; `.ci/run shaders`
//! makes them. Prints each finding, and fails if there is one.

mod cards;
mod flow;
mod limits;
mod log;
mod source;
mod target;

use std::collections::BTreeSet;
use std::process::ExitCode;
use std::{env, fs, io};

use naga::front::wgsl;

use crate::log::Modules;
use crate::target::{Outcome, TARGETS};

fn main() -> io::Result<ExitCode> {
    let mut files: Vec<String> = env::args().skip(1).collect();
    let folder = (files.len() > 1 && files[0] == "--spirv").then(|| files.drain(..2).nth(1)).flatten();
    if files.is_empty() {
        eprintln!("usage: splat-shaders [--spirv FOLDER] LOG...");
        return Ok(ExitCode::from(2));
    }
    let logs = files.iter().map(fs::read_to_string).collect::<io::Result<Vec<String>>>()?;
    let modules: Modules = logs.iter().flat_map(|log| log::modules(log)).collect();
    if let Some(folder) = folder {
        cards::write(&modules, folder.as_ref())?;
        return Ok(ExitCode::SUCCESS);
    }
    let mut findings = examine(&modules);
    let compiled: BTreeSet<&str> = modules.values().map(|name| log::function(name)).collect();
    for kernel in source::kernels()? {
        if !compiled.contains(kernel.as_str()) {
            findings.insert(format!("{kernel}: no kernel test compiles it"));
        }
    }
    for finding in &findings {
        println!("{finding}");
    }
    println!("{} findings", findings.len());
    Ok(if findings.is_empty() { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}

/// Prints how many modules each target takes, and returns what is wrong with them.
fn examine(modules: &Modules) -> BTreeSet<String> {
    let mut findings = BTreeSet::new();
    let (mut parsed, mut keys) = (Vec::new(), BTreeSet::new());
    for (text, name) in modules {
        match wgsl::parse_str(text) {
            Ok(module) => {
                let faults = limits::excess(&module).into_iter().chain(flow::barriers_at_fault(&module));
                findings.extend(faults.map(|fault| format!("{name}: {fault}")));
                // CubeCL names an entry point after the key of its cache of compiled kernels.
                for entry in &module.entry_points {
                    if !keys.insert(entry.name.clone()) {
                        findings.insert(format!("{name}: another form has the key {}", entry.name));
                    }
                }
                parsed.push((*name, module));
            }
            Err(error) => {
                findings.insert(format!("{name}: not WGSL: {}", error.emit_to_string(text)));
            }
        }
    }
    for target in &TARGETS {
        let (mut taken, mut without) = (BTreeSet::new(), BTreeSet::new());
        let mut translated = 0;
        for (name, module) in &parsed {
            match target.translate(module) {
                Outcome::Translated => {
                    translated += 1;
                    taken.insert(*name);
                }
                Outcome::LacksFeature => {
                    without.insert(*name);
                }
                Outcome::Refused(why) => {
                    findings.insert(format!("{name}: {}: {why}", target.name));
                }
            }
        }
        println!("{}: {translated} of {} modules, {} kernels", target.name, modules.len(), taken.len());
        for kernel in without.difference(&taken) {
            findings.insert(format!("{kernel}: no form without the features that {} lacks", target.name));
        }
    }
    findings
}

#[cfg(test)]
mod tests {
    use super::*;

    fn findings(modules: &[&str]) -> BTreeSet<String> {
        examine(&modules.iter().map(|text| (*text, "k")).collect())
    }

    const PLAIN: &str = "@group(0) @binding(0) var<storage, read_write> a: array<u32>;\n\
                         @compute @workgroup_size(64) fn k(@builtin(global_invocation_id) at: vec3<u32>) { a[at.x] = 1u; }";
    const ATOMIC: &str = "@group(0) @binding(0) var<storage, read_write> a: array<atomic<f32>>;\n\
                          @compute @workgroup_size(64) fn k(@builtin(global_invocation_id) at: vec3<u32>) { \
                          atomicAdd(&a[at.x], 1.0f); }";

    #[test]
    fn a_plain_kernel_has_no_finding() {
        assert_eq!(findings(&[PLAIN]), BTreeSet::new());
    }

    #[test]
    fn a_kernel_that_only_some_targets_take_needs_another_form() {
        let alone = findings(&[ATOMIC]);
        assert_eq!(alone.len(), 3, "{alone:?}");
        assert!(!alone.iter().any(|finding| finding.contains("MSL 3.0")), "{alone:?}");
        assert_eq!(findings(&[&ATOMIC.replace("fn k(", "fn other("), PLAIN]), BTreeSet::new());
        let same = findings(&[ATOMIC, PLAIN]);
        assert!(
            same.len() == 1 && same.iter().all(|finding| finding.contains("another form has the key k")),
            "{same:?}"
        );
    }

    #[test]
    fn text_that_is_no_module_is_a_finding() {
        assert_eq!(findings(&["fn k( {"]).len(), 1);
    }
}

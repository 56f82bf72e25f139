use super::*;

#[test]
fn every_value_of_every_dial_is_measured_once() {
    let base = RenderOptions::standard().with_near(0.3);
    let all = candidates(&base, true);
    for dial in DIALS {
        for value in dial.values {
            let options = (value.set)(base);
            let count = all.iter().filter(|candidate| candidate.options == options).count();
            assert_eq!(count, 1, "{} {}", dial.name, value.name);
        }
    }
    assert!(all.iter().all(|candidate| candidate.options.near == 0.3));
    let names: Vec<&str> = all.iter().map(|candidate| candidate.name.as_str()).collect();
    assert_eq!(names[..3], ["fast", "standard", "exact"]);
    assert!(names.contains(&"all accurate") && names.contains(&"all coarse"));
}

#[test]
fn what_changes_nothing_on_a_cpu_is_not_measured_there() {
    let base = RenderOptions::standard();
    let all = candidates(&base, false);
    assert!(!all.iter().any(|candidate| candidate.name.contains("accumulation")));
    assert!(all.iter().any(|candidate| candidate.setting.judge() == Judge::Photographs));
}

#[test]
fn a_scene_with_a_choice_of_its_own_is_measured_around_it() {
    let base = RenderOptions::standard().with_antialias(true);
    let all = candidates(&base, false);
    assert!(all[..3].iter().all(|candidate| candidate.options.antialias));
    assert!(all.iter().any(|candidate| candidate.name == "antialias off"));
    assert!(!all.iter().any(|candidate| candidate.name == "antialias on"));
}

use super::*;

fn chart() -> Chart {
    let dot = |name: &str, role, ms: f64, y, member| {
        let x = Quartiles { lower: 0.9 * ms, median: ms, upper: 1.2 * ms };
        Dot { name: name.into(), role, x, y, member }
    };
    let dots = vec![
        dot("standard", Role::Preset, 10.0, 55.0, true),
        dot("alpha_min 8/255", Role::Dial, 6.0, 35.0, true),
        dot("hidden", Role::Dial, 11.0, 40.0, false),
        dot("both", Role::Combination, 5.0, 30.0, true),
    ];
    Chart { title: "time and error".into(), dots }
}

#[test]
fn points_and_names_are_shown() {
    let text = svg(&chart()).unwrap();
    assert!(text.starts_with("<svg") && text.trim_end().ends_with("</svg>"));
    assert_eq!(text.matches("<circle").count(), 4, "three points and the ring of a preset");
    for part in ["standard", "alpha_min 8/255", "both", "time and error", "time of a frame, ms"] {
        assert!(text.contains(part), "{part}");
    }
    assert!(!text.contains("hidden"), "a name that is not worth its place");
}

#[test]
fn names_leave_each_other_room() {
    let all = chart();
    let named: Vec<&Dot> = all.dots.iter().collect();
    let found = beside(&[(300, 100), (302, 101), (301, 99), (980, 300)], &named);
    assert_eq!(found[0], (312, 92));
    for (i, a) in found.iter().enumerate() {
        for (b, dot) in found[..i].iter().zip(&named) {
            let apart = (a.1 - b.1).abs() >= 16 || a.0 >= b.0 + 8 * dot.name.len() as i32 || a.0 < b.0;
            assert!(apart, "{found:?}");
        }
    }
    assert!(found[3].0 < 980, "a name at the border is written to the left: {found:?}");
}

#[test]
fn one_point_or_none_can_be_drawn() {
    for dots in [Vec::new(), chart().dots[..1].to_vec()] {
        let chart = Chart { dots, ..chart() };
        assert!(svg(&chart).unwrap().contains("</svg>"));
    }
}

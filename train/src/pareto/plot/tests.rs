use super::*;

fn chart() -> Chart {
    let dot =
        |name: &str, mark, ms: f64, y, member| Dot { name: name.into(), mark, x: [0.9 * ms, ms, 1.2 * ms], y, member };
    let dots = vec![
        dot("standard", DotMark::Preset, 10.0, 55.0, true),
        dot("alpha_min 8/255", DotMark::Dial, 6.0, 35.0, true),
        dot("hidden", DotMark::Dial, 11.0, 40.0, false),
        dot("both", DotMark::Combination, 5.0, 30.0, true),
    ];
    Chart { title: "time and error".into(), x: "ms a frame", y: "dB", dots }
}

#[test]
fn both_kinds_show_points_and_names() {
    let text = svg(&chart()).unwrap();
    assert!(text.starts_with("<svg") && text.trim_end().ends_with("</svg>"));
    assert_eq!(text.matches("<circle").count(), 4, "three points and the ring of a preset");
    for part in ["standard", "alpha_min 8/255", "both", "time and error", "ms a frame"] {
        assert!(text.contains(part), "{part}");
    }
    assert!(!text.contains("hidden"), "a name that is not worth its place");
    let picture = image::load_from_memory(&png(&chart()).unwrap()).unwrap().into_rgb8();
    assert_eq!(picture.dimensions(), SIZE);
    let count = |wanted: [u8; 3]| picture.pixels().filter(|pixel| pixel.0 == wanted).count();
    assert!(count([200, 80, 40]) > 300, "the frontier is not drawn");
    assert!(count([40, 90, 160]) > 20, "the other points are not drawn");
    // Letters are drawn in shades of grey.
    let dark = picture.pixels().filter(|pixel| pixel.0.iter().all(|&value| value < 120)).count();
    assert!(dark > 2000, "no letters: {dark}");
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
        assert!(!png(&chart).unwrap().is_empty());
    }
}

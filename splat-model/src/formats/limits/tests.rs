use super::*;

#[test]
fn limits_are_finite_and_have_the_effect_of_the_limit() {
    let opacity = |logit: f32| 1.0 / (1.0 + (-logit).exp());
    assert_eq!([f32::INFINITY, f32::NEG_INFINITY].map(|limit| logit(limit).is_finite()), [true; 2]);
    assert_eq!(opacity(logit(f32::INFINITY)), 1.0);
    assert!(opacity(logit(f32::NEG_INFINITY)) <= 2.0 * f32::MIN_POSITIVE);
    let thickness = log_scale(f32::NEG_INFINITY).exp();
    assert!(thickness > 0.0 && thickness <= 2.0 * f32::MIN_POSITIVE, "{thickness}");
    assert_eq!([logit(-3.5), log_scale(-3.5), log_scale(f32::INFINITY)], [-3.5, -3.5, f32::INFINITY]);
    assert!(logit(f32::NAN).is_nan() && log_scale(f32::NAN).is_nan());
}

#[test]
fn limits_are_read_from_text_too() {
    let names = ["x", "y", "z", "f_dc_0", "f_dc_1", "f_dc_2", "opacity", "scale_0", "scale_1", "scale_2"];
    let names = names.into_iter().chain(["rot_0", "rot_1", "rot_2", "rot_3"]);
    let properties: String = names.map(|name| format!("property float {name}\n")).collect();
    let rows = "1 2 3 0 0 0 inf -3 -3 -Infinity 1 0 0 0\n1 2 3 0 0 0 -INF -3 -3 -3 1 0 0 0\n1 2 3 0 0 0 nan -3 -3 -3 1 0 0 0\n";
    let read = |extra: &str, rows: &str| {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("scene.ply");
        let header =
            format!("ply\nformat ascii 1.0\nelement vertex {}\n{properties}{extra}end_header\n", rows.lines().count());
        std::fs::write(&path, header + rows).unwrap();
        crate::ply::read(&path).map(|(rows, _)| rows)
    };
    let found = read("", rows).unwrap();
    assert_eq!(found.logit_opacities[..2], [logit(f32::INFINITY), logit(f32::NEG_INFINITY)]);
    assert_eq!(found.log_scales[0], [-3.0, -3.0, log_scale(f32::NEG_INFINITY)]);
    assert_eq!([0, 1, 2].map(|row| found.is_usable(row)), [true, true, false]);
    // A word that is no number of the property's type stays an error.
    for bad in ["none", "inf", "1.5"] {
        let row = format!("1 2 3 0 0 0 inf -3 -3 -3 1 0 0 0 {bad}\n");
        assert!(read("property int label\n", &row).is_err(), "{bad}");
    }
}

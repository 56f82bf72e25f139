//! RealityScan.

use super::*;

const HEADER: &str = "#name,x,y,alt,heading,pitch,roll,f,px,py,k1,k2,k3,k4,t1,t2";

/// A line for each camera. The angles are those of `Rz(−heading) Rx(pitch) Ry(roll)`.
fn lines() -> String {
    let line = |(i, pose): (usize, DMat4)| {
        let (of, at) = (DMat3::from_mat4(pose), pose.w_axis);
        let pitch = of.y_axis.z.asin().to_degrees();
        let heading = of.y_axis.x.atan2(of.y_axis.y).to_degrees();
        let roll = (-of.x_axis.z).atan2(of.z_axis.z).to_degrees();
        let lens = "31.5,0.0125,-0.01875,-0.05,0.02,-0.004,0,0.001,-0.002";
        format!("{i}.png,{:?},{:?},{:?},{heading:?},{pitch:?},{roll:?},{lens}\n", at.x, at.y, at.z)
    };
    poses().into_iter().enumerate().map(line).collect()
}

/// The model of the articles: `f` for 36 mm along the longer side, Brown's radial terms, `t1` for r² + 2x².
fn projected(cam: DVec3) -> DVec2 {
    let [k1, k2, k3, t1, t2] = [-0.05, 0.02, -0.004, 0.001, -0.002];
    let DVec2 { x, y } = cam.truncate() / cam.z;
    let r2 = x * x + y * y;
    let radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3));
    let bent = DVec2::new(
        x * radial + t1 * (r2 + 2.0 * x * x) + 2.0 * t2 * x * y,
        y * radial + t2 * (r2 + 2.0 * y * y) + 2.0 * t1 * x * y,
    );
    bent * (31.5 * 80.0 / 36.0) + DVec2::new(0.0125, -0.01875) * 80.0 + DVec2::from(SIZE) / 2.0
}

#[test]
fn cameras_of_realityscan_are_where_it_had_them() {
    let newer = "#name,x,y,alt,yaw,pitch,roll,f_35mm,px_norm,py_norm,k1,k2,k3,k4,t1,t2";
    for (header, before) in [(HEADER, ""), (newer, "#cameras 3\r\n")] {
        let text = format!("{before}{header}\r\n{}\r\n", lines());
        let pictures = [("photos/0.png", ""), ("photos/1.png", ""), ("photos/2.png", "")];
        let root = folder(&[&[("export.csv", text.as_str())][..], &pictures].concat());
        let capture = Capture::load(root.path()).unwrap();
        assert_eq!((capture.format, names(&capture)), ("RealityScan", pictures.map(|(name, _)| name).to_vec()));
        assert_shows(&capture, |_, cam| projected(cam));
        let lens =
            r#""fl_x": 70, "cx": 41, "cy": 28.5, "k1": -0.05, "k2": 0.02, "k3": -0.004, "p1": -0.002, "p2": 0.001,"#;
        assert_same(&capture, &reference(lens));
    }
}

#[test]
fn angles_are_those_of_a_compass_and_a_plumb_line() {
    let text = format!("{}\na.png,1,2,3,90,90,0,36\nb.png,1,2,3,0,0,0,36\n", &HEADER[..HEADER.find(",px").unwrap()]);
    let root = folder(&[("a.csv", &text), ("a.png", ""), ("b.png", "")]);
    let capture = Capture::load(root.path()).unwrap();
    let axes =
        [0, 1].map(|view: usize| [0, 1, 2].map(|row| capture.views[view].cam_from_world.matrix3.row(row).round()));
    // Right, down and ahead in the world, whose +x is east, +y north and +z up.
    assert_eq!(axes[0], [DVec3::NEG_Y, DVec3::NEG_Z, DVec3::X], "to the east");
    assert_eq!(axes[1], [DVec3::X, DVec3::NEG_Y, DVec3::NEG_Z], "down, with north on top");
    assert_eq!(capture.views[0].cam_from_world.inverse().translation.round(), DVec3::new(1.0, 2.0, 3.0));
}

#[test]
fn damaged_files_of_realityscan_are_refused() {
    let text = format!("{HEADER}\n0.png,1,2,3,4,5,6,31.5,0.0125,0.01,-0.05,0.02,0,0,0.001,-0.002\n");
    let files = [("a.csv", text.as_str()), ("0.png", "")];
    for (from, to, parts) in [
        (",31.5,", ",f,", &["camera on line 2", "`f` is \"f\"", "Export"][..]),
        (",31.5,", ",0,", &["(\"0.png\")", "`fl_x` is 0"]),
        (",4,5,", ",nan,5,", &["(\"0.png\")", "`transform_matrix`", "NaN"]),
        (",1,2,3,", ",1,2,1e300,", &["`transform_matrix`", "1e300"]),
        ("6,31.5,0.0125,0.01,-0.05,0.02,0,0,0.001,-0.002", "6", &["line 2", "`values` is 7", "16, as in the header"]),
        ("0.02,0,0,", "0.02,0,0.1,", &["`k4` is 0.1", "undistorted"]),
        ("-0.05", "inf", &["`k1` is inf"]),
        ("0.png", "../0.png", &["`file_path`", "../0.png"]),
        ("0.png", "7.png", &["1 of 1 photographs", "7.png"]),
        ("0.png", "", &["`file_path`"]),
        ("heading", "omega", &["line 2", "`heading` is missing", "Export"]),
        ("0.png,1,2", "\n0.png", &["line 3", "`values` is 14"]),
        ("\n0.png", "\n#", &["lists no images"]),
    ] {
        assert_refused(&files, 0, from, to, parts);
    }
}

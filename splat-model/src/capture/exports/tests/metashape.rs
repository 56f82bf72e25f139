//! Metashape.

use super::*;

/// A chunk of the world, as `<transform>`: turned, moved and three times as large.
const SCALE: f64 = 0.25;

fn to_world() -> (DMat3, DVec3) {
    (DMat3::from_axis_angle(DVec3::new(0.3, -1.0, 2.0).normalize(), 1.9), DVec3::new(5.0, -7.0, 2.0))
}

fn numbers(rows: &[f64]) -> String {
    rows.iter().map(|number| format!("{number:?}")).collect::<Vec<_>>().join(" ")
}

const LENS: &str = "<resolution width=\"80\" height=\"60\"/><f>71.5</f><cx>1</cx><cy>-1.5</cy><b1>-1.5</b1><k1>-0.05</k1><k2>0.02</k2>\
                    <k3>-0.004</k3><p1>0.001</p1><p2>-0.002</p2>";

/// A document with three cameras of a sensor, and one that is not aligned. The transform is that of the chunk, or else of its component.
fn document(kind: &str, in_chunk: bool) -> String {
    let (turn, at) = to_world();
    let transform = format!(
        "<transform><rotation locked=\"true\">{}</rotation><translation>{}</translation><scale>{SCALE}</scale></transform>",
        numbers(&turn.transpose().to_cols_array()),
        numbers(&at.to_array())
    );
    let components = format!("<components><component id=\"7\">{transform}<partition/></component></components>");
    let camera = |(i, pose): (usize, DMat4)| {
        let cam = pose * flip();
        let turned = turn.transpose() * DMat3::from_mat4(cam);
        let centre = turn.transpose() * (cam.w_axis.truncate() - at) / SCALE;
        let matrix = DMat4::from_cols(
            turned.x_axis.extend(0.0),
            turned.y_axis.extend(0.0),
            turned.z_axis.extend(0.0),
            centre.extend(1.0),
        );
        let text = numbers(&matrix.transpose().to_cols_array());
        format!(
            "<camera id=\"{i}\" sensor_id=\"1\" component_id=\"7\" label=\"DSC {i}\"><transform>{text}</transform></camera>\n"
        )
    };
    let cameras: String = poses().into_iter().enumerate().map(camera).collect();
    format!(
        "<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n<document version=\"2.0.0\"><chunk label=\"Chunk 1\" enabled=\"true\">\n\
         <sensors next_id=\"2\"><sensor id=\"1\" label=\"a\" type=\"{kind}\"><resolution width=\"80\" height=\"60\"/>\
         <calibration type=\"{kind}\" class=\"initial\"><f>9</f></calibration>\
         <calibration type=\"{kind}\" class=\"adjusted\">{LENS}</calibration></sensor></sensors>{}\n\
         <cameras><group label=\"g\">{cameras}</group><camera id=\"9\" sensor_id=\"1\" label=\"lost\"/></cameras>{}</chunk></document>",
        if in_chunk { "" } else { &components },
        if in_chunk { &transform } else { "" }
    )
}

const PICTURES: [(&str, &str); 3] = [("images/DSC 0.JPG", ""), ("images/dsc 1.jpg", ""), ("images/DSC 2.png", "")];

/// The equations of the manual for frame and fisheye cameras.
fn projected(kind: &str, cam: DVec3) -> DVec2 {
    let [f, cx, cy, b1, k1, k2, k3, p1, p2] = [71.5, 1.0, -1.5, -1.5, -0.05, 0.02, -0.004, 0.001, -0.002];
    let slope = cam.truncate() / cam.z;
    let r0 = slope.length();
    let DVec2 { x, y } = if kind == "fisheye" { slope * (r0.atan() / r0) } else { slope };
    let r2 = x * x + y * y;
    let radial = 1.0 + k1 * r2 + k2 * r2 * r2 + k3 * r2 * r2 * r2;
    let x_bent = x * radial + (p1 * (r2 + 2.0 * x * x) + 2.0 * p2 * x * y);
    let y_bent = y * radial + (p2 * (r2 + 2.0 * y * y) + 2.0 * p1 * x * y);
    DVec2::new(80.0 * 0.5 + cx + x_bent * f + x_bent * b1, 60.0 * 0.5 + cy + y_bent * f)
}

#[test]
fn cameras_of_metashape_show_what_its_manual_says() {
    let ply = "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nproperty float z\nend_header\n1 2 3\n";
    let lens = r#""fl_x": 70, "fl_y": 71.5, "cx": 41, "cy": 28.5, "k1": -0.05, "k2": 0.02, "k3": -0.004, "p1": -0.002, "p2": 0.001,"#;
    for (kind, model) in [("frame", "OPENCV"), ("fisheye", "THIN_PRISM_FISHEYE")] {
        for in_chunk in [false, true] {
            let text = document(kind, in_chunk);
            let root = folder(&[&[("any.xml", text.as_str()), ("points.ply", ply)][..], &PICTURES].concat());
            let capture = Capture::load(root.path()).unwrap();
            assert_eq!(capture.format, "Metashape");
            assert_eq!(names(&Capture::load(&root.path().join("any.xml")).unwrap()), names(&capture));
            assert_eq!(names(&capture), ["images/DSC 0.JPG", "images/DSC 2.png", "images/dsc 1.jpg"]);
            assert_eq!(capture.points.positions, [[1.0, 2.0, 3.0]]);
            let notes = capture.remarks.join("\n");
            assert_says(&notes, &["1 cameras", "not aligned", "\"lost\"", "points.ply"]);
            let mut capture = capture;
            capture.views.swap(1, 2);
            assert_shows(&capture, |_, cam| projected(kind, cam));
            assert_same(&capture, &reference(&format!(r#""camera_model": "{model}", {lens}"#)));
        }
    }
    // A chunk without a transform is its own world.
    let text = document("frame", true);
    let without = [&text[..text.rfind("<transform>").unwrap()], "</chunk></document>"].concat();
    let root = folder(&[&[("any.xml", without.as_str())][..], &PICTURES].concat());
    let centre = Capture::load(root.path()).unwrap().views[0].cam_from_world.inverse().translation;
    let (turn, at) = to_world();
    let expected = turn.transpose() * (poses()[0].w_axis.truncate() - at) / SCALE;
    assert!(centre.distance(expected) < 1e-9, "{centre} instead of {expected}");
}

#[test]
fn panoramas_of_metashape_are_cut() {
    let text = document("spherical", false)
        .replace("<resolution width=\"80\" height=\"60\"/>", "<resolution width=\"80\" height=\"40\"/>");
    let root = folder(&[&[("a.xml", text.as_str())][..], &PICTURES].concat());
    let capture = Capture::load(root.path()).unwrap();
    assert_eq!((capture.views.len(), capture.views[0].file_size()), (18, [80, 40]));
    let ahead = (poses()[0] * flip()).transform_vector3(DVec3::Z);
    assert!((capture.views[0].cam_from_world.matrix3 * ahead).distance(DVec3::Z) < 1e-9);
}

#[test]
fn damaged_files_of_metashape_are_refused() {
    let text = document("frame", false);
    let files = [&[("a.xml", text.as_str())][..], &PICTURES].concat();
    let transform = text.split("label=\"DSC 0\"><transform>").nth(1).unwrap().split('<').next().unwrap();
    let scaled = transform.split(' ').map(|number| format!("{:?}", 2.0 * number.parse::<f64>().unwrap()));
    let scaled: Vec<String> = scaled.collect();
    let scaled = [&scaled[..15].join(" "), " 1"].concat();
    let deep = "<a>".repeat(100_000);
    let long = format!("</{}>", "x".repeat(10_000));
    for (from, to, parts) in [
        (transform, "1 2 3", &["frame 0 (\"DSC 0\")", "`transform` is \"1 2 3\"", "16 numbers"][..]),
        (transform, &transform.replacen(' ', " nan ", 1), &["`transform`", "16 numbers"]),
        (transform, &["nan", &transform[transform.find(' ').unwrap()..]].concat(), &["`transform_matrix`", "NaN"]),
        (transform, &scaled, &["frame 0 (\"images/DSC 0.JPG\")", "lengths 2.0000, 2.0000, 2.0000"]),
        (transform, &format!("{} 2", &transform[..transform.rfind(' ').unwrap()]), &["2 as its last row"]),
        ("<scale>0.25", "<scale>0", &["`scale` is 0", "positive"]),
        ("<rotation locked=\"true\">", "<rotation locked=\"true\">9 ", &["`rotation`", "9 numbers"]),
        ("<resolution width=\"80\"", "<resolution width=\"0\"", &["`w` is 0"]),
        ("<resolution width=\"80\"", "<resolution", &["`width`", "resolution"]),
        ("<f>71.5", "<f>nan", &["`f` is NaN", "positive"]),
        ("<f>71.5", "<f>-71.5", &["`f` is -71.5"]),
        ("<b1>", "<b2>0.3</b2><b1>", &["`b2` is 0.3", "Fix it at 0"]),
        ("<k1>", "<k4>0.3</k4><k1>", &["`k4` is 0.3", "Metashape"]),
        ("<p1>", "<p3>0.3</p3><p1>", &["`p3` is 0.3", "undistorted"]),
        ("type=\"frame\"", "type=\"cylindrical\"", &["`type` is \"cylindrical\"", "fisheye or spherical"]),
        ("sensor id=\"1\"", "sensor id=\"2\"", &["`sensor_id` is \"1\""]),
        ("label=\"DSC 0\"", "label=\"DSC 5\"", &["1 of 3 photographs", "DSC 5"]),
        ("label=\"DSC 0\"", "label=\"DSC 1\"", &["`file_path`", "dsc 1.jpg\" again"]),
        ("label=\"DSC 0\"", "label=\"../DSC 0\"", &["`file_path`", "../DSC 0"]),
        ("<group label=\"g\">", "<group label=\"g\"></group>", &["no XML", "group"]),
        ("<group label=\"g\">", &deep, &["no XML"]),
        ("<group label=\"g\">", &long, &["no XML"]),
        ("<?xml version=\"1.0\" encoding=\"UTF-8\"?>", "<!DOCTYPE a [<!ENTITY b \"c\">]>", &["no XML"]),
    ] {
        assert_refused(&files, 0, from, to, parts);
    }
    let calibration = text.find("<calibration").unwrap()..text.rfind("</sensor>").unwrap();
    assert_refused(&files, 0, &text[calibration], "", &["`calibration` is missing"]);
    // Elements as deep as a file allows are read, and cameras that are not enabled left out.
    let closed = [&deep, &*"</a>".repeat(100_000), "<group label=\"g\">"].concat();
    let nested = text.replacen("<group label=\"g\">", &closed, 1).replacen(
        "<camera id=\"0\"",
        "<camera id=\"0\" enabled=\"0\"",
        1,
    );
    let mut files = files.clone();
    files[0].1 = &nested;
    assert_eq!(names(&Capture::load(folder(&files).path()).unwrap()), ["images/DSC 2.png", "images/dsc 1.jpg"]);
}

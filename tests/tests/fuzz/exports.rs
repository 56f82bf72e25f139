//! The readers of captures that other programs export.

use std::fs;
use std::path::{Path, PathBuf};

use splat_demo::{self as demo, DemoOptions};
use splat_model::capture::Capture;

use super::engine::{FuzzTarget, folder};
use super::split;
use super::targets::{bucket, judge_message, shape};
use super::transforms::judge;

/// A folder for each format, one of whose files is the input. The first byte of the input says which.
pub struct Exports {
    name: &'static str,
    folder: PathBuf,
    /// Index of the format of the input.
    format: usize,
}

/// The file of each format, and its folder of pictures.
const FORMATS: [(&str, &str); 4] = [
    ("polycam/keyframes/corrected_cameras/0001.json", "polycam/keyframes/corrected_images"),
    ("record3d/metadata", "record3d/rgbd"),
    ("metashape/cameras.xml", "metashape/images"),
    ("realityscan/cameras.csv", "realityscan/images"),
];

const POLYCAM: &str = r#"{"fx": 50, "fy": 51.5, "cx": 20, "cy": 15, "width": 40, "height": 30, "neighbors": [1, 2], "blur_score": 8.5,
 "t_00": 0, "t_01": 0, "t_02": 1, "t_03": 4e6, "t_10": 1, "t_11": 0, "t_12": 0, "t_13": 2, "t_20": 0, "t_21": 1, "t_22": 0, "t_23": -3}"#;

const RECORD3D: &str = r#"{"h": 30, "w": 40, "fps": 60, "K": [50, 0, 0, 0, 51.5, 0, 20, 15, 1], "initPose": [0, 0, 0, 1, 0, 0, 0],
 "perFrameIntrinsicCoeffs": [[50, 51.5, 20, 15]], "poses": [[0.5, 0.5, -0.5, 0.5, 4e6, 2, 3], [0, 0, 0.6, -0.8, 1, 2, 3]]}"#;

const METASHAPE: &str = r#"<?xml version="1.0" encoding="UTF-8"?>
<document version="2.0.0"><chunk label="Chunk 1" enabled="true"><sensors next_id="2"><sensor id="1" type="frame">
<resolution width="40" height="30"/><calibration type="frame" class="adjusted"><f>50.5</f><cx>1</cx><cy>-2</cy><b1>0.5</b1><k1>0.01</k1>
<k2>-0.02</k2><k3>0.001</k3><p1>1e-3</p1><p2>-2e-3</p2></calibration></sensor></sensors><components><component id="7"><transform>
<rotation>0 0 1 1 0 0 0 1 0</rotation><translation>4e6 0 0</translation><scale>0.25</scale></transform></component></components>
<cameras><group label="a"><camera id="0" sensor_id="1" component_id="7" label="0000">
<transform>1 0 0 1.5 0 1 0 -2 0 0 1 3 0 0 0 1</transform></camera></group>
<camera id="1" sensor_id="1" label="0001.PNG" enabled="1"><transform>0 0 1 4e6 1 0 0 2 0 1 0 3 0 0 0 1</transform></camera>
<camera id="2" sensor_id="1" label="lost"/></cameras><transform><scale>1</scale></transform></chunk></document>"#;

const REALITYSCAN: &str = "#cameras 2\n#name,x,y,alt,heading,pitch,roll,f,px,py,k1,k2,k3,k4,t1,t2\n\
    0000.png,4e6,-2,3,170.5,85.25,-22.5,31.5,-0.001,2e-3,0.01,-0.02,0.001,0,1e-3,0\nimages\\0001.png,4000001,0,1,0,0,0,31.5,0,0,0,0,0,0,0,0\n";

impl Exports {
    pub fn new(name: &'static str) -> Self {
        let (folder, demo) = (folder(name), folder(&format!("{name}_demo")));
        let options = DemoOptions { width: 40, height: 30, views: 2, points: 1, ..DemoOptions::default() };
        demo::write(&demo, &options).expect("the target folder can be written to");
        let make = |path: &Path| fs::create_dir_all(path).expect("the target folder can be written to");
        for (file, pictures) in FORMATS {
            let (file, pictures) = (folder.join(file), folder.join(pictures));
            make(file.parent().expect("a file in a folder"));
            make(&pictures);
            for (from, to) in [("0000.png", "0000.png"), ("0001.png", "0001.png"), ("0000.png", "0.jpg")] {
                fs::copy(demo.join("images").join(from), pictures.join(to)).expect("written above");
            }
        }
        fs::remove_dir_all(&demo).expect("written above");
        Self { name, folder, format: 0 }
    }
}

impl FuzzTarget for Exports {
    fn name(&self) -> &'static str {
        self.name
    }

    fn seeds(&self) -> Vec<Vec<u8>> {
        let fisheye = METASHAPE.replace("\"frame\"", "\"fisheye\"");
        let spherical = METASHAPE.replace("\"frame\"", "\"spherical\"").replace("width=\"40\"", "width=\"60\"");
        let newer = REALITYSCAN.replace("heading", "yaw").replace(",f,px,py", ",f_35mm,px_norm,py_norm");
        let texts = [
            (0, POLYCAM),
            (1, RECORD3D),
            (2, METASHAPE),
            (2, &fisheye),
            (2, &spherical),
            (3, REALITYSCAN),
            (3, &newer),
        ];
        texts.map(|(format, text)| [&[format], text.as_bytes()].concat()).to_vec()
    }

    fn words(&self) -> &'static [&'static str] {
        &[
            "{",
            "}",
            "[",
            "]",
            "[[[[[[[[[[[[[[[[",
            ":",
            ",",
            "\"",
            "null",
            "NaN",
            "nan",
            "inf",
            "1e999",
            "1e308",
            "-1",
            "0",
            "\"poses\"",
            "\"K\"",
            "\"t_00\"",
            "<",
            ">",
            "</",
            "/>",
            "<camera label=\"0000\">",
            "<transform>",
            "</transform>",
            "<calibration>",
            "<!DOCTYPE a [<!ENTITY b \"&b;&b;\">]>",
            "&b;",
            "&#0;",
            "<![CDATA[",
            "<a xmlns=\"",
            "type=\"spherical\"",
            "<b2>1</b2>",
            "<k4>1</k4>",
            "#",
            "\n#name,",
            "../",
            "/etc/passwd",
            "\u{feff}",
        ]
    }

    fn split(&self, input: &[u8]) -> Vec<Vec<u8>> {
        let Some((first, rest)) = input.split_first() else { return Vec::new() };
        // Tags end where fields begin.
        let spaced = rest.split_inclusive(|byte| *byte == b'>');
        let mut fields = spaced.flat_map(split::text);
        let head = [&[*first], &fields.next().unwrap_or_default()[..]].concat();
        std::iter::once(head).chain(fields).collect()
    }

    fn place(&mut self, input: &[u8]) {
        self.format = usize::from(input.first().copied().unwrap_or_default()) % FORMATS.len();
        let file = self.folder.join(FORMATS[self.format].0);
        fs::write(file, input.get(1..).unwrap_or_default()).expect("the target folder can be written to");
    }

    fn read(&mut self) -> Result<String, String> {
        let file = FORMATS[self.format].0;
        let folder = self.folder.join(file.split('/').next().expect("a folder"));
        match Capture::load(&folder) {
            Ok(capture) => {
                judge(&capture)?;
                let (views, left_out) = (bucket(capture.views.len()), capture.remarks.len());
                let model = capture.views[0].intrinsics.model;
                Ok(format!("accepted: {} with 2^{views} views ({model:?}), {left_out} remarks", capture.format))
            }
            Err(error) => {
                let message = error.to_string();
                judge_message(&message, &folder)?;
                Ok(shape(&message, &folder))
            }
        }
    }
}

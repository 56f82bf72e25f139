//! Captures far from the origin or very small, from capture file to picture.
//!
//! The demo capture is written as a COLMAP model that is moved or scaled as a whole, loaded, turned into Gaussians, stored as PLY,
//! read again, rendered and differentiated by the photometric loss. The result must equal that of the capture at the origin.

use std::fs;
use std::path::Path;

use burn::tensor::{Device, Tensor};
use glam::DVec3;
use splat_demo::DemoOptions;
use splat_demo::write_model;
use splat_model::capture::Capture;
use splat_model::gaussians::Gaussians;
use splat_model::loss::{DEFAULT_LAMBDA, Truth, photometric};
use splat_model::optim::{near_plane, scene_extent};
use splat_model::{init, ply};
use splat_op::{Camera, Colour, Extras, RenderOptions, render};

use crate::case::{CaseOutcome, HardCase, MeasuredDeviation, TestDevice};
use crate::compare::{largest, relative_error};
use crate::scratch::{TemporaryFolder, demo, photographs};
use crate::tensors::host;

/// Options of the demo capture in all cases.
const DEMO: DemoOptions = DemoOptions { width: 48, height: 36, views: 4, points: 400, seed: 3, ..DemoOptions::PLAIN };

/// Direction in which captures are moved: not along an axis, and without round numbers.
const DIRECTION: [f64; 3] = [0.6123, -0.4871, 0.6228];

/// Largest error relative to the largest element of a picture or gradient. Positions and poses of a moved capture are
/// rounded to f32 at other values than those of the capture at the origin: by 6e-8 of a remaining offset of up to one unit,
/// beside Gaussians of 0.03 units, whose contributions at the cut of 1/255 then appear in other pixels.
const BOUND: f64 = 1e-4;

pub fn cases() -> Vec<HardCase> {
    let moved = |metres: f64, grain: &str| {
        HardCase::check(
            format!("capture {metres:e} m from the origin"),
            "geo-referenced coordinates leave no f32 digits for the details of the scene",
            move |place| judge(place, DVec3::from(DIRECTION) * metres, 1.0),
        )
        .hardness(format!("the spacing of f32 values there is {grain}; the bound is {BOUND:e} of the largest element"))
    };
    vec![
        moved(1e4, "1 mm"),
        moved(1e6, "6 cm"),
        moved(6.4e6, "0.5 m"),
        HardCase::check(
            "millimetre scene",
            "thresholds in scene units, above all the near plane, are larger than the scene",
            |place| judge(place, DVec3::ZERO, 1e-3),
        )
        .hardness(format!("4 mm from the cameras, near plane at 10 mm; the bound is {BOUND:e} of the largest element")),
        HardCase::check("millimetre scene 1e4 m from the origin", "both difficulties occur at once", |place| {
            judge(place, DVec3::from(DIRECTION) * 1e4, 1e-3)
        })
        .hardness(format!("the spacing of f32 values there is 1 mm; the bound is {BOUND:e} of the largest element")),
    ]
}

/// Pictures and gradients of a capture.
struct CaptureResult {
    pictures: Vec<f64>,
    /// Gradients of rotations, log scales, logits and colours, and of means in units of the scene's scale.
    gradients: Vec<Vec<f64>>,
    /// Origin of the scene, as stored in the PLY file.
    origin: DVec3,
}

fn judge(place: &TestDevice, offset: DVec3, scale: f64) -> CaseOutcome {
    let mut outcome = CaseOutcome::default();
    match (seen(place, DVec3::ZERO, 1.0), seen(place, offset, scale)) {
        (Ok(expected), Ok(found)) => {
            let error = relative_error(&found.pictures, &expected.pictures);
            outcome.forward = Some(MeasuredDeviation { error, used: error / BOUND });
            let pairs = found.gradients.iter().zip(&expected.gradients);
            let error = pairs.map(|(found, expected)| relative_error(found, expected)).fold(0.0, f64::max);
            outcome.gradient = Some(MeasuredDeviation { error, used: error / BOUND });
            let shown = largest(&expected.pictures) > 0.1;
            outcome.require(shown, || "nothing is in the pictures".into());
            for (what, score) in [("pictures", outcome.forward), ("gradients", outcome.gradient)] {
                let used = score.map_or(f64::NAN, |score| score.used);
                outcome.require(used <= 1.0, || format!("the {what} differ by {used:.2e} of {BOUND:e}"));
            }
            // The origin is the cameras' middle in whole units, or zero where that is no further away.
            let far = found.origin.distance(offset) <= 3.0 * scale + 1.0;
            outcome.require(far, || format!("the scene's file says it lies at {}, not {offset}", found.origin));
        }
        (Err(why), _) | (_, Err(why)) => outcome.failures.push(why),
    }
    outcome
}

/// Writes, loads, stores, reads, renders and differentiates a capture.
fn seen(place: &TestDevice, offset: DVec3, scale: f64) -> Result<CaptureResult, String> {
    let text = |error: &dyn std::error::Error| error.to_string();
    let scratch = TemporaryFolder::new().map_err(|error| text(&error))?;
    demo(scratch.path(), &DEMO).map_err(|error| text(&*error))?;
    move_model(scratch.path(), offset, scale)?;

    let capture = Capture::load(scratch.path()).map_err(|error| text(&error))?;
    let photos = photographs(&capture).map_err(|error| text(&error))?;
    let path = scratch.path().join("scene.ply");
    let mut rows = init::from_points(&capture.points);
    // Initial Gaussians are round, and their rotations have no gradient. The scales are changed so that they have.
    for (i, (log_scale, rotation)) in rows.log_scales.iter_mut().zip(&mut rows.rotations).enumerate() {
        log_scale[0] += 0.7;
        log_scale[2] -= 0.7;
        *rotation = [1.0, (i % 3) as f32 - 1.0, (i % 5) as f32 - 2.0, 0.5];
    }
    ply::write(&path, &rows, capture.origin).map_err(|error| text(&error))?;
    let (rows, origin) = ply::read(&path).map_err(|error| text(&error))?;
    if origin != capture.origin {
        return Err(format!("the origin {} was stored as {origin}", capture.origin));
    }
    let device = place.device.clone().autodiff();
    let gaussians = Gaussians::from_rows(&rows, &device).map_err(|error| text(&error))?;
    let splats = gaussians.splats();
    let centres: Vec<DVec3> = photos.iter().map(|photo| photo.cam_from_world.inverse().translation).collect();
    let options = RenderOptions::standard().with_near(near_plane(scene_extent(&centres)));
    let (mut pictures, mut loss) = (Vec::new(), Tensor::<1>::zeros([1], &device));
    for photo in &photos {
        let camera = Camera::new(photo.intrinsics, &photo.cam_from_world, &place.device);
        let image = render(&splats, &[camera], &Extras::default(), &options).map_err(|error| text(&error))?.colour;
        pictures.extend(host(image.clone()));
        let truth = Truth::new(photo.rgb_over([0.0; 3], &plain(&place.device)));
        loss = loss + photometric(image.squeeze_dim(0), &truth, DEFAULT_LAMBDA);
    }
    let grads = loss.backward();
    const TRACKED: &str = "every parameter is tracked";
    let means = gaussians.gradient("means", &grads).expect(TRACKED) * scale;
    let Colour::SphericalHarmonics(_) = splats.colour else { return Err("a scene has harmonics".into()) };
    let gradients = vec![
        host(means),
        host(gaussians.gradient("rotations", &grads).expect(TRACKED)),
        host(gaussians.gradient("log_scales", &grads).expect(TRACKED)),
        host(gaussians.gradient("logit_opacities", &grads).expect(TRACKED)),
        host(gaussians.gradient("sh", &grads).expect(TRACKED)),
    ];
    Ok(CaptureResult { pictures, gradients, origin })
}

fn plain(device: &Device) -> Device {
    device.clone().inner()
}

/// Scales and moves a capture's model: cameras in f64, as COLMAP stores them, and points in f64 too.
fn move_model(folder: &Path, offset: DVec3, scale: f64) -> Result<(), String> {
    let mut capture = Capture::load(folder).map_err(|error| error.to_string())?;
    for view in &mut capture.views {
        let pose = &mut view.cam_from_world;
        pose.translation = pose.translation * scale - pose.matrix3 * offset;
    }
    // The writer takes points in f32, so the points are written separately as text, in f64.
    write_model(folder, &capture.views, &Default::default(), &Default::default()).map_err(|error| error.to_string())?;
    let points = capture.points.positions.iter().zip(&capture.points.colours).enumerate();
    let line = |(i, (position, [r, g, b])): (usize, (&[f32; 3], &[u8; 3]))| {
        let [x, y, z] = (DVec3::from_array(position.map(f64::from)) * scale + offset).to_array();
        format!("{} {x:?} {y:?} {z:?} {r} {g} {b} 0\n", i + 1)
    };
    let model = folder.join("sparse").join("0");
    fs::remove_file(model.join("points3D.bin")).map_err(|error| error.to_string())?;
    fs::write(model.join("points3D.txt"), points.map(line).collect::<String>()).map_err(|error| error.to_string())
}

//! Scale from points that a user marked in photographs.

use std::path::Path;

use glam::{DMat3, DVec2, DVec3};

use super::{Scale, ScaleError};
use crate::capture::exif::Exif;
use crate::capture::{Capture, CaptureError, View};

/// Smallest angle between two rays to a point, degrees. Below it a pixel moves the point by more than a hundredth of its
/// distance.
const MIN_ANGLE_DEG: f64 = 1.0;

/// Largest distance of a mark from the projection of its point, as a share of the picture's longer side: beyond it two
/// photographs have different points.
const MAX_ERROR: f64 = 0.02;

/// Steps of Gauss-Newton; a few suffice from the point nearest to the rays.
const STEPS: usize = 10;

/// Marks in pictures as viewers show them, which are turned by EXIF's orientation, as marks in the stored pictures.
///
/// # Errors
/// A [`CaptureError`] if a marked photograph cannot be opened.
pub fn in_stored_pictures(capture: &Capture, marks: Vec<Mark>) -> Result<Vec<Mark>, CaptureError> {
    let stored = |mark: Mark| {
        let Some(view) = capture.views.iter().find(|view| view.name == mark.photograph) else { return Ok(mark) };
        let size = [view.intrinsics.width, view.intrinsics.height];
        Ok(Mark { at_px: Exif::read(&view.image_path)?.stored_from_shown(mark.at_px, size), ..mark })
    };
    marks.into_iter().map(stored).collect()
}

/// A point in a photograph.
#[derive(Clone, Debug, PartialEq)]
pub struct Mark {
    /// The point's name.
    pub name: String,
    /// The photograph's name, as [`View::name`].
    pub photograph: String,
    /// Position in the picture, px; the upper left corner is zero.
    pub at_px: DVec2,
}

/// Parses a file of marks: lines of `NAME PHOTOGRAPH X Y`, separated by white space or commas. Empty lines and lines that begin with
/// `#` are left out. A photograph's name may contain spaces.
///
/// # Errors
/// [`ScaleError::Line`] for any other line.
pub fn parse_marks(file: &Path, text: &str) -> Result<Vec<Mark>, ScaleError> {
    let lines = text.lines().enumerate().map(|(i, line)| (i + 1, line.trim()));
    lines
        .filter(|(_, line)| !line.is_empty() && !line.starts_with('#'))
        .map(|(line, found)| {
            parse_line(found).ok_or_else(|| ScaleError::Line { file: file.to_owned(), line, found: found.into() })
        })
        .collect()
}

fn parse_line(line: &str) -> Option<Mark> {
    let is_gap = |c: char| c.is_whitespace() || c == ',';
    let cut = |text: &str| text.rfind(is_gap).map(|at| (text[..at].trim_end_matches(is_gap).to_owned(), at + 1));
    let (name, rest) = line.split_once(is_gap)?;
    let rest = rest.trim_start_matches(is_gap);
    let (before_y, y) = cut(rest)?;
    let y: f64 = rest[y..].parse().ok()?;
    let (photograph, x) = cut(&before_y)?;
    let x: f64 = before_y[x..].parse().ok()?;
    let complete = !photograph.is_empty() && x.is_finite() && y.is_finite();
    complete.then(|| Mark { name: name.to_owned(), photograph, at_px: DVec2::new(x, y) })
}

/// The scale at which two marked points are `distance_m` apart, with marks in the stored pictures. Each is triangulated from all its marks: the point with the least sum of
/// squared distances in the pictures (Hartley and Zisserman 2004, section 12.3), by Gauss-Newton from the point nearest to the rays.
///
/// # Errors
/// A [`ScaleError`] if a point is not marked in two placed photographs from different sides, or its marks do not meet.
pub fn from_marks(capture: &Capture, marks: &[Mark], names: [&str; 2], distance_m: f64) -> Result<Scale, ScaleError> {
    if !super::is_scale(distance_m) {
        return Err(ScaleError::Distance(distance_m));
    }
    let [a, b] = names.map(|name| triangulated(capture, marks, name));
    let distance = a?.distance(b?);
    let metres_per_unit = distance_m / distance;
    if !super::is_scale(metres_per_unit) {
        return Err(ScaleError::Coincide(names[0].into(), names[1].into()));
    }
    let source = format!("the distance of {distance_m} m between the points `{}` and `{}`", names[0], names[1]);
    Ok(Scale { metres_per_unit, relative_deviation: None, source })
}

/// A marked point, world frame relative to the capture's origin.
fn triangulated(capture: &Capture, marks: &[Mark], name: &str) -> Result<DVec3, ScaleError> {
    let of_name: Vec<&Mark> = marks.iter().filter(|mark| mark.name == name).collect();
    let view = |mark: &&&Mark| capture.views.iter().find(|view| view.name == mark.photograph);
    let seen: Vec<(&View, &Mark)> = of_name.iter().filter_map(|mark| Some((view(&mark)?, *mark))).collect();
    let unplaced: Vec<String> =
        of_name.iter().filter(|mark| view(mark).is_none()).map(|mark| mark.photograph.clone()).collect();
    if seen.len() < 2 {
        return Err(ScaleError::TooFewMarks { name: name.into(), placed: seen.len(), unplaced });
    }
    let rays: Vec<(DVec3, DVec3)> = seen.iter().map(|(view, mark)| ray(view, mark.at_px)).collect();
    let angle = |a: DVec3, b: DVec3| a.cross(b).length().atan2(a.dot(b)).to_degrees();
    let angles = rays.iter().flat_map(|a| rays.iter().map(move |b| angle(a.1, b.1)));
    let angle_deg = angles.fold(0.0, f64::max);
    if !(angle_deg >= MIN_ANGLE_DEG) {
        return Err(ScaleError::Parallel { name: name.into(), angle_deg, expected_deg: MIN_ANGLE_DEG });
    }
    let point = refined(nearest(&rays), &seen);
    let error = |(view, mark): &(&View, &Mark)| {
        let longer = view.intrinsics.width.max(view.intrinsics.height) as f64;
        let error_px = residual(view, mark, point).map_or(f64::INFINITY, DVec2::length);
        (error_px, MAX_ERROR * longer, mark.photograph.clone())
    };
    match seen.iter().map(error).max_by(|a, b| (a.0 / a.1).total_cmp(&(b.0 / b.1))) {
        Some((error_px, expected_px, photograph)) if !(error_px <= expected_px) => {
            Err(ScaleError::Disagree { name: name.into(), photograph, error_px, expected_px })
        }
        _ => Ok(point),
    }
}

/// Centre and unit direction of the ray through a pixel, world frame.
fn ray(view: &View, at_px: DVec2) -> (DVec3, DVec3) {
    let world_from_cam = view.cam_from_world.matrix3.transpose();
    let centre = -(world_from_cam * view.cam_from_world.translation);
    (centre, (world_from_cam * view.intrinsics.cam_from_px(at_px)).normalize())
}

/// The point with the least sum of squared distances from the rays. They are not all parallel.
fn nearest(rays: &[(DVec3, DVec3)]) -> DVec3 {
    let across = |direction: DVec3| DMat3::IDENTITY - outer(direction, direction);
    let normal = rays.iter().fold(DMat3::ZERO, |sum, &(_, direction)| sum + across(direction));
    let target = rays.iter().fold(DVec3::ZERO, |sum, &(centre, direction)| sum + across(direction) * centre);
    normal.inverse() * target
}

fn outer(a: DVec3, b: DVec3) -> DMat3 {
    DMat3::from_cols(a * b.x, a * b.y, a * b.z)
}

/// Projection minus mark, px; `None` where the camera does not see the point.
fn residual(view: &View, mark: &Mark, point: DVec3) -> Option<DVec2> {
    Some(view.intrinsics.px_from_cam(view.cam_from_world.transform_point3(point))? - mark.at_px)
}

fn refined(mut point: DVec3, seen: &[(&View, &Mark)]) -> DVec3 {
    let cost = |point| seen.iter().map(|(view, mark)| Some(residual(view, mark, point)?.length_squared())).sum();
    let Some(mut least): Option<f64> = cost(point) else { return point };
    for _ in 0..STEPS {
        let Some(step) = step(point, seen) else { break };
        match cost(point - step) {
            Some(cost) if cost < least => (point, least) = (point - step, cost),
            _ => break,
        }
    }
    point
}

/// A step of Gauss-Newton, with central differences: lenses have their derivatives in kernels only.
fn step(point: DVec3, seen: &[(&View, &Mark)]) -> Option<DVec3> {
    let (mut normal, mut gradient) = (DMat3::ZERO, DVec3::ZERO);
    for (view, mark) in seen {
        let small = 1e-5 * point.distance(ray(view, mark.at_px).0).max(f64::MIN_POSITIVE);
        let along = |axis: DVec3| {
            let [ahead, behind] = [small, -small].map(|step| residual(view, mark, point + step * axis));
            Some((ahead? - behind?) / (2.0 * small))
        };
        let [x, y, z] = [along(DVec3::X)?, along(DVec3::Y)?, along(DVec3::Z)?];
        let here = residual(view, mark, point)?;
        for (row, error) in [(DVec3::new(x.x, y.x, z.x), here.x), (DVec3::new(x.y, y.y, z.y), here.y)] {
            normal += outer(row, row);
            gradient += error * row;
        }
    }
    let step = normal.inverse() * gradient;
    step.is_finite().then_some(step)
}

#[cfg(test)]
mod tests {
    use splat_demo::{self as demo, DemoOptions};
    use crate::capture::testing::assert_says;

    use super::*;

    fn capture(lens: bool) -> Capture {
        let folder = tempfile::tempdir().unwrap();
        let options = DemoOptions { views: 6, width: 64, height: 48, points: 20, lens, ..DemoOptions::default() };
        demo::write(folder.path(), &options).unwrap();
        Capture::load(folder.path()).unwrap()
    }

    /// The marks of a point in all photographs, moved by `error_px`.
    fn marks(capture: &Capture, name: &str, point: DVec3, error_px: f64) -> Vec<Mark> {
        let mark = |(i, view): (usize, &View)| {
            let exact = view.intrinsics.px_from_cam(view.cam_from_world.transform_point3(point)).unwrap();
            let sign = if i % 2 == 0 { error_px } else { -error_px };
            Mark { name: name.into(), photograph: view.name.clone(), at_px: exact + DVec2::new(sign, 0.5 * sign) }
        };
        capture.views.iter().enumerate().map(mark).collect()
    }

    const A: DVec3 = DVec3::new(0.1, -0.2, 0.05);
    const B: DVec3 = DVec3::new(-0.3, 0.1, 0.1);

    #[test]
    fn two_points_and_their_distance_give_the_scale() {
        for lens in [false, true] {
            let capture = capture(lens);
            let mut all = marks(&capture, "left", A, 0.0);
            all.extend(marks(&capture, "right", B, 0.0));
            let scale = from_marks(&capture, &all, ["left", "right"], 2.5).unwrap();
            let expected = 2.5 / A.distance(B);
            assert!((scale.metres_per_unit / expected - 1.0).abs() < 1e-9, "{scale:?}, expected {expected}");
            // Half a pixel of error in each of six photographs.
            let mut all = marks(&capture, "left", A, 0.5);
            all.extend(marks(&capture, "right", B, -0.5));
            let scale = from_marks(&capture, &all, ["left", "right"], 2.5).unwrap();
            assert!((scale.metres_per_unit / expected - 1.0).abs() < 0.03, "{scale:?}, expected {expected}");
        }
    }

    #[test]
    fn marks_that_give_no_point_are_refused() {
        let capture = capture(false);
        let refused = |marks: &[Mark]| from_marks(&capture, marks, ["a", "b"], 1.0).unwrap_err().to_string();
        let a = marks(&capture, "a", A, 0.0);
        assert_says(&refused(&a[..1]), &["`a`", "in 1 photographs", "at least two"]);
        let mut elsewhere = a[..2].to_vec();
        elsewhere[1].photograph = "other.jpg".into();
        assert_says(&refused(&elsewhere), &["in 1 photographs", "other.jpg is not one"]);
        let mut twice = a[..2].to_vec();
        twice[1] = twice[0].clone();
        assert_says(&refused(&twice), &["`a`", "0.00°", "further apart"]);
        let mut wrong = a.clone();
        wrong[3].at_px += DVec2::new(9.0, -8.0);
        assert_says(&refused(&wrong), &["do not meet", &wrong[3].photograph, "upper left corner"]);
        let mut same = a.clone();
        same.extend(marks(&capture, "b", A, 0.0));
        let distance = from_marks(&capture, &same, ["a", "b"], f64::NAN).unwrap_err().to_string();
        assert_says(&distance, &["NaN", "positive number of metres"]);
        assert_says(&from_marks(&capture, &a, ["a", "b"], 1.0).unwrap_err().to_string(), &["`b`", "in 0 photographs"]);
    }

    #[test]
    fn files_of_marks() {
        let file = Path::new("marks.txt");
        let text = "# name photograph x y\n\nleft IMG 1.jpg 10 20.5\nright, a/b.png, 3, -4\n";
        let expected = |name: &str, photograph: &str, x, y| Mark {
            name: name.into(),
            photograph: photograph.into(),
            at_px: DVec2::new(x, y),
        };
        assert_eq!(
            parse_marks(file, text).unwrap(),
            [expected("left", "IMG 1.jpg", 10.0, 20.5), expected("right", "a/b.png", 3.0, -4.0)]
        );
        for line in ["left a.jpg 10", "left a.jpg x 10", "left 1 2", "left", "left a.jpg inf 2", "left  1 2"] {
            let error = parse_marks(file, &format!("\n{line}")).unwrap_err().to_string();
            assert_says(&error, &["marks.txt", "line 2", line, "NAME PHOTOGRAPH X Y"]);
        }
    }
}

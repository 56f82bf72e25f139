//! Cuts a capture into cells.

use glam::{DMat3, DVec2, DVec3};

use super::{BlockError, Bounds};
use crate::capture::Capture;
use crate::quantile::quantile;

/// Weight of all cameras together relative to that of all points.
const CAMERAS: f64 = 1.0 / 3.0;

/// Shares of the samples between which a cell's size is measured: stray points far outside do not count.
const CORE: [f64; 2] = [0.05, 0.95];

/// Least length of the mean of the cameras' upward axes at which they agree on which way is up.
const UPRIGHT: f64 = 0.3;

/// A cell, and the region around it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Cell {
    pub cell: Bounds,
    pub region: Bounds,
}

/// A point or a camera along the axes of the cells.
#[derive(Clone, Copy)]
struct Sample {
    at: DVec3,
    weight: f64,
}

/// The cells of a plan; together they fill the whole space.
pub(super) fn cells(capture: &Capture, blocks: usize, margin: f64) -> Result<Vec<Cell>, BlockError> {
    let everything = Bounds::everything(axes(capture));
    let points = (0..capture.points.positions.len()).map(|point| capture.position(point));
    let each = CAMERAS * points.len() as f64 / capture.views.len().max(1) as f64;
    let cameras = capture.views.iter().map(|view| (view.cam_from_world.inverse().translation, each));
    let mut samples: Vec<Sample> = points
        .map(|point| (point, 1.0))
        .chain(cameras)
        .map(|(at, weight)| Sample { at: everything.local(at), weight })
        .collect();
    let mut cells = Vec::with_capacity(blocks.min(samples.len()));
    let too_few = || BlockError(format!("the points and cameras cannot be divided into {blocks} blocks: plan fewer"));
    divide(&mut samples, everything, blocks, margin, &mut cells).ok_or_else(too_few)?;
    Ok(cells)
}

/// The axes of the cells, as rows: two level ones, along and across the longest extent of the cameras, and the one upwards.
fn axes(capture: &Capture) -> DMat3 {
    // The second row of a pose is the camera's axis down the picture.
    let ups = capture.views.iter().map(|view| -view.cam_from_world.matrix3.row(1));
    let up = ups.sum::<DVec3>() / capture.views.len().max(1) as f64;
    let up = if up.length() > UPRIGHT { up.normalize() } else { DVec3::Z };
    let (east, north) = up.any_orthonormal_pair();
    let centres: Vec<DVec2> = (capture.views.iter())
        .map(|view| view.cam_from_world.inverse().translation)
        .map(|centre| DVec2::new(east.dot(centre), north.dot(centre)))
        .collect();
    let mean = centres.iter().sum::<DVec2>() / centres.len().max(1) as f64;
    let products = |d: DVec2| DVec3::new(d.x * d.x, d.x * d.y, d.y * d.y);
    let DVec3 { x: xx, y: xy, z: yy } = centres.iter().map(|centre| products(*centre - mean)).sum();
    let (sin, cos) = (0.5 * f64::atan2(2.0 * xy, xx - yy)).sin_cos();
    let along = (cos * east + sin * north).normalize();
    DMat3::from_cols(along, up.cross(along), up).transpose()
}

/// Appends the cells of some samples; `None` if there are too few.
fn divide(samples: &mut [Sample], cell: Bounds, blocks: usize, margin: f64, cells: &mut Vec<Cell>) -> Option<()> {
    if samples.len() < blocks {
        return None;
    }
    let sizes = size_of(samples);
    if blocks == 1 {
        cells.push(Cell { cell, region: cell.grown(sizes.map(|size| margin * size)) });
        return Some(());
    }
    let axis = if sizes[0] >= sizes[1] { 0 } else { 1 };
    // Ties are broken by the other coordinates, so that the order of the file does not matter.
    samples.sort_by(|a, b| {
        let [a, b] = [a, b].map(|sample| sample.at.to_array());
        a[axis].total_cmp(&b[axis]).then(a[1 - axis].total_cmp(&b[1 - axis])).then(a[2].total_cmp(&b[2]))
    });
    let first = blocks / 2;
    let wanted = samples.iter().map(|sample| sample.weight).sum::<f64>() * first as f64 / blocks as f64;
    let mut sum = 0.0;
    let before = samples.iter().take_while(|sample| {
        sum += sample.weight;
        sum <= wanted
    });
    let mut middle = before.count().clamp(first, samples.len() - (blocks - first));
    // Equal coordinates lie on one side.
    while middle > 0 && samples[middle - 1].at[axis] == samples[middle].at[axis] {
        middle -= 1;
    }
    let [below, above] = (middle > 0).then(|| {
        let [low, high] = [samples[middle - 1].at[axis], samples[middle].at[axis]];
        // Of two neighbouring floats the mean may be the lower.
        let at = 0.5 * (low + high);
        cell.cut(axis, if at > low { at } else { high })
    })?;
    let (left, right) = samples.split_at_mut(middle);
    divide(left, below, first, margin, cells)?;
    divide(right, above, blocks - first, margin, cells)
}

/// The extent of the samples along each axis, without the outermost.
fn size_of(samples: &[Sample]) -> [f64; 3] {
    std::array::from_fn(|axis| {
        let mut sorted: Vec<f64> = samples.iter().map(|sample| sample.at[axis]).collect();
        let [low, high] = CORE.map(|share| quantile(&mut sorted, share).unwrap_or_default());
        (high - low) / (CORE[1] - CORE[0])
    })
}

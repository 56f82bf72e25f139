//! Measurements as CSV, and the growth that they show.

use std::error::Error;
use std::fmt::{self, Display, Write as _};
use std::path::Path;
use std::str::FromStr;

use splat_benches::SyntheticView;

use crate::point::{ScalePoint, ScaleWork};

#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum ScaleAxis {
    Splats,
    Pixels,
    Views,
}

impl ScaleAxis {
    pub const ALL: [Self; 3] = [Self::Splats, Self::Pixels, Self::Views];

    /// Returns the point's coordinate on this axis.
    pub fn of(self, point: &ScalePoint) -> f64 {
        (match self {
            Self::Splats => point.view.splats,
            Self::Pixels => point.pixels(),
            Self::Views => point.views,
        }) as f64
    }
}

impl Display for ScaleAxis {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        // In the order of the variants.
        f.write_str(["splats", "pixels", "views"][*self as usize])
    }
}

impl FromStr for ScaleAxis {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let found = Self::ALL.into_iter().find(|axis| axis.to_string() == text);
        found.ok_or_else(|| format!("`{text}` is not one of splats, pixels, views"))
    }
}

#[derive(Clone, Debug, PartialEq)]
pub struct ScaleRow {
    pub axis: ScaleAxis,
    pub point: ScalePoint,
    pub intersections: usize,
    pub median_s: f64,
    pub runs: usize,
    /// Peak of the bytes that the program allocated, for tensors and lists.
    pub live_bytes: usize,
    /// Peak of the process's resident memory.
    pub rss_bytes: usize,
    /// Wall time of the whole process, s; not recorded.
    pub wall_s: f64,
}

impl Display for ScaleRow {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mib = |bytes: usize| bytes as f64 / f64::from(1 << 20);
        write!(
            f,
            "{}: {:.2} ms ({} runs), {:.1} MiB held, {:.1} MiB resident, {} intersections",
            self.point,
            1e3 * self.median_s,
            self.runs,
            mib(self.live_bytes),
            mib(self.rss_bytes),
            self.intersections
        )
    }
}

const HEADER: &str = "axis,work,splats,width,height,views,sigma_px,opacity_min,opacity_max,intersections,median_s,runs,live_bytes,rss_bytes";

pub fn write(rows: &[ScaleRow]) -> String {
    let mut text = format!("{HEADER}\n");
    for ScaleRow { axis, point, intersections, median_s, runs, live_bytes, rss_bytes, .. } in rows {
        let _ = writeln!(
            text,
            "{axis},{},{intersections},{median_s:.6},{runs},{live_bytes},{rss_bytes}",
            point.write().join(",")
        );
    }
    text
}

/// Reads the rows of a file; none if it does not exist.
pub fn read(path: &Path) -> Result<Vec<ScaleRow>, Box<dyn Error>> {
    let Ok(text) = std::fs::read_to_string(path) else { return Ok(Vec::new()) };
    let row = |line: &str| -> Result<ScaleRow, Box<dyn Error>> {
        let fields: Vec<String> = line.split(',').map(str::to_owned).collect();
        let [axis, point @ .., intersections, median_s, runs, live_bytes, rss_bytes] = &fields[..] else {
            return Err(format!("{}: {line:?}", path.display()).into());
        };
        Ok(ScaleRow {
            axis: axis.parse()?,
            point: ScalePoint::read(point)?,
            intersections: intersections.parse()?,
            median_s: median_s.parse()?,
            runs: runs.parse()?,
            live_bytes: live_bytes.parse()?,
            rss_bytes: rss_bytes.parse()?,
            wall_s: 0.0,
        })
    };
    text.lines().skip(1).map(row).collect()
}

/// Allowed bytes of a trainer per Gaussian of degree 3: 1.3 times its 59 parameters, two moments and one gradient of each.
pub const ALLOWED_BYTES: f64 = 1.3 * 59.0 * 4.0 * 4.0;

/// Prints the cost of each step along the axis per unit of work.
pub fn state_growth(axis: ScaleAxis, rows: &[ScaleRow]) {
    for work in ScaleWork::RECORDED {
        let rows: Vec<&ScaleRow> = rows.iter().filter(|row| row.point.work == work).collect();
        for pair in rows.windows(2) {
            let [low, high] = [pair[0], pair[1]];
            let ratio = axis.of(&high.point) / axis.of(&low.point);
            let exponent = |low: f64, high: f64| (high / low).ln() / ratio.ln();
            let added = (high.live_bytes as f64 - low.live_bytes as f64) / (axis.of(&high.point) - axis.of(&low.point));
            println!(
                "  {}, {} to {}: time grows with the power {:.2}, {}; {added:.0} bytes held for each more",
                work.name(),
                axis.of(&low.point),
                axis.of(&high.point),
                exponent(low.median_s, high.median_s),
                per_unit(axis, high),
            );
        }
        if axis == ScaleAxis::Splats && work == ScaleWork::Step && rows.len() > 1 {
            // Between the two largest scenes: with fewer Gaussians the peak is in the loss and depends on the picture.
            let [few, many] = [rows[rows.len() - 2], rows[rows.len() - 1]];
            let more = (many.point.view.splats - few.point.view.splats) as f64;
            let each = |of: fn(&ScaleRow) -> usize| (of(many) as f64 - of(few) as f64) / more;
            println!(
                "  a training step holds {:.0} bytes for each Gaussian, the goal is {ALLOWED_BYTES:.0}; resident are {:.0}",
                each(|row| row.live_bytes),
                each(|row| row.rss_bytes)
            );
        }
    }
}

fn per_unit(axis: ScaleAxis, row: &ScaleRow) -> String {
    let SyntheticView { splats, .. } = row.point.view;
    match axis {
        ScaleAxis::Splats => format!(
            "{:.0} ns per visible Gaussian and {:.0} ns per intersection at {splats}",
            1e9 * row.median_s / row.point.visible(),
            1e9 * row.median_s / row.intersections as f64
        ),
        ScaleAxis::Pixels => format!("{:.0} ns per pixel", 1e9 * row.median_s / row.point.pixels() as f64),
        ScaleAxis::Views => format!("{:.2} ms", 1e3 * row.median_s),
    }
}

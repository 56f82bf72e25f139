//! One plot per axis: time on the left, memory on the right, with logarithmic scales.

use std::error::Error;
use std::ops::Range;
use std::path::Path;

use plotters::coord::combinators::IntoLogRange;
use plotters::prelude::*;
use plotters::style::register_font;

use crate::point::ScaleWork;
use crate::record::{ALLOWED_BYTES, ScaleAxis, ScaleRow};

const SIZE: (u32, u32) = (1000, 420);

/// A line of a plot.
struct PlotLine {
    name: &'static str,
    colour: RGBColor,
    points: Vec<(f64, f64)>,
}

pub fn draw(axis: ScaleAxis, rows: &[ScaleRow], to: &Path) -> Result<(), Box<dyn Error>> {
    let colours = [RGBColor(40, 90, 160), RGBColor(200, 80, 40)];
    let lines = |value: &dyn Fn(&ScaleRow) -> f64| -> Vec<PlotLine> {
        let of = |(work, colour): (ScaleWork, RGBColor)| {
            let rows = rows.iter().filter(|row| row.point.work == work);
            PlotLine { name: work.name(), colour, points: rows.map(|row| (axis.of(&row.point), value(row))).collect() }
        };
        let lines = ScaleWork::RECORDED.into_iter().zip(colours).map(of);
        lines.filter(|line| !line.points.is_empty()).collect()
    };
    let times = lines(&|row| 1e3 * row.median_s);
    let mut memory = lines(&|row| row.live_bytes as f64 / f64::from(1 << 20));
    if axis == ScaleAxis::Splats {
        // The goal, added to the memory of the smallest step, which its pictures dominate.
        let steps: Vec<&ScaleRow> = rows.iter().filter(|row| row.point.work == ScaleWork::Step).collect();
        let goal = |row: &&ScaleRow| {
            let fewest = steps[0];
            let more = axis.of(&row.point) - axis.of(&fewest.point);
            (axis.of(&row.point), (fewest.live_bytes as f64 + ALLOWED_BYTES * more) / f64::from(1 << 20))
        };
        memory.push(PlotLine {
            name: "1.3 × (parameters, moments, gradient)",
            colour: RGBColor(120, 120, 120),
            points: steps.iter().map(goal).collect(),
        });
    }
    // The font is part of the bench, so that a plot is the same on every machine.
    register_font("sans-serif", FontStyle::Normal, dejavu::sans::regular())
        .map_err(|_| "the font for plots cannot be read")?;
    let drawing = SVGBackend::new(to, SIZE).into_drawing_area();
    drawing.fill(&WHITE)?;
    let halves = drawing.split_evenly((1, 2));
    let unit = match axis {
        ScaleAxis::Splats => "Gaussians",
        ScaleAxis::Pixels => "pixels",
        ScaleAxis::Views => "photographs",
    };
    chart(&halves[0], "ms", unit, &times)?;
    chart(&halves[1], "MiB held at a time", unit, &memory)?;
    drawing.present()?;
    Ok(())
}

type Area<'a> = DrawingArea<SVGBackend<'a>, plotters::coord::Shift>;

fn chart(area: &Area, title: &str, unit: &str, lines: &[PlotLine]) -> Result<(), Box<dyn Error>> {
    let all = || lines.iter().flat_map(|line| &line.points);
    let (x, y) = (around(all().map(|point| point.0)), decades(all().map(|point| point.1)));
    let mut chart = ChartBuilder::on(area)
        .caption(title, ("sans-serif", 20))
        .margin(12)
        .x_label_area_size(40)
        .y_label_area_size(60)
        .build_cartesian_2d(x.log_scale(), y.log_scale())?;
    let label = |value: &f64| if *value >= 1e5 || *value < 0.01 { format!("{value:.0e}") } else { format!("{value}") };
    chart
        .configure_mesh()
        .label_style(("sans-serif", 16))
        .light_line_style(TRANSPARENT)
        .x_desc(unit)
        .x_label_formatter(&label)
        .y_label_formatter(&label)
        .draw()?;
    for PlotLine { name, colour, points } in lines {
        let colour = *colour;
        chart
            .draw_series(LineSeries::new(points.iter().copied(), colour.stroke_width(2)).point_size(3))?
            .label(*name)
            .legend(move |(x, y)| PathElement::new([(x, y), (x + 20, y)], colour.stroke_width(2)));
    }
    chart
        .configure_series_labels()
        .label_font(("sans-serif", 16))
        .position(SeriesLabelPosition::UpperLeft)
        .background_style(WHITE)
        .draw()?;
    Ok(())
}

/// Returns a range with a margin around the values.
fn around(values: impl Iterator<Item = f64>) -> Range<f64> {
    let (low, high) = values.fold((f64::INFINITY, 0.0_f64), |(low, high), value| (low.min(value), high.max(value)));
    0.7 * low..1.5 * high
}

/// Returns a range of whole powers of ten around the values, so that the axis has labels.
fn decades(values: impl Iterator<Item = f64>) -> Range<f64> {
    let Range { start, end } = around(values);
    10.0_f64.powf(start.log10().floor())..10.0_f64.powf(end.log10().ceil())
}

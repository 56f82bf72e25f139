//! Plot of time against error: one point per setting, the frontier as a line, presets marked.

use std::sync::LazyLock;

use anyhow::{Context, Result, anyhow};
use plotters::coord::Shift;
use plotters::prelude::*;
use plotters::style::register_font;

/// Width and height of a plot, px.
const SIZE: (u32, u32) = (1000, 640);

#[derive(Clone, Copy, Debug)]
pub struct Quartiles {
    pub lower: f64,
    pub median: f64,
    pub upper: f64,
}

/// Why a setting was measured.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Role {
    Preset,
    Dial,
    Combination,
}

#[derive(Clone, Debug)]
pub struct Dot {
    pub name: String,
    /// Presets have a ring, combinations a triangle.
    pub role: Role,
    /// Time of a frame, ms.
    pub x: Quartiles,
    /// Quality, dB; higher is better.
    pub y: f64,
    /// Whether it is on the frontier; its name is drawn then.
    pub member: bool,
}

#[derive(Clone, Debug)]
pub struct Chart {
    pub title: String,
    /// In any order; members of the frontier are joined in the order of their times.
    pub dots: Vec<Dot>,
}

/// Registers the font with the plotting library, which otherwise draws no text. The font is part of the test, so
/// that a plot is the same on every machine.
///
/// # Errors
/// If the font cannot be read.
fn register() -> Result<()> {
    static DONE: LazyLock<bool> =
        LazyLock::new(|| register_font("sans-serif", FontStyle::Normal, dejavu::sans::regular()).is_ok());
    (*DONE).then_some(()).context("the font for plots cannot be read")
}

/// Draws a plot as SVG.
///
/// # Errors
/// If it cannot be drawn.
pub fn svg(chart: &Chart) -> Result<String> {
    register()?;
    let mut text = String::new();
    let drawn = draw(chart, &SVGBackend::with_string(&mut text, SIZE).into_drawing_area());
    drawn.map_err(|error| anyhow!("the plot {:?} cannot be drawn: {error}", chart.title))?;
    Ok(text)
}

/// Left edge of the plotting area, px.
const AXIS: i32 = 78;

const GREY: RGBColor = RGBColor(150, 150, 150);
const BLUE_DOT: RGBColor = RGBColor(40, 90, 160);
const ORANGE: RGBColor = RGBColor(200, 80, 40);

type Area<'a> = DrawingArea<SVGBackend<'a>, Shift>;
type DrawError<'a> = DrawingAreaErrorKind<<SVGBackend<'a> as DrawingBackend>::ErrorType>;

fn draw<'a>(chart: &Chart, area: &Area<'a>) -> Result<(), DrawError<'a>> {
    let font = ("sans-serif", 15);
    area.fill(&WHITE)?;
    let (x, y) = (around_times(&chart.dots), around_errors(&chart.dots));
    let mut axes = ChartBuilder::on(area)
        .caption(&chart.title, ("sans-serif", 20))
        .margin(14)
        .margin_right(40)
        .x_label_area_size(48)
        .y_label_area_size(64)
        .build_cartesian_2d(x.clone(), y)?;
    axes.configure_mesh()
        .label_style(font)
        .light_line_style(TRANSPARENT)
        .x_labels(12)
        .x_desc("time of a frame, ms (median and quartiles)")
        .y_desc("PSNR against the exact render, dB")
        .x_label_formatter(&|ms| short(*ms))
        .y_label_formatter(&|db| format!("{db:.0}"))
        .draw()?;
    // Spreads come first, so that they hide no point.
    for Dot { x: spread, y, .. } in &chart.dots {
        let [lower, upper] = [spread.lower, spread.upper].map(|ms| ms.clamp(x.start, x.end));
        axes.draw_series([PathElement::new([(lower, *y), (upper, *y)], GREY)])?;
    }
    let mut members: Vec<&Dot> = chart.dots.iter().filter(|dot| dot.member).collect();
    members.sort_by(|a, b| a.x.median.total_cmp(&b.x.median));
    axes.draw_series(LineSeries::new(members.iter().map(|dot| (dot.x.median, dot.y)), ORANGE.stroke_width(2)))?;
    // Members of the frontier come last, so that no other point hides them.
    let mut dots: Vec<&Dot> = chart.dots.iter().collect();
    dots.sort_by_key(|dot| dot.member);
    for dot in dots {
        let at = (dot.x.median, dot.y);
        let colour = if dot.member { ORANGE } else { BLUE_DOT };
        match dot.role {
            Role::Preset => {
                axes.draw_series([Circle::new(at, 4, colour.filled())])?;
                axes.draw_series([Circle::new(at, 9, BLACK.stroke_width(2))])?;
            }
            Role::Dial => _ = axes.draw_series([Circle::new(at, 4, colour.filled())])?,
            Role::Combination => _ = axes.draw_series([TriangleMarker::new(at, 6, colour.filled())])?,
        }
    }
    let named: Vec<&Dot> = chart.dots.iter().filter(|dot| dot.member || dot.role == Role::Preset).collect();
    let places: Vec<(i32, i32)> = named.iter().map(|dot| axes.backend_coord(&(dot.x.median, dot.y))).collect();
    for (dot, corner) in named.iter().zip(beside(&places, &named)) {
        area.draw(&Text::new(dot.name.clone(), corner, font.into_font().color(&BLACK)))?;
    }
    area.present()
}

/// Returns the start of each name, px: beside its point or as near as there is room, so that it covers no other name
/// and no point.
fn beside(places: &[(i32, i32)], named: &[&Dot]) -> Vec<(i32, i32)> {
    // Approximate size of a letter of the font.
    const LETTER: (i32, i32) = (8, 16);
    let overlap = |a: &[i32; 4], b: &[i32; 4]| a[0] < b[2] && b[0] < a[2] && a[1] < b[3] && b[1] < a[3];
    let mut taken: Vec<[i32; 4]> = places.iter().map(|&(x, y)| [x - 8, y - 8, x + 8, y + 8]).collect();
    let corners = places.iter().zip(named).map(|(&(x, y), dot)| {
        let width = LETTER.0 * dot.name.chars().count() as i32;
        let (right, left) = (x + 12, x - 12 - width);
        let rows = [0, 1, -1, 2, -2, 3, -3].map(|row| y - LETTER.1 / 2 + LETTER.1 * row);
        let all = rows.into_iter().flat_map(|y| [(right, y), (left, y)]);
        let area = |(x, y): (i32, i32)| [x, y, x + width, y + LETTER.1];
        let inside = |&(x, _): &(i32, i32)| x > AXIS && x + width < SIZE.0 as i32;
        let free = |&corner: &(i32, i32)| !taken.iter().any(|other| overlap(&area(corner), other));
        let corner = all.clone().filter(inside).find(free).unwrap_or((right, rows[0]));
        taken.push(area(corner));
        corner
    });
    corners.collect()
}

/// Formats a tick, with enough digits to tell ticks apart.
fn short(value: f64) -> String {
    if value >= 20.0 { format!("{value:.0}") } else { format!("{value:.1}") }
}

/// Range of the time axis: the medians with a margin. Spreads are cut off there, because one slow run should not press
/// all points to the border.
fn around_times(dots: &[Dot]) -> std::ops::Range<f64> {
    let (low, high) = limits(dots.iter().map(|dot| dot.x.median));
    let room = 0.08 * (high - low).max(0.1 * high).max(1e-3);
    (low - room).max(0.0)..high + 2.0 * room
}

fn around_errors(dots: &[Dot]) -> std::ops::Range<f64> {
    let (low, high) = limits(dots.iter().map(|dot| dot.y));
    let room = 0.06 * (high - low).max(1.0);
    low - room..high + room
}

/// Smallest and largest of the finite values; zeros if there are none.
fn limits(values: impl Iterator<Item = f64>) -> (f64, f64) {
    let ends = values.filter(|value| value.is_finite()).map(|value| (value, value));
    ends.reduce(|(low, high), (value, _)| (low.min(value), high.max(value))).unwrap_or_default()
}

#[cfg(test)]
mod tests;

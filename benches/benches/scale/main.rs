//! Time and memory of a render with its backward pass and of a training step, against the numbers of Gaussians, pixels and
//! photographs.
//!
//! `cargo bench --workspace --bench scale -- splats` takes any of `splats`, `pixels` and `views`, by default all three. `plot`
//! draws the recorded measurements. `moments 10000000` prints a training step of so many Gaussians, and a refinement to so
//! many, with Adam's moments in 32 and 8 bits, and records nothing. Each axis replaces its rows in `docs/scale/scale.csv` and its plot, and keeps the other
//! axes. Every point runs in a process of its own, so that it does not reuse the memory of another. A point that would exceed
//! [`MEMORY`] or [`PATIENCE`] by extrapolation from the point before is skipped, with a message.

mod plot;
mod point;
mod record;

use std::error::Error;
use std::fs;
use std::path::Path;
use std::process::Command;
use std::time::Duration;

use splat_benches::allocations::CountingAllocator;
use splat_benches::{MEDIUM, SyntheticView};
use splat_model::optim::MomentBits;
use splat_train::memory::Fast;

use point::{ScalePoint, ScaleWork};
use record::{ScaleAxis, ScaleRow};

splat_train::allocator!(CountingAllocator<Fast>, CountingAllocator(Fast));

/// Most bytes for a point.
const MEMORY: f64 = 16.0 * 1024.0 * 1024.0 * 1024.0;

/// Longest time for a point.
const PATIENCE: Duration = Duration::from_secs(180);

const FOLDER: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../docs/scale");

fn main() -> Result<(), Box<dyn Error>> {
    let words: Vec<String> = std::env::args().skip(1).filter(|word| word != "--bench").collect();
    if let Some(("--point", point)) = words.split_first().map(|(first, rest)| (first.as_str(), rest)) {
        return point::run(&ScalePoint::read(point)?);
    }
    let csv = Path::new(FOLDER).join("scale.csv");
    if words == ["plot"] {
        return ScaleAxis::ALL.into_iter().try_for_each(|axis| {
            println!("\n{axis}");
            let rows: Vec<ScaleRow> = record::read(&csv)?.into_iter().filter(|row| row.axis == axis).collect();
            show(axis, &rows)
        });
    }
    if let [first, counts @ ..] = &words[..]
        && first == "moments"
    {
        return counts.iter().try_for_each(|count| moments(count.parse()?));
    }
    let axes: Result<Vec<ScaleAxis>, String> = words.iter().map(|word| word.parse()).collect();
    let axes = axes.map(|axes| if axes.is_empty() { ScaleAxis::ALL.to_vec() } else { axes })?;
    fs::create_dir_all(FOLDER)?;
    for axis in axes {
        println!("\n{axis}");
        let rows = measure(axis)?;
        // The file is read only now, because another run may have measured another axis meanwhile.
        let mut all = record::read(&csv)?;
        all.retain(|row| row.axis != axis);
        all.extend(rows.iter().cloned());
        all.sort_by_key(|row| row.axis);
        fs::write(&csv, record::write(&all))?;
        show(axis, &rows)?;
    }
    Ok(())
}

/// Measures a training step and a refinement with moments of each number of bits.
fn moments(splats: usize) -> Result<(), Box<dyn Error>> {
    let view = SyntheticView { splats, width: 1920, height: 1080, ..MEDIUM };
    for moments in MomentBits::ALL {
        for work in [ScaleWork::Step, ScaleWork::Refinement] {
            println!("{}", in_a_process(ScaleAxis::Splats, &ScalePoint { work, view, views: 1, moments })?);
        }
    }
    Ok(())
}

/// Draws the plot and prints the growth.
fn show(axis: ScaleAxis, rows: &[ScaleRow]) -> Result<(), Box<dyn Error>> {
    plot::draw(axis, rows, &Path::new(FOLDER).join(format!("{axis}.svg")))?;
    record::state_growth(axis, rows);
    Ok(())
}

/// Returns the points of an axis, in ascending order.
fn points(axis: ScaleAxis) -> Vec<(SyntheticView, usize)> {
    // The number of layers grows with the number of Gaussians, until the nearest hide the others.
    let splats = |splats| SyntheticView { splats, width: 1920, height: 1080, ..MEDIUM };
    // One scene, photographed at increasing resolution.
    let pixels = |(width, height): (usize, usize)| {
        let sigma_px = MEDIUM.sigma_px * width as f64 / MEDIUM.width as f64;
        SyntheticView { width, height, sigma_px, ..MEDIUM }
    };
    let views = |views| (SyntheticView { splats: 5_000, width: 320, height: 180, ..MEDIUM }, views);
    match axis {
        ScaleAxis::Splats => [1_000, 3_000, 10_000, 30_000, 100_000, 300_000, 1_000_000, 3_000_000, 10_000_000]
            .map(|count| (splats(count), 1))
            .to_vec(),
        ScaleAxis::Pixels => [(426, 240), (854, 480), (1280, 720), (1920, 1080), (3840, 2160), (7680, 4320)]
            .map(|size| (pixels(size), 1))
            .to_vec(),
        ScaleAxis::Views => [10, 30, 100, 300, 1_000, 3_000, 10_000].map(views).to_vec(),
    }
}

fn measure(axis: ScaleAxis) -> Result<Vec<ScaleRow>, Box<dyn Error>> {
    let mut rows = Vec::new();
    for work in ScaleWork::RECORDED {
        // A render does not depend on the number of photographs.
        if axis == ScaleAxis::Views && work == ScaleWork::Render {
            continue;
        }
        let mut before: Option<ScaleRow> = None;
        for (view, views) in points(axis) {
            let point = ScalePoint { work, view, views, moments: MomentBits::ThirtyTwo };
            if let Some(reason) = before.as_ref().and_then(|before| too_much(axis, before, &point)) {
                println!("  {point} is skipped: {reason}");
                continue;
            }
            let row = match in_a_process(axis, &point) {
                Ok(row) => row,
                Err(error) => {
                    println!("  {point} is skipped: {error}");
                    continue;
                }
            };
            println!("  {row}");
            before = Some(row.clone());
            rows.push(row);
        }
    }
    Ok(rows)
}

/// Returns the reason to skip a point, by linear extrapolation from the point before it.
fn too_much(axis: ScaleAxis, before: &ScaleRow, point: &ScalePoint) -> Option<String> {
    let growth = axis.of(point) / axis.of(&before.point);
    let bytes = before.live_bytes as f64 * growth;
    // One warm-up run and one timed run, in addition to the time of the setup.
    let set_up = (before.wall_s - (before.runs + 1) as f64 * before.median_s).max(0.0);
    let seconds = match axis {
        // A step uses one photograph, for any number of photographs.
        ScaleAxis::Views => set_up * growth,
        _ => (set_up + 2.0 * before.median_s) * growth,
    };
    match () {
        () if bytes > MEMORY => Some(format!("it would take about {:.1} GiB", bytes / f64::from(1 << 30))),
        () if seconds > PATIENCE.as_secs_f64() => Some(format!("it would take about {seconds:.0} s")),
        () => None,
    }
}

/// Measures a point in a separate process.
fn in_a_process(axis: ScaleAxis, point: &ScalePoint) -> Result<ScaleRow, Box<dyn Error>> {
    let start = std::time::Instant::now();
    let output = Command::new(std::env::current_exe()?).arg("--point").args(point.write()).output()?;
    if !output.status.success() {
        let said = String::from_utf8_lossy(&output.stderr);
        return Err(format!("{}: {}", output.status, said.lines().last().unwrap_or_default()).into());
    }
    let measured = String::from_utf8(output.stdout)?;
    let numbers: Result<Vec<f64>, _> = measured.split_whitespace().map(str::parse).collect();
    let numbers = numbers?;
    let [median_s, runs, intersections, live_bytes, rss_bytes] = numbers[..] else {
        return Err(format!("not a measurement: {measured:?}").into());
    };
    Ok(ScaleRow {
        axis,
        point: point.clone(),
        intersections: intersections as usize,
        median_s,
        runs: runs as usize,
        live_bytes: live_bytes as usize,
        rss_bytes: rss_bytes as usize,
        wall_s: start.elapsed().as_secs_f64(),
    })
}

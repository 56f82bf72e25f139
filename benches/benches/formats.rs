//! Writes and reads a scene in every format that is written and read, checks what comes back, and prints times, bytes a splat and errors.
//!
//! `cargo bench --workspace --bench formats -- scene.ply` takes a scene and repeats it, each time at another place and with other harmonics, until
//! there are a million splats. Without one, the splats are random, which no format can compress as it compresses a trained scene.
//!
//! `… -- --write 10000000 "$PWD/ten.ply"` writes a PLY of so many random splats instead, and keeps it.

use std::error::Error;
use std::fs;
use std::path::Path;
use std::time::Instant;

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use splat_benches::random::{self, RandomScene};
use splat_model::formats::{self, Format, QuantisationError, SceneFile};
use splat_model::gaussians::GaussianRows;

splat_train::allocator!();

/// Number of splats.
const SPLATS: usize = 1_000_000;

/// Relative standard deviation of the harmonics of a repetition.
const NOISE: f32 = 0.2;

fn main() -> Result<(), Box<dyn Error>> {
    let words: Vec<String> = std::env::args().skip(1).filter(|word| word != "--bench").collect();
    if let [write, count, path] = &words[..]
        && write == "--write"
    {
        return Ok(random::write(Path::new(path), count.parse()?)?);
    }
    let rows = match words.first() {
        Some(path) => repeated(&formats::read(Path::new(&path))?.0.rows),
        None => repeated(&RandomScene::default().next_rows(SPLATS / 20)),
    };
    let scene = SceneFile { rows, ..SceneFile::default() };
    println!("{} splats of degree {}, {} threads", SPLATS, scene.rows.sh_degree, rayon::current_num_threads());
    println!("{:16} {:>9} {:>9} {:>14} {:>20}", "format", "write, s", "read, s", "bytes a splat", "RMS of harmonics");
    let folder = std::env::temp_dir().join(format!("splat-formats-{}", std::process::id()));
    fs::create_dir_all(&folder)?;
    for format in [Format::Ply, Format::Spz, Format::Sog] {
        let path = folder.join(format!("scene{}", format.extension()));
        let start = Instant::now();
        let written = formats::write(&path, &scene, format)?;
        let write = start.elapsed();
        let start = Instant::now();
        let (read, found) = formats::read(&path)?;
        let elapsed = start.elapsed();
        assert_eq!((found, read.rows.len(), written.left_out), (format, SPLATS, 0), "another scene came back");
        let loss = QuantisationError::between(&written.rows, &read.rows);
        assert!(loss.colour.rms < 0.01 && loss.opacity.rms < 0.01, "{format}: {loss:?}");
        let bytes = fs::metadata(&path)?.len() as f64 / SPLATS as f64;
        let (write, elapsed) = (write.as_secs_f64(), elapsed.as_secs_f64());
        println!("{:16} {write:>9.2} {elapsed:>9.2} {bytes:>14.1} {:>20.2e}", format.to_string(), loss.harmonics.rms);
        fs::remove_file(&path)?;
    }
    fs::remove_dir(&folder)?;
    Ok(())
}

/// The scene side by side with itself, with other harmonics each time.
fn repeated(scene: &GaussianRows) -> GaussianRows {
    let mut random = ChaCha8Rng::seed_from_u64(1);
    let mut rows = GaussianRows { sh_degree: scene.sh_degree, ..GaussianRows::default() };
    let usable: Vec<usize> = (0..scene.len()).filter(|&i| scene.is_usable(i)).collect();
    for n in 0..SPLATS {
        rows.push(scene, usable[n % usable.len()]);
        rows.means[n][0] += 10.0 * (n / usable.len()) as f32;
    }
    for harmonic in &mut rows.sh_rest {
        *harmonic *= 1.0 + NOISE * random.random_range(-1.7..1.7);
    }
    rows
}

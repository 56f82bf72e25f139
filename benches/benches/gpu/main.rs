//! Times the passes of a training step on devices named at run time, and tells of a graphics card on one page.
//!
//! `cargo bench --workspace --bench gpu -- flex gpu fox_small` takes any names of `splat devices` and any of `small`,
//! `fox_small`, `fox_colmap`, `medium`, `wide`, `large` and `huge`. The default is flex and the GPU with `fox_small`, `medium` and `large`. All
//! devices are compared with the first. A scene outside the specified load, or a picture that differs from the CPU's, is not timed.
//!
//! With `card` as the first word, the bench runs tests, benches and training on the machine's graphics card within nine minutes
//! and writes `card.md` and `card.json`; `benches/card.sh` calls it. With `export` it writes scenes and captures for `benches/gsplat.py`.

mod card;
mod compare;
mod export;
mod page;

use std::error::Error;

use clap::Parser;
use splat_train::options::Cli;

splat_train::allocator!();

fn main() -> Result<(), Box<dyn Error>> {
    // Cargo passes `--bench`.
    let words: Vec<String> = std::env::args().skip(1).filter(|word| word != "--bench").collect();
    match words.first().map(String::as_str) {
        Some("card") => card::run(&card::Options::try_parse_from(&words)?),
        Some("export") => export::run(&words[1..]),
        // The program `splat`, so that a card's page needs no second binary of its size.
        Some("splat") => Ok(splat_train::run(&Cli::try_parse_from(&words)?.command)?),
        _ => compare::run(words),
    }
}

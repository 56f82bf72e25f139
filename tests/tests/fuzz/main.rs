//! Mutation fuzzing of every reader, on the stable toolchain.
//!
//! `cargo fuzz` would build Burn a second time, with instrumentation. Here inputs grow from valid files by mutations that know
//! the formats ([`split`], [`mutate`]). An input with a new outcome (another error, another form of message, another size of
//! result) joins the corpus that is mutated further ([`engine`]): outcomes replace coverage, as far as the readers' messages
//! distinguish them.
//!
//! For every input a reader must return within [`engine::LIMIT`], without a panic, and without holding more memory at any
//! time than [`engine::ROOM`] plus [`engine::MULTIPLE`] times the input's size. The result of an accepted input must be
//! consistent, and the error of a refused input must name the file and say what to do.
//!
//! `SPLAT_FUZZ_SECONDS` sets the time per reader, 30 s by default, and `SPLAT_FUZZ_SEED` the seed, 0 by default. A failure
//! leaves its input in `target/tmp/fuzz`.

mod allocations;
mod engine;
mod exports;
mod json;
mod mutate;
mod pictures;
mod regressions;
mod scenes;
mod seeds;
mod sog;
mod split;
mod targets;
mod transforms;

#[global_allocator]
static ALLOCATOR: allocations::ThreadCountingAllocator = allocations::ThreadCountingAllocator;

#[test]
fn ply() {
    engine::fuzz(&mut targets::Ply::new("ply"));
}

#[test]
fn scenes() {
    engine::fuzz(&mut scenes::Scenes::new("scenes"));
}

#[test]
fn sog() {
    engine::fuzz(&mut sog::Sog::new("sog"));
}

#[test]
fn colmap_binary() {
    engine::fuzz(&mut targets::Colmap::binary("colmap_binary"));
}

#[test]
fn colmap_text() {
    engine::fuzz(&mut targets::Colmap::text("colmap_text"));
}

#[test]
fn transforms() {
    engine::fuzz(&mut transforms::Transforms::new("transforms"));
}

#[test]
fn exports() {
    engine::fuzz(&mut exports::Exports::new("exports"));
}

#[test]
fn pictures() {
    engine::fuzz(&mut pictures::Pictures::new("pictures"));
}

#[test]
fn json() {
    engine::fuzz(&mut json::Json::new("json"));
}

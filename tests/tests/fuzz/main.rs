//! Mutation fuzzing of every reader, on the stable toolchain.
//!
//! `cargo fuzz` would build Burn a second time, instrumented. Here inputs grow from valid files by mutations that know the
//! formats ([`split`], [`mutate`]), and one that reaches an outcome not seen before (another error, another shape of message,
//! another size of result) joins those that are mutated further ([`engine`]): what coverage would tell, as far as the
//! readers' own words tell it.
//!
//! For every input a reader must return, within [`engine::LIMIT`], without a panic, and without holding more memory at any
//! time than [`engine::ROOM`] plus [`engine::MULTIPLE`] times the input's size; what it accepts must make sense, and what it
//! refuses it must refuse in words that name the file and say what to do.
//!
//! `SPLAT_FUZZ_SECONDS` sets the time for each reader, 30 s if unset; `SPLAT_FUZZ_SEED` another start than 0. A failure
//! leaves its input in `target/tmp/fuzz`.

mod allocations;
mod engine;
mod json;
mod mutate;
mod regressions;
mod scenes;
mod seeds;
mod split;
mod targets;
mod transforms;

#[global_allocator]
static ALLOCATOR: allocations::Counting = allocations::Counting;

#[test]
fn ply() {
    engine::fuzz(&mut targets::Ply::new("ply"));
}

#[test]
fn scenes() {
    engine::fuzz(&mut scenes::Scenes::new("scenes"));
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
fn json() {
    engine::fuzz(&mut json::Json::new("json"));
}

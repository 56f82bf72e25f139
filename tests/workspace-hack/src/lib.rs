//! An empty crate that depends on all that the members of the workspace depend on.
//!
//! Cargo gives a shared dependency the union of the features that the selected packages ask of it. Other packages, another
//! union, and Burn is compiled again for twenty minutes. This crate is a default member, and every member's tests depend on
//! it, so that the union is always the same: `cargo run`, `cargo test --workspace` and `cargo test -p splat-op` share one
//! build. Published packages do not depend on it, because `cargo package` leaves out development dependencies without a version.

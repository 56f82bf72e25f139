//! How many Gaussians, and where. Policies (`adaptive.rs`) say which rows to keep, copy and add; `rows.rs` alone edits
//! them, together with their Adam moments.

mod adaptive;
pub mod rows;

pub use adaptive::{Adaptive, AdaptiveConfig, RefineReport};

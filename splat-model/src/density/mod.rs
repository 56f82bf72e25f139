//! How many Gaussians, and where. Policies (`adaptive.rs`) say which rows to keep, copy and add; `rows.rs` alone edits
//! them, together with their Adam moments; `matte.rs` says which need no directional colour, `order.rs` which order is quick to
//! render.

mod adaptive;
pub mod matte;
mod order;
pub mod rows;

pub use adaptive::{Adaptive, AdaptiveConfig, RefineReport};
pub use order::morton_order;

//! How many Gaussians, and where. Policies (`adaptive.rs`) say which rows to keep, copy and add; `rows.rs` alone edits
//! them, together with their Adam moments; `order.rs` says which order is quick to render.

mod adaptive;
mod order;
pub mod rows;

pub use adaptive::{Adaptive, AdaptiveConfig, RefineReport};
pub use order::morton_order;

//! How many Gaussians, and where. A [`Strategy`] says which rows to keep, copy and add (`adaptive.rs`, `mcmc.rs`, or one of your
//! own); `rows.rs` alone edits them, together with their Adam moments; `order.rs` says which order is quick to render.

mod adaptive;
mod config;
mod consistency;
mod mcmc;
mod noise;
mod order;
pub mod rows;
mod strategy;

pub use adaptive::{Adaptive, AdaptiveConfig};
pub use config::DensityConfig;
pub use consistency::ConsistencyConfig;
pub use mcmc::{Mcmc, McmcConfig};
pub use order::morton_order;
pub use strategy::{At, Observed, RefineReport, Signals, Strategy};

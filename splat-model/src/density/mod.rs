//! Density control: the number of Gaussians and their positions. A [`Strategy`] selects the rows to keep, copy and add
//! (`adaptive.rs`, `mcmc.rs`, or a custom one) in tensor code on the scene's device, from the tools of `pick.rs`; only counts are read
//! back. Only `rows.rs` edits rows, together with their Adam moments. `order.rs` computes the order that renders fastest.

mod adaptive;
mod config;
mod focus;
mod mcmc;
mod noise;
mod order;
mod pick;
mod rotate;
pub mod rows;
mod strategy;
mod tally;

pub use adaptive::{Adaptive, AdaptiveConfig, Division, GRADUAL_OPACITY_WEIGHT};
pub use config::DensityConfig;
pub use focus::Focus;
pub use mcmc::{Mcmc, McmcConfig};
pub use order::morton_order;
pub(crate) use pick::rounded_down;
pub use pick::{counts, largest, picked, rows_on};
pub use strategy::{Observed, RefineReport, Refined, Signals, Strategy, StrategyContext};

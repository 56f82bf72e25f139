//! Gaussian scenes as ordinary Burn tensor code: captures, model, losses, optimiser, densification, metrics, formats.

pub mod accuracy;
pub mod capture;
pub mod density;
pub mod effects;
pub mod evaluate;
pub mod gaussians;
pub mod init;
mod json;
pub mod loss;
pub mod metrics;
pub mod optim;
pub mod ply;
pub mod state;
pub mod trainer;

//! Gaussian scenes as ordinary Burn tensor code: captures, model, losses, optimiser, densification, metrics, formats.

pub mod capture;
pub mod gaussians;
pub mod loss;
pub mod metrics;
pub mod optim;

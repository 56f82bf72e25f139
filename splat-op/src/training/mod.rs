//! What a training step does before and after a render: activations, the photometric loss, Adam, and density control's sums and sorts.

pub mod activate;
pub mod adam;
pub mod argsort;
pub mod loss;
pub mod tally;

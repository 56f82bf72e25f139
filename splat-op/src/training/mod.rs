//! What a training step does before and after a render: activations, the photometric loss, Adam, and the sorts of density control.

pub mod activate;
pub mod adam;
pub mod argsort;
pub mod loss;

//! What the unit tests of the stages share.

pub mod finite;
#[cfg(feature = "cube")]
pub mod gpu;
pub mod random;

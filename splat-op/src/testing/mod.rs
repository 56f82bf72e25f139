//! What the unit tests of the stages share.

#[cfg(feature = "cube")]
pub mod ceiling;
pub mod finite;
#[cfg(feature = "cube")]
pub mod gpu;
pub mod random;

//! Helpers shared by the unit tests of the stages.

pub mod blending;
pub mod ceiling;
#[cfg(feature = "cube")]
pub mod ellipses;
pub mod finite;
#[cfg(feature = "cube")]
pub mod gpu;
pub mod lenses;
#[path = "../../../tests/hard-cases/src/random.rs"]
pub mod random;

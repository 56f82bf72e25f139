//! What the unit tests of the stages share.

pub mod finite;
pub mod random;

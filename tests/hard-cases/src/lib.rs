//! The battery of hard cases: small scenes built in code on which splatting loses digits, leaves the range of f32 or divides by
//! zero, each with a sentence on why. They run on every path, forwards and backwards, and are compared with a reference.
//!
//! [`battery`] lists the cases, [`judge`] runs one, and [`table`] prints the results beside those of the
//! [`textbook`]'s formulas on the same scenes.
//!
//! A case that is not a scene is a [`Check`]: a function of the [`TestDevice`] that returns an [`CaseOutcome`].

pub mod ceiling;
pub mod compare;
pub mod exact;
pub mod random;
pub mod tensors;

pub mod case;
pub mod cases;
pub mod evaluate;
pub mod judge;
pub mod number;
pub mod panorama;
pub mod scene;
pub mod scratch;
pub mod table;
pub mod textbook;

pub use case::{CaseKind, CaseOutcome, Check, HardCase, Loose, MeasuredDeviation, Processor, TestDevice};
pub use cases::{CaseGroup, GROUPS, battery};

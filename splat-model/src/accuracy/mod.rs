//! The cost of accuracy in time: the dials of a render by name, their measurements, and the choice between them.
//!
//! [`DIALS`] is the one table of dials. A [`Setting`] holds values of some of them, as files and command lines do.
//! `splat pareto` measures settings on a scene and a device and writes a [`Frontier`]; [`Frontier::choose`] picks a setting
//! from it.

mod choice;
mod dials;
mod frontier;
mod measured;
mod provenance;
mod setting;

pub use self::choice::{ChosenSetting, NoChoice, Target, Workload};
pub use self::dials::{DIALS, Dial, DialValue, Judge};
pub use self::frontier::{FrontierPoint, Spread, frontier};
pub use self::measured::{Frontier, FrontierError, Measured, STANDARD, decibels};
pub use self::provenance::Provenance;
pub use self::setting::{DialError, Preset, PresetError, Setting};

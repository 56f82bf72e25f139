//! The cost of accuracy in time: the dials of a render by name.
//!
//! [`DIALS`] is the one table of dials. A [`Setting`] holds values of some of them, as files and command lines do; a [`Preset`] names
//! one. `splat pareto` measures all of them on a scene and a device.

mod dials;
mod setting;

pub use self::dials::{DIALS, Dial, DialValue, Judge};
pub use self::setting::{DialError, Preset, Setting};

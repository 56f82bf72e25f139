//! Adam and the schedules of its learning rates.

pub mod adam;
pub mod moments;
pub mod schedule;

pub use adam::{Adam, Rates};
pub use moments::{MomentBits, Moments};
pub use schedule::{LearningRates, near_plane, scene_extent, sh_degree_at, sh_every_for};

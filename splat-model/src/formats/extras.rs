//! What JSON documents of scenes keep for this program in `extras`, which glTF and SOG leave to applications: `origin`, three numbers,
//! `metres_per_unit` and `trained`. Content of another form is ignored.

use glam::DVec3;
use serde::Deserialize;
use serde_json::{Map, Value, json};

use crate::ply::{TrainedAs, WorldFrame};

/// Returns the members that hold a frame; none for a scene at the world's origin whose size is not known and that was trained as usual.
pub(super) fn of(world: WorldFrame) -> Map<String, Value> {
    let mut extras = Map::new();
    if world.origin != DVec3::ZERO {
        extras.insert("origin".into(), json!(world.origin.to_array()));
    }
    if let Some(metres) = world.metres_per_unit {
        extras.insert("metres_per_unit".into(), json!(metres));
    }
    if world.trained != TrainedAs::default() {
        extras.insert("trained".into(), json!(world.trained));
    }
    extras
}

/// Reads the frame from a document's `extras`.
pub(super) fn world(extras: &Value) -> WorldFrame {
    let origin = <[f64; 3]>::deserialize(&extras["origin"]).ok().map(DVec3::from_array);
    let metres = extras["metres_per_unit"].as_f64();
    WorldFrame {
        origin: origin.filter(|origin| origin.is_finite()).unwrap_or_default(),
        metres_per_unit: metres.filter(|metres| metres.is_finite() && *metres > 0.0),
        trained: TrainedAs::deserialize(&extras["trained"]).unwrap_or_default(),
    }
}

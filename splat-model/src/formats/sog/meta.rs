//! `meta.json`.

use serde::{Deserialize, Serialize};
use serde_json::Value;

/// The document of a scene.
#[derive(Deserialize, Serialize)]
pub struct Meta {
    pub version: u32,
    #[serde(default)]
    pub asset: Value,
    pub count: usize,
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub antialias: bool,
    pub means: Means,
    pub scales: ValueCodes,
    pub quats: PictureFiles,
    pub sh0: ValueCodes,
    #[serde(rename = "shN", skip_serializing_if = "Option::is_none")]
    pub sh_n: Option<Harmonics>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub extras: Option<Value>,
}

/// Ranges of the centres by axis, of the compressed coordinates ([`super::compressed`]).
#[derive(Deserialize, Serialize)]
pub struct Means {
    pub mins: [f64; 3],
    pub maxs: [f64; 3],
    pub files: [String; 2],
}

/// Values, and the picture of their indices.
#[derive(Deserialize, Serialize)]
pub struct ValueCodes {
    pub codebook: Vec<f32>,
    pub files: [String; 1],
}

#[derive(Deserialize, Serialize)]
pub struct PictureFiles {
    pub files: [String; 1],
}

/// The palette of higher harmonics.
#[derive(Deserialize, Serialize)]
pub struct Harmonics {
    /// Number of entries.
    pub count: usize,
    /// Degree of the spherical harmonics.
    pub bands: usize,
    pub codebook: Vec<f32>,
    /// The palette, and the indices in it.
    pub files: [String; 2],
}

//! Scenes for tests of every format.

use std::fs;
use std::path::PathBuf;

use proptest::prelude::*;

use crate::gaussians::GaussianRows;

/// Rows that can be rendered and that the formats can hold: centres within ±`reach`, standard deviations within the range of SPZ,
/// harmonics within ±1.
pub fn rows(count: usize, sh_degree: usize, reach: f32) -> impl Strategy<Value = GaussianRows> {
    let rest = 3 * ((sh_degree + 1) * (sh_degree + 1) - 1);
    let unit = -1.0_f32..1.0;
    prop::collection::vec(unit, count * (14 + rest)).prop_map(move |values| {
        let mut rows = GaussianRows { sh_degree, ..GaussianRows::default() };
        for v in values.chunks_exact(14 + rest) {
            rows.means.push([v[0], v[1], v[2]].map(|x| reach * x));
            // The length must not be zero.
            rows.rotations.push([v[3] + v[3].signum() * 0.1, v[4], v[5], v[6]]);
            rows.log_scales.push([v[7], v[8], v[9]].map(|x| 7.5 * x - 2.1));
            rows.logit_opacities.push(9.0 * v[10]);
            rows.sh_dc.push([v[11], v[12], v[13]].map(|x| 3.2 * x));
            rows.sh_rest.extend(&v[14..]);
        }
        rows
    })
}

/// A file written by another project, see the README there.
pub fn fixture(name: &str) -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("tests/scenes").join(name)
}

/// Calls `read` with every prefix of a file, and with each of its bytes changed in three ways; of a long file, with two thousand places evenly in
/// it. Returns the number of accepted files of both kinds. The check is that `read` returns at all.
pub fn spoil(bytes: &[u8], mut read: impl FnMut(&std::path::Path) -> bool) -> [usize; 2] {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("spoilt");
    let mut accepted = [0; 2];
    let step = bytes.len().div_ceil(2_000);
    for length in (0..bytes.len()).step_by(step) {
        fs::write(&path, &bytes[..length]).unwrap();
        accepted[0] += usize::from(read(&path));
    }
    for at in (0..bytes.len()).step_by(step) {
        for flip in [1, 0x80, 0xff] {
            let mut spoilt = bytes.to_vec();
            spoilt[at] ^= flip;
            fs::write(&path, &spoilt).unwrap();
            accepted[1] += usize::from(read(&path));
        }
    }
    accepted
}

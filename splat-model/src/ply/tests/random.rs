//! Random scenes, and files with random damage.

use glam::DVec3;
use proptest::prelude::*;

use super::super::row::{names, rest_per_channel};
use super::{bits, header, read_bytes, round_trip, written_bytes};
use crate::gaussians::GaussianRows;

fn any_rows() -> impl Strategy<Value = GaussianRows> {
    // Every bit pattern but NaN, whose payload other programs may change.
    let float = any::<u32>().prop_map(f32::from_bits).prop_filter("NaN", |x| !x.is_nan());
    (0_usize..=4, 0_usize..5).prop_flat_map(move |(degree, count)| {
        let rest = 3 * rest_per_channel(degree);
        prop::collection::vec(float.clone(), count * (14 + rest)).prop_map(move |values| {
            let mut rows = GaussianRows { sh_degree: degree, ..GaussianRows::default() };
            for v in values.chunks_exact(14 + rest) {
                rows.means.push([v[0], v[1], v[2]]);
                rows.rotations.push([v[3], v[4], v[5], v[6]]);
                rows.log_scales.push([v[7], v[8], v[9]]);
                rows.logit_opacities.push(v[10]);
                rows.sh_dc.push([v[11], v[12], v[13]]);
                rows.sh_rest.extend(&v[14..]);
            }
            rows
        })
    })
}

proptest! {
    #[test]
    fn random_rows_round_trip(rows in any_rows(), origin in any::<[i32; 3]>()) {
        let origin = DVec3::from_array(origin.map(|x| f64::from(x) / 7.0));
        let (back, back_origin) = round_trip(&rows, origin);
        prop_assert_eq!(bits(&back), bits(&rows));
        prop_assert_eq!(back_origin, origin);
    }

    #[test]
    fn random_bytes_never_panic(bytes in prop::collection::vec(any::<u8>(), 0..400), magic in any::<bool>()) {
        let _ = read_bytes(&[if magic { b"ply\n".as_slice() } else { b"" }, &bytes].concat());
    }

    #[test]
    fn mutated_files_never_panic(
        rows in any_rows(),
        edits in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..8),
        cut in any::<prop::sample::Index>(),
        keep_length in any::<bool>(),
    ) {
        let mut bytes = written_bytes(&rows);
        for (at, byte) in edits {
            let at = at.index(bytes.len());
            bytes[at] = byte;
        }
        if !keep_length {
            bytes.truncate(cut.index(bytes.len()));
        }
        let _ = read_bytes(&bytes);
    }

    #[test]
    fn mutated_ascii_files_never_panic(
        edits in prop::collection::vec((any::<prop::sample::Index>(), prop::sample::select(b" \n-e.19x".to_vec())), 1..6),
    ) {
        let head = header(2, &names(0)).replace("binary_little_endian", "ascii");
        let mut bytes = format!("{head}{0}\n{0}\n", ["-1.5e3"; 17].join(" ")).into_bytes();
        for (at, byte) in edits {
            let at = at.index(bytes.len());
            bytes[at] = byte;
        }
        let _ = read_bytes(&bytes);
    }
}

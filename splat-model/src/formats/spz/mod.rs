//! Niantic's SPZ (<https://github.com/nianticlabs/spz>, read from its README and `load-spz.cc`). Written as version 3, which more
//! programs read than any other; versions 1 to 4 are read.
//!
//! Versions 1 to 3 are one gzip stream. It begins with 16 bytes, little endian: `NGSP`, the version (u32), the number of Gaussians
//! (u32), the degree of the spherical harmonics, the bits of a fraction of a unit, flags (1: trained with antialiasing; 2: records of
//! extensions follow the last section), 0. Then come sections, each for all Gaussians:
//!
//! | section | bytes | holds |
//! |---|---|---|
//! | positions | 9 | `x y z`, 24-bit two's complement, in units of 2^−fraction; version 1: 16-bit floats |
//! | opacities | 1 | 255 times the opacity |
//! | colours | 3 | `127.5 + 0.15 · 255 · f_dc` by channel |
//! | scales | 3 | `16 (ln σ + 10)` |
//! | rotations | 4 | two bits for which of `x y z w` is the largest, then for each other a sign and 9 bits of its size in √½; versions 1 and 2: 3 bytes, `127.5 + 127.5 (x y z)`, `w` positive |
//! | harmonics | 3 for each higher coefficient | `128 + 128 c`, channels innermost; multiples of 8 at degree 1 and of 16 above, as the reference writes them |
//!
//! Version 4 has 32 bytes of header (number of streams in the last byte of the first 16, then u32 where the table begins) without
//! compression, records of extensions, a table of the sections' compressed and plain sizes (two u64 each), and the sections, each a
//! zstd stream; those of no bytes are left out. Extensions are passed over.
//!
//! **Frame.** The format says right-up-back, scenes here and in PLY are right-down-front: `y` and `z` change their signs on the way in
//! and out, and with them those components of rotations and the harmonics that are odd in them ([`frame`]).
//!
//! **Fractions.** As many bits as the farthest centre leaves: the reference writes 12 always. All readers that were looked at go by the
//! header.
//!
//! **Crates that were looked at**: `spz` 0.0.6 (Jackneill) takes lengths from the header without looking at the file, so that a hundred
//! bytes can ask for terabytes, overflows in shifts on others, reads rotations of version 2 as zero, and brings tokio and clap;
//! `spz_rs` 0.1.0 reads versions 1 and 2 only and trusts headers likewise; `wgpu-3dgs-core` 0.8.0 brings another wgpu. None reads
//! version 4. The first is what tests read our files with.

mod frame;
mod pack;
mod read;
#[cfg(test)]
mod tests;
mod write;

pub(super) use read::{is_spz, read};
pub(super) use write::write;

/// `NGSP`, which version 4 begins with, and the other versions' plain bytes.
const MAGIC: [u8; 4] = *b"NGSP";

/// What gzip begins with.
const GZIP: [u8; 2] = [0x1f, 0x8b];

/// Set in a scene that was trained with antialiasing.
const ANTIALIASED: u8 = 1;

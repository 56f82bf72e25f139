//! Niantic's SPZ (<https://github.com/nianticlabs/spz>, from its README and `load-spz.cc`). Versions 1 to 4 are read. Version 4 is
//! written, as current programs do, or version 3 on request.
//!
//! Versions 1 to 3 are one gzip stream. It begins with 16 bytes, little endian: `NGSP`, the version (u32), the number of
//! Gaussians (u32), the degree of the spherical harmonics, the number of fractional bits of positions, flags (1: trained with
//! antialiasing; 2: records of extensions follow the last section), 0. The sections follow, each for all Gaussians:
//!
//! | section | bytes | holds |
//! |---|---|---|
//! | positions | 9 | `x y z`, 24-bit two's complement, in units of 2^−fraction; version 1: 16-bit floats |
//! | opacities | 1 | 255 times the opacity |
//! | colours | 3 | `127.5 + 0.15 · 255 · f_dc` by channel |
//! | scales | 3 | `16 (ln σ + 10)` |
//! | rotations | 4 | two bits for the index of the largest of `x y z w`, then for each other component a sign and 9 bits of its magnitude in √½; versions 1 and 2: 3 bytes, `127.5 + 127.5 (x y z)`, `w` positive |
//! | harmonics | 3 for each higher coefficient | `128 + 128 c`, channels innermost; multiples of 8 at degree 1 and of 16 above unless other bits are asked for, as the reference writes them |
//!
//! Version 4 begins with an uncompressed header of 32 bytes; the last of its first 16 bytes is the number of streams, and the
//! next u32 is the position of the table. Records of extensions, a table of the sections' compressed and plain sizes (two u64
//! each) and the sections follow. Each section is a zstd stream; empty sections are left out. Extensions are skipped. The sections are
//! those of version 3: the same bits, another compression.
//!
//! **Frame.** The format is right-up-back; scenes here and in PLY are right-down-front. Reading and writing change the signs of
//! `y` and `z`, of these components of rotations, and of the harmonics that are odd in them ([`super::frame`]).
//!
//! **Fractions.** Positions are written with as many fractional bits as the farthest centre leaves, but with no fewer than a room of
//! 512 times the scene's width leaves: centres beyond that are moved to its border ([`reach`]). The reference always writes 12. All
//! examined readers use the header's number.
//!
//! **Examined crates.** `spz` 0.0.6 (Jackneill) takes lengths from the header without checking the file, so that a hundred
//! bytes can request terabytes, overflows in shifts for other headers, reads rotations of version 2 as zero, and depends on tokio and clap.
//! `spz_rs` 0.1.0 reads only versions 1 and 2 and trusts headers likewise. `wgpu-3dgs-core` 0.8.0 depends on another wgpu. None reads
//! version 4. Tests read our version 3 with the first, and our version 4 with the reference's own code under node (`tests/readers`).
//!
//! **zstd.** The crate `zstd` binds the reference implementation and writes; `ruzstd`, whose encoder has the fastest level only, reads,
//! because files from elsewhere are safer with it.

mod pack;
mod reach;
mod read;
#[cfg(test)]
mod tests;
mod write;

pub(super) use reach::bring_within_reach;
pub(super) use read::{is_spz, read};
pub(super) use write::write;
pub use write::{SpzOptions, SpzVersion};

/// First bytes of version 4, and of the decompressed stream of the other versions.
pub(super) const MAGIC: [u8; 4] = *b"NGSP";

const GZIP: [u8; 2] = [0x1f, 0x8b];

/// Bytes of the header of version 4; the other versions have the first 16 of them.
const HEADER: usize = 32;

/// Flag of a scene that was trained with antialiasing.
const ANTIALIASED: u8 = 1;

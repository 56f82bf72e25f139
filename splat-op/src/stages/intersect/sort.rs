//! A stable radix sort of u32 keys on the device: least significant digit first, eight bits and a launch a pass.
//!
//! At most [`CHUNKS`] cubes share the keys; each has a chunk of consecutive keys. A first launch counts the lowest digit by chunk. In the
//! launch of a pass each cube adds up the table of its digit to learn where its keys belong, moves its keys tile by tile, in order, and
//! counts the next digit by the chunks into which they go. Launches cost the host as much as small passes cost the device.
//!
//! The rank of a key among the equal digits of its tile comes from bits in shared memory: of 32 neighbouring keys, each
//! sets its bit in the word of its digit, and counts the bits below. Where these 32 units lie in one plane, they wait for one
//! another and not for the cube: a tile then takes 10 barriers of the cube instead of 26. The keys of a tile are ordered in shared
//! memory before they are written, so most writes are runs.
//!
//! There is no second form with ballots. It would replace an atomic and two waits of a plane by eight ballots, about the same
//! work. CUB has both forms (`WARP_MATCH_ANY`, `WARP_MATCH_ATOMIC_OR`) and calls the one with bits the faster one where few
//! neighbours are equal. Here they are: after a pass over the low digits neighbours differ, but for the last digit of the depths.

use cubecl::prelude::*;

use crate::gpu::{Buffer, Gpu, SHARED_BYTES, SUM_ROOM, UNITS, cube_exclusive_sum, given, launch_unchecked, wait};

/// Key of what the sort leaves out.
pub(crate) const HIDDEN: u32 = u32::MAX;

/// Number of bits of a digit. A cube has a unit for each digit.
const DIGIT_BITS: u32 = 8;
const DIGITS: usize = 1 << DIGIT_BITS;
const _: () = assert!(DIGITS == UNITS);

/// Largest number of chunks: each cube reads the digits of all chunks.
const CHUNKS: usize = 256;

/// Number of keys of a unit in a tile.
const PER_UNIT: usize = 8;

/// Number of keys that a cube moves at a time.
const SORT_TILE: usize = UNITS * PER_UNIT;

/// Number of neighbouring keys whose ranks come from one word: the bits of a word.
const RANK_LANES: usize = 32;

/// Number of groups of [`RANK_LANES`] units.
const GROUPS: usize = UNITS / RANK_LANES;

/// The same shared memory holds a word for each group and digit, and the keys of a tile.
const _: () = assert!(GROUPS * DIGITS == SORT_TILE);

/// Shared memory of `scatter_kernel`: the words, the counters, the distances, the sums and the bound.
const _: () = assert!(4 * (SORT_TILE + GROUPS * DIGITS / 2 + DIGITS + SUM_ROOM + 1) <= SHARED_BYTES);

/// Number of chunks whose digits a unit loads at a time.
const CHUNKS_AT_ONCE: usize = 8;

/// Number of tiles until the counters of a byte are added up. Units of the same lane share counters.
const TILES_PER_COUNT: usize = 3;
const _: () = assert!(TILES_PER_COUNT * PER_UNIT * GROUPS < 256);

/// Returns the first of the values. WebGPU takes barriers in a loop only if the loop's bound is known to be the same in all units.
#[cube]
pub(super) fn uniform(values: &[u32]) -> u32 {
    let mut value = Shared::<[u32]>::new_slice(1usize);
    if UNIT_POS == 0 {
        value[0] = values[0];
    }
    workgroup_uniform_load(&value[0])
}

/// Returns the first key of this cube's chunk and the key after its last, of `count` keys if it is given, else of `len`. Chunks
/// begin at multiples of 32.
#[cube]
fn chunk(count: &ComptimeOption<Box<[u32]>>, len: u32, chunks: u32) -> (u32, u32) {
    let mut len = len;
    #[comptime]
    if let ComptimeOption::Some(count) = count {
        len = uniform(count);
    }
    let each = len.div_ceil(chunks).div_ceil(32) * 32;
    let first = min(CUBE_POS as u32 * each, len);
    (first, min(first + each, len))
}

#[cube]
fn digit_of(key: u32, shift: u32) -> u32 {
    (key >> shift) & comptime!(DIGITS as u32 - 1)
}

/// Reads the 16-bit counter `digit` of a row of packed counters.
#[cube]
fn counter(counters: &Shared<[Atomic<u32>]>, row: u32, digit: u32) -> u32 {
    (counters[(row + digit / 2) as usize].load() >> (16 * (digit & 1))) & 0xffff
}

/// Writes `tables[0][chunk][digit]`, the number of keys of each chunk by the lowest digit, and zeros in the tables of the other
/// digits. A counter is a byte. Each of 32 lanes has counters of its own, all in one bank of shared memory.
#[cube(launch_unchecked)]
fn count_digits_kernel(
    keys: &[u32],
    count: ComptimeOption<Box<[u32]>>,
    tables: &mut [u32],
    len: u32,
    chunks: u32,
    passes: u32,
) {
    let counters = Shared::<[Atomic<u32>]>::new_slice(comptime!(DIGITS / 4 * RANK_LANES));
    let unit = UNIT_POS;
    let lane = unit % comptime!(RANK_LANES as u32);
    let (first, end) = chunk(&count, len, chunks);
    let mut total = 0u32;
    let mut from = first;
    while from < end {
        #[unroll]
        for i in 0..comptime!(DIGITS / 4 * RANK_LANES / UNITS) {
            counters[UNIT_POS as usize + i * comptime!(UNITS)].store(0u32);
        }
        sync_cube();
        for tile in 0..comptime!(TILES_PER_COUNT as u32) {
            let at = from + tile * comptime!(SORT_TILE as u32) + unit;
            let mut own = Array::<u32>::new(comptime!(PER_UNIT));
            #[unroll]
            for i in 0..comptime!(PER_UNIT) {
                let at = at + comptime!((i * UNITS) as u32);
                own[i] = HIDDEN;
                if at < end {
                    own[i] = keys[at as usize];
                }
            }
            #[unroll]
            for i in 0..comptime!(PER_UNIT) {
                if own[i] != HIDDEN {
                    let digit = digit_of(own[i], 0u32);
                    let word = digit / 4 * comptime!(RANK_LANES as u32) + lane;
                    counters[word as usize].fetch_add(1u32 << (8 * (digit % 4)));
                }
            }
        }
        sync_cube();
        // Neighbouring units begin in neighbouring banks.
        for i in 0..comptime!(RANK_LANES as u32) {
            let word = unit / 4 * comptime!(RANK_LANES as u32) + (unit + i) % comptime!(RANK_LANES as u32);
            total += (counters[word as usize].load() >> (8 * (unit % 4))) & 0xff;
        }
        sync_cube();
        from += comptime!((TILES_PER_COUNT * SORT_TILE) as u32);
    }
    for pass in 0..passes {
        let row = (pass * chunks) as usize + CUBE_POS;
        tables[row * comptime!(DIGITS) + UNIT_POS as usize] = select(pass == 0, total, 0u32);
    }
}

/// Writes the keys that are not hidden, and their values, in the order of a digit, and the number of them. Without values, they are the
/// indices of the keys. Adds up `next[chunk][digit]`, the numbers of keys by the next digit and the chunk to which they go.
#[cube(launch_unchecked)]
fn scatter_kernel(
    keys: &[u32],
    values: ComptimeOption<Box<[u32]>>,
    count: ComptimeOption<Box<[u32]>>,
    table: &[u32],
    next: ComptimeOption<Box<[Atomic<u32>]>>,
    sorted_keys: &mut [u32],
    sorted_values: &mut [u32],
    kept: &mut [u32],
    len: u32,
    chunks: u32,
    shift: u32,
    #[comptime] planes: bool,
    #[comptime] _given: u32,
) {
    // A word for each group and digit while keys are ranked; afterwards the keys, then the values, in order.
    let words = Shared::<[Atomic<u32>]>::new_slice(comptime!(SORT_TILE));
    // Two counters to a word, for each group and digit: its keys so far; then its first rank in the tile.
    let counters = Shared::<[Atomic<u32>]>::new_slice(comptime!(GROUPS * DIGITS / 2));
    // For each digit the distance from the ranks of its keys in the tile to their places; it may wrap.
    let mut distances = Shared::<[u32]>::new_slice(comptime!(DIGITS));
    let mut sums = Shared::<[u32]>::new_slice(comptime!(SUM_ROOM));
    let unit = UNIT_POS;
    let lane = unit % comptime!(RANK_LANES as u32);
    let group = unit / comptime!(RANK_LANES as u32);
    let (word_row, counter_row) = (group * comptime!(DIGITS as u32), group * comptime!(DIGITS as u32 / 2));

    // The unit's digit: its keys in all chunks and in the chunks before this one.
    let mut of_digit = 0u32;
    let mut before = 0u32;
    let own_chunk = CUBE_POS as u32;
    for step in 0..chunks.div_ceil(comptime!(CHUNKS_AT_ONCE as u32)) {
        #[unroll]
        for i in 0..comptime!(CHUNKS_AT_ONCE as u32) {
            let chunk = step * comptime!(CHUNKS_AT_ONCE as u32) + i;
            let row = min(chunk, chunks - 1) as usize;
            let here = select(chunk < chunks, table[row * comptime!(DIGITS) + UNIT_POS as usize], 0);
            of_digit += here;
            before += select(chunk < own_chunk, here, 0);
        }
    }
    let (smaller, total) = cube_exclusive_sum(of_digit, &mut sums);
    if own_chunk == 0 && unit == 0 {
        kept[0] = total;
    }
    distances[UNIT_POS as usize] = smaller + before;
    // As `chunk` of the next pass.
    let each_next = max(total.div_ceil(chunks).div_ceil(32) * 32, 1u32);
    sync_cube();
    // The units of the first half have two digits each.
    let pair = 2 * (UNIT_POS as usize % comptime!(DIGITS / 2));
    let (mut place_low, mut place_high) = (distances[pair], distances[pair + 1]);

    let (first, end) = chunk(&count, len, chunks);
    let mut from = first;
    while from < end {
        let at = from + group * comptime!((RANK_LANES * PER_UNIT) as u32) + lane;
        let mut own = Array::<u32>::new(comptime!(PER_UNIT));
        let mut value = Array::<u32>::new(comptime!(PER_UNIT));
        let mut rank = Array::<u32>::new(comptime!(PER_UNIT));
        #[unroll]
        for i in 0..comptime!(PER_UNIT) {
            let at = at + comptime!((i * RANK_LANES) as u32);
            own[i] = HIDDEN;
            value[i] = at;
            if at < end {
                own[i] = keys[at as usize];
                #[comptime]
                if let ComptimeOption::Some(values) = &values {
                    value[i] = values[at as usize];
                }
            }
            words[UNIT_POS as usize + i * comptime!(UNITS)].store(0u32);
        }
        #[unroll]
        for i in 0..comptime!(GROUPS * DIGITS / 2 / UNITS) {
            counters[UNIT_POS as usize + i * comptime!(UNITS)].store(0u32);
        }
        sync_cube();

        // Ranks among the keys of the same group and digit.
        #[unroll]
        for i in 0..comptime!(PER_UNIT) {
            let shown = own[i] != HIDDEN;
            let digit = digit_of(own[i], shift);
            let word = (word_row + digit) as usize;
            let bit = 1u32 << lane;
            if shown {
                words[word].fetch_add(bit);
            }
            wait(planes);
            let mut same = 0u32;
            if shown {
                same = words[word].load();
                rank[i] = counter(&counters, counter_row, digit) + (same & (bit - 1)).count_ones();
            }
            wait(planes);
            // The last of the equal keys counts them all and takes their bits away. The next keys may set theirs meanwhile.
            if shown && (same >> lane) == 1 {
                words[word].fetch_sub(same);
                counters[(counter_row + digit / 2) as usize].fetch_add(same.count_ones() << (16 * (digit & 1)));
            }
        }
        sync_cube();

        // First rank of each digit and group in the tile, for two digits at once.
        let mut both = 0u32;
        if unit < comptime!(DIGITS as u32 / 2) {
            #[unroll]
            for group in 0..comptime!(GROUPS) {
                both += counters[group * comptime!(DIGITS / 2) + UNIT_POS as usize].load();
            }
        }
        let (low, high) = (both & 0xffff, both >> 16);
        let (start, in_tile) = cube_exclusive_sum(low + high, &mut sums);
        if unit < comptime!(DIGITS as u32 / 2) {
            let mut ranks = start | ((start + low) << 16);
            #[unroll]
            for group in 0..comptime!(GROUPS) {
                let cell = group * comptime!(DIGITS / 2) + UNIT_POS as usize;
                let here = counters[cell].load();
                counters[cell].store(ranks);
                ranks += here;
            }
            distances[pair] = place_low - start;
            distances[pair + 1] = place_high - (start + low);
            place_low += low;
            place_high += high;
        }
        sync_cube();

        #[unroll]
        for i in 0..comptime!(PER_UNIT) {
            if own[i] != HIDDEN {
                rank[i] += counter(&counters, counter_row, digit_of(own[i], shift));
                words[rank[i] as usize].store(own[i]);
            }
        }
        sync_cube();
        let mut place = Array::<u32>::new(comptime!(PER_UNIT));
        #[unroll]
        for i in 0..comptime!(PER_UNIT) {
            let in_order = unit + comptime!((i * UNITS) as u32);
            place[i] = 0u32;
            if in_order < in_tile {
                let key = words[in_order as usize].load();
                place[i] = distances[digit_of(key, shift) as usize] + in_order;
                sorted_keys[place[i] as usize] = key;
                #[comptime]
                if let ComptimeOption::Some(next) = &next {
                    let row = (place[i] / each_next) as usize * comptime!(DIGITS);
                    next[row + digit_of(key, shift + comptime!(DIGIT_BITS)) as usize].fetch_add(1u32);
                }
            }
        }
        sync_cube();
        #[unroll]
        for i in 0..comptime!(PER_UNIT) {
            if own[i] != HIDDEN {
                words[rank[i] as usize].store(value[i]);
            }
        }
        sync_cube();
        #[unroll]
        for i in 0..comptime!(PER_UNIT) {
            let in_order = unit + comptime!((i * UNITS) as u32);
            if in_order < in_tile {
                sorted_values[place[i] as usize] = words[in_order as usize].load();
            }
        }
        sync_cube();
        from += comptime!(SORT_TILE as u32);
    }
}

/// Keys in ascending order without the hidden ones.
#[derive(Clone, Debug)]
pub(crate) struct Sorted {
    /// Room for all keys; only the first `kept` are written.
    pub keys: Buffer<u32>,
    /// Index of each of these keys in the given order.
    pub indices: Buffer<u32>,
    /// `[1]`: number of keys that are not hidden.
    pub kept: Buffer<u32>,
}

/// Sorts keys below `2^bits`, leaving out those that are [`HIDDEN`]; equal keys keep their order. With `count`, `[1]` or
/// longer, only so many of the first keys exist. The buffer of the keys is used as scratch.
pub(crate) fn launch_sort(gpu: &Gpu, keys: Buffer<u32>, count: Option<Buffer<u32>>, bits: u32) -> Sorted {
    let len = keys.len;
    let planes = gpu.plane_units.is_some_and(|units| units % RANK_LANES as u32 == 0);
    let chunks = len.div_ceil(SORT_TILE).clamp(1, CHUNKS);
    let passes = bits.div_ceil(DIGIT_BITS).max(1);
    let tables = Buffer::<u32>::new(gpu, passes as usize * chunks * DIGITS);
    let table = |pass: u32| tables.part(pass as usize * chunks * DIGITS, chunks * DIGITS);
    let room = || Buffer::with_headroom(gpu, len);
    let (mut from, mut count) = (keys, count);
    // Two buffers in turn take the keys, and two the values.
    let (mut to, mut values, mut spare_values) = (room(), None, None);
    // SAFETY: reads are guarded by the length of a chunk, and there is a table for each pass.
    launch_unchecked!(gpu.cubes(chunks), count_digits_kernel(&from, &count, &tables, len, chunks, passes));
    for pass in 0..passes {
        let (moved, kept) = (spare_values.take().unwrap_or_else(room), Buffer::new(gpu, 1));
        let next = (pass + 1 < passes).then(|| table(pass + 1));
        let (table, shift, given) = (table(pass), DIGIT_BITS * pass, given([&values, &count, &next]));
        // SAFETY: as above; places stay below `len` because the table counts every key that is moved once.
        launch_unchecked!(
            gpu.cubes(chunks),
            scatter_kernel(
                &from, &values, &count, &table, &next, &to, &moved, &kept, len, chunks, shift, planes, given
            )
        );
        std::mem::swap(&mut from, &mut to);
        spare_values = values.replace(moved);
        count = Some(kept);
    }
    let (indices, kept) = values.zip(count).expect("there is at least one pass");
    Sorted { keys: from, indices, kept }
}

//! Mutations of bytes, of fields, and of words of the format.

use super::engine::FuzzTarget;

/// A stream of numbers (splitmix64, Steele et al. 2014).
pub struct Mutator(u64);

impl Mutator {
    pub fn new(seed: u64) -> Self {
        Self(seed)
    }

    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    /// Returns a number from 0 to `end`, exclusive; 0 if `end` is 0.
    pub fn below(&mut self, end: usize) -> usize {
        (self.next() % end.max(1) as u64) as usize
    }

    pub fn pick<'a, T>(&mut self, from: &'a [T]) -> &'a T {
        &from[self.below(from.len())]
    }

    /// Returns a random range within `len` elements, short ranges more often.
    fn range(&mut self, len: usize) -> std::ops::Range<usize> {
        let start = self.below(len);
        let power = self.below(12);
        let most = (len - start).min(1 << power);
        start..start + self.below(most + 1)
    }
}

/// Numbers as text that often break readers.
const TEXT_NUMBERS: [&str; 26] = [
    "0",
    "-1",
    "1",
    "-0",
    "4294967295",
    "4294967296",
    "2147483648",
    "-2147483649",
    "18446744073709551615",
    "18446744073709551616",
    "9223372036854775807",
    "340282350000000000000000000000000000000",
    "1e39",
    "1e309",
    "-1e309",
    "1e-400",
    "5e-324",
    "nan",
    "NaN",
    "-inf",
    "inf",
    "+1",
    "0x10",
    "1_000",
    "00000000000000000000000000001",
    "1.5.5",
];

const INTEGERS: [u64; 13] =
    [0, 1, 2, 255, 0x7fff, 0x8000, 0x7fff_ffff, 0x8000_0000, 0xffff_ffff, 1 << 32, i64::MAX as u64, 1 << 63, u64::MAX];

const FLOATS: [f64; 11] =
    [0.0, -0.0, 1.0, -1.0, f64::NAN, f64::INFINITY, f64::NEG_INFINITY, f64::MAX, 5e-324, 1e15, 1e39];

/// Returns an input of the corpus, changed once or several times. The first `seeds` of the corpus are valid.
pub fn mutate(rng: &mut Mutator, target: &dyn FuzzTarget, corpus: &[Vec<u8>], seeds: usize, longest: usize) -> Vec<u8> {
    // Half of the inputs start from a valid one, to reach deep code. The others start from found inputs, recent ones more often.
    let base = match rng.below(4) {
        0 | 1 => rng.pick(&corpus[..seeds]),
        2 => rng.pick(corpus),
        _ => rng.pick(&corpus[corpus.len().saturating_sub(20)..]),
    };
    let mut input = base.clone();
    let rounds = 1 + rng.below(2) * rng.below(5);
    for _ in 0..rounds {
        input = match rng.below(5) {
            0 | 1 => bytes(rng, input, target, corpus),
            _ => fields(rng, &input, target, corpus),
        };
        input.truncate(longest);
    }
    input
}

/// Changes bytes without knowledge of the format.
fn bytes(rng: &mut Mutator, mut input: Vec<u8>, target: &dyn FuzzTarget, corpus: &[Vec<u8>]) -> Vec<u8> {
    let len = input.len();
    match rng.below(9) {
        0 => input.truncate(rng.below(len + 1)),
        1 if len > 0 => input[rng.below(len)] ^= 1 << rng.below(8),
        2 if len > 0 => input[rng.below(len)] = rng.next() as u8,
        3 => {
            let range = rng.range(len);
            input.drain(range);
        }
        4 => {
            let copied = input[rng.range(len)].to_vec();
            let at = rng.below(len + 1);
            input.splice(at..at, copied);
        }
        5 => {
            let at = rng.below(len + 1);
            let extreme = extreme(rng, 8);
            let end = (at + extreme.len()).min(len);
            input.splice(at..end, extreme);
        }
        6 => {
            // The head of one input and the tail of another.
            let other = rng.pick(corpus);
            input.truncate(rng.below(len + 1));
            input.extend_from_slice(&other[rng.below(other.len() + 1)..]);
        }
        7 => {
            let at = rng.below(len + 1);
            let word = rng.pick(target.words()).bytes();
            input.splice(at..at, word);
        }
        _ => {
            let repeated = input[rng.range(len)].to_vec();
            let at = rng.below(len + 1);
            let times = 1 << rng.below(8);
            input.splice(at..at, repeated.repeat(times).into_iter().take(1 << 15));
        }
    }
    input
}

/// Changes whole fields.
fn fields(rng: &mut Mutator, input: &[u8], target: &dyn FuzzTarget, corpus: &[Vec<u8>]) -> Vec<u8> {
    let mut fields = target.split(input);
    let count = fields.len();
    if count == 0 {
        return rng.pick(corpus).clone();
    }
    let at = rng.below(count);
    match rng.below(9) {
        0..=2 => fields[at] = extreme(rng, fields[at].len()),
        3 => fields[at] = rng.pick(target.words()).as_bytes().to_vec(),
        4 => {
            let range = rng.range(count);
            fields.drain(range);
        }
        5 => {
            let copied = fields[rng.range(count)].to_vec();
            let to = rng.below(count + 1);
            fields.splice(to..to, copied);
        }
        6 => {
            let other = rng.below(count);
            fields.swap(at, other);
        }
        7 => {
            // A field of another input of the format, such as a count in place of a coordinate or a name in place of a count.
            let other: &Vec<u8> = rng.pick(corpus);
            let others = target.split(other);
            if !others.is_empty() {
                fields[at] = rng.pick(&others).clone();
            }
        }
        _ => fields[at] = nudged(rng, &fields[at]),
    }
    fields.concat()
}

/// Returns an extreme value of about the size of the field: text for text, a number of `len` bytes for a binary field.
fn extreme(rng: &mut Mutator, len: usize) -> Vec<u8> {
    let integer = *rng.pick(&INTEGERS);
    let float = *rng.pick(&FLOATS);
    match (rng.below(4), len) {
        (0, _) => rng.pick(&TEXT_NUMBERS).as_bytes().to_vec(),
        (1, 8) => float.to_le_bytes().to_vec(),
        (1, 4) => (float as f32).to_le_bytes().to_vec(),
        (2, _) => integer.to_be_bytes()[8 - len.clamp(1, 8)..].to_vec(),
        _ => integer.to_le_bytes()[..len.clamp(1, 8)].to_vec(),
    }
}

/// Returns a number one larger or smaller, as text or as little-endian bytes, for counts that are off by one.
fn nudged(rng: &mut Mutator, field: &[u8]) -> Vec<u8> {
    let step = if rng.below(2) == 0 { 1_i128 } else { -1 };
    if let Some(number) = str::from_utf8(field).ok().and_then(|text| text.trim().parse::<i64>().ok()) {
        return (i128::from(number) + step).to_string().into_bytes();
    }
    let mut bytes = [0; 8];
    let len = field.len().min(8);
    bytes[..len].copy_from_slice(&field[..len]);
    let moved = u64::from_le_bytes(bytes).wrapping_add_signed(step as i64);
    moved.to_le_bytes()[..len].to_vec()
}

#[test]
fn a_seed_decides_every_number() {
    let draw = |seed| {
        let mut rng = Mutator::new(seed);
        (0..8).map(|_| rng.below(1000)).collect::<Vec<_>>()
    };
    assert_eq!(draw(7), draw(7));
    assert_ne!(draw(7), draw(8));
}

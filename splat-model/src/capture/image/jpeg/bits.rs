//! Codes and bits of the entropy-coded data.

/// Bits of a code that one look at a table resolves.
const QUICK: u32 = 10;

/// A table of Huffman codes (T.81, annex C).
pub struct Codes {
    /// Symbol and length by the next [`QUICK`] bits; length 0 for longer codes.
    quick: Box<[(u8, u8); 1 << QUICK]>,
    /// For each length the first code beyond those of that length, aligned to 16 bits, and the symbols' offset.
    longer: [(u32, i32); 17],
    symbols: Vec<u8>,
}

impl Codes {
    pub fn new(counts: &[u8; 16], symbols: &[u8]) -> Option<Self> {
        let mut codes = Self { quick: Box::new([(0, 0); 1 << QUICK]), longer: [(0, 0); 17], symbols: symbols.to_vec() };
        let (mut code, mut next) = (0_u32, 0_usize);
        for length in 1..=16_u32 {
            let count = usize::from(counts[length as usize - 1]);
            codes.longer[length as usize].1 = next as i32 - code as i32;
            for &symbol in symbols.get(next..next + count)? {
                if length <= QUICK {
                    let from = (code as usize) << (QUICK - length);
                    codes.quick.get_mut(from..from + (1 << (QUICK - length)))?.fill((symbol, length as u8));
                }
                code += 1;
            }
            next += count;
            codes.longer[length as usize].0 = code << (16 - length);
            code <<= 1;
        }
        Some(codes)
    }

    /// The symbol and the length of a code of more than [`QUICK`] bits, with which these 16 begin.
    fn long(&self, next: u32) -> Option<(u8, u8)> {
        let length = (QUICK + 1..=16).find(|&length| next < self.longer[length as usize].0)?;
        let at = (next >> (16 - length)) as i32 + self.longer[length as usize].1;
        Some((*self.symbols.get(usize::try_from(at).ok()?)?, length as u8))
    }
}

/// What is wrong with the data.
pub type Fault = &'static str;

/// They end before the last block.
pub const END: Fault = "end";

/// They hold what no encoder writes, or more than the blocks.
pub const DAMAGED: Fault = "are wrong";

/// The bits between two markers.
#[derive(Clone, Copy)]
pub struct Bits<'a> {
    data: &'a [u8],
    at: usize,
    buffer: u64,
    count: u32,
}

impl<'a> Bits<'a> {
    pub fn new(data: &'a [u8]) -> Self {
        Self { data, at: 0, buffer: 0, count: 0 }
    }

    #[inline]
    fn fill(&mut self) {
        if let Some(next) = self.data.get(self.at..).and_then(|rest| rest.first_chunk()) {
            let word = u64::from_be_bytes(*next);
            let has_255 = (!word).wrapping_sub(u64::MAX / 255) & word & (u64::MAX / 255 * 128) != 0;
            if !has_255 {
                let bytes = (63 - self.count) / 8;
                self.buffer |= word >> self.count;
                self.count += 8 * bytes;
                self.at += bytes as usize;
                return;
            }
        }
        while self.count <= 56
            && let Some(&byte) = self.data.get(self.at)
        {
            self.buffer |= u64::from(byte) << (56 - self.count);
            self.count += 8;
            // A zero follows each 255.
            self.at += 1 + usize::from(byte == 255);
        }
    }

    #[inline]
    pub fn take(&mut self, bits: u32) -> Result<u32, Fault> {
        if self.count < bits {
            self.fill();
        }
        if self.count < bits {
            return Err(END);
        }
        let taken = (self.buffer >> 32 >> (32 - bits)) as u32;
        self.buffer <<= bits;
        self.count -= bits;
        Ok(taken)
    }

    /// Takes a symbol, and the bits that follow it: as many as its lower half says.
    #[inline]
    pub fn symbol(&mut self, codes: &Codes) -> Result<u8, Fault> {
        if self.count < 32 {
            self.fill();
        }
        let (mut symbol, mut length) = codes.quick[(self.buffer >> (64 - QUICK)) as usize];
        if length == 0 {
            // Bits that are no code, or a code that the end cuts.
            let fault = if self.count < 16 { END } else { DAMAGED };
            (symbol, length) = codes.long((self.buffer >> 48) as u32).ok_or(fault)?;
        }
        let bits = u32::from(length) + u32::from(symbol & 15);
        if self.count < bits {
            return Err(END);
        }
        self.buffer <<= bits;
        self.count -= bits;
        Ok(symbol)
    }

    /// Bytes that were not taken.
    pub fn left(&self) -> usize {
        self.data.len().saturating_sub(self.at) + (self.count / 8) as usize
    }
}

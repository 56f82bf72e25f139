//! Whether the data of a JPEG are whole: decoders fill up with grey what is missing, and show what is damaged as other blocks.
//!
//! The entropy-coded data (ITU-T T.81, annexes F and G) are followed symbol by symbol, without values: each scan has to hold
//! exactly its blocks. What is not understood here is left to the decoder's judgement.

mod bits;
#[cfg(test)]
mod tests;

use self::bits::{Bits, DAMAGED, END, HuffmanCodes, JpegFault};

/// Bytes between the last block and a marker that some cameras write, and every decoder skips.
const MOST_LEFT: usize = 16;

/// A component of the picture.
struct Component {
    id: u8,
    /// Blocks of it in a unit of several components.
    blocks_of_unit: usize,
    /// Blocks of it in the picture.
    blocks: usize,
    /// For each block of a progressive picture the coefficients that are not zero so far, as bits.
    nonzero: Vec<u64>,
    /// For each coefficient the number of lower bits that are still to come. The first has to come, others may be zero everywhere.
    to_come: [u8; 64],
}

/// The picture as far as it is known.
#[derive(Default)]
struct JpegPicture {
    /// Expected width and height, px.
    size: [usize; 2],
    is_progressive: bool,
    components: Vec<Component>,
    /// Units of several components.
    units: usize,
    /// Units between restart markers; 0 without.
    restart: usize,
    /// For the first coefficient of a block, and for the others.
    codes: [[Option<HuffmanCodes>; 4]; 2],
}

/// The coefficients and bits of a scan.
struct Band {
    from: usize,
    to: usize,
    is_refinement: bool,
    /// Number of blocks that have no further coefficients.
    run: u32,
}

/// Checks the data of a JPEG of this width and height. Memory is bounded by a small multiple of these.
///
/// # Errors
/// If they are cut short or damaged, with the reason.
pub(super) fn check(bytes: &[u8], size: [usize; 2]) -> Result<(), String> {
    let mut picture = JpegPicture { size, ..JpegPicture::default() };
    let mut at = 2;
    let has_end = loop {
        at += bytes.get(at..).unwrap_or_default().iter().take_while(|&&byte| byte != 255).count();
        at += bytes.get(at..).unwrap_or_default().iter().take_while(|&&byte| byte == 255).count();
        let Some(&marker) = bytes.get(at) else { break false };
        at += 1;
        match marker {
            0xd9 => break true,
            0 | 1 | 0xd0..=0xd8 => continue,
            _ => {}
        }
        let length = bytes.get(at..at + 2).map_or(2, |length| usize::from(length[0]) << 8 | usize::from(length[1]));
        let Some(segment) = bytes.get(at + 2..at + length) else { break false };
        at += length;
        let understood = match marker {
            0xc0..=0xc2 => picture.frame(marker == 0xc2, segment),
            0xc3 | 0xc5..=0xc7 | 0xc9..=0xcf | 0xdc => None,
            0xc4 => picture.tables(segment),
            0xdd => segment.first_chunk().map(|&count| picture.restart = u16::from_be_bytes(count).into()),
            0xda => match picture.scan(segment, &bytes[at..]) {
                Some(length) => Some(at += length?),
                None => None,
            },
            _ => Some(()),
        };
        if understood.is_none() {
            return Ok(());
        }
    };
    let is_whole = picture.components.iter().all(|component| component.to_come.iter().all(|&bits| bits == 0));
    // Of a sequential picture nothing can follow.
    match !picture.components.is_empty() && is_whole && (has_end || !picture.is_progressive) {
        true => Ok(()),
        false => Err("it is cut short or damaged: it ends before the data of all its pixels".into()),
    }
}

impl JpegPicture {
    /// Takes a frame header (T.81, B.2.2).
    fn frame(&mut self, is_progressive: bool, segment: &[u8]) -> Option<()> {
        let &[_, h0, h1, w0, w1, count] = segment.first_chunk()?;
        let size = [[w0, w1], [h0, h1]].map(|side| usize::from(u16::from_be_bytes(side)));
        let parts = segment.get(6..6 + 3 * usize::from(count))?.as_chunks::<3>().0;
        let sampling = |part: &[u8; 3]| [part[1] >> 4, part[1] & 15].map(usize::from);
        let most = parts.iter().map(sampling).fold([0; 2], |most, of| [most[0].max(of[0]), most[1].max(of[1])]);
        let is_valid = (1..=4).contains(&count) && parts.iter().flat_map(sampling).all(|side| (1..=4).contains(&side));
        if !is_valid || size != self.size || !self.components.is_empty() {
            return None;
        }
        let component = |part: &[u8; 3]| {
            let sampling = sampling(part);
            let [across, down] = [0, 1].map(|axis| (size[axis] * sampling[axis]).div_ceil(8 * most[axis]));
            let nonzero = vec![0; if is_progressive { across * down } else { 0 }];
            let mut to_come = [0; 64];
            to_come[0] = u8::MAX;
            let blocks_of_unit = sampling[0] * sampling[1];
            Component { id: part[0], blocks_of_unit, blocks: across * down, nonzero, to_come }
        };
        self.is_progressive = is_progressive;
        self.units = size[0].div_ceil(8 * most[0]) * size[1].div_ceil(8 * most[1]);
        self.components = parts.iter().map(component).collect();
        Some(())
    }

    /// Takes tables of codes (T.81, B.2.4.2).
    fn tables(&mut self, mut segment: &[u8]) -> Option<()> {
        while let Some((&[class, ref counts @ ..], rest)) = segment.split_first_chunk::<17>() {
            let symbols = rest.get(..counts.iter().map(|&count| usize::from(count)).sum())?;
            let place = self.codes.get_mut(usize::from(class >> 4))?.get_mut(usize::from(class & 15))?;
            *place = Some(HuffmanCodes::new(counts, symbols)?);
            segment = &rest[symbols.len()..];
        }
        Some(())
    }

    /// Follows a scan (T.81, B.2.3), with whose data `data` begins. The number of their bytes up to the marker that ends them; `None` if the
    /// scan is not understood.
    fn scan(&mut self, segment: &[u8], data: &[u8]) -> Option<Result<usize, String>> {
        let count = usize::from(*segment.first()?);
        let parts = segment.get(1..1 + 2 * count)?.as_chunks::<2>().0;
        let &[from, to, bits] = segment.get(1 + 2 * count..)?.first_chunk()?;
        let (from, to, bits) = if self.is_progressive { (from.into(), to.into(), bits) } else { (0, 63, 0) };
        if from > to || to > 63 {
            return Some(Err("it is cut short or damaged: the header of a scan is wrong".into()));
        }
        let is_of_one_kind = !self.is_progressive || to == 0 || (from > 0 && count == 1);
        if parts.is_empty() || !is_of_one_kind {
            return None;
        }
        let mut band = Band { from, to, is_refinement: bits >> 4 > 0, run: 0 };
        let mut places = Vec::new();
        for &[id, codes] in parts {
            let place = self.components.iter().position(|component| component.id == id)?;
            let codes = [codes >> 4, codes & 15].map(usize::from);
            let has = |class: usize| self.codes[class].get(codes[class]).is_some_and(Option::is_some);
            if (from == 0 && !band.is_refinement && !has(0)) || (to > 0 && !has(1)) {
                return None;
            }
            self.components[place].to_come[from..=to].fill(bits & 15);
            places.push((place, codes));
        }
        let units = if count > 1 { self.units } else { self.components[places[0].0].blocks };
        let (mut at, mut done) = (0, 0);
        let failed = |fault: JpegFault, done: usize| {
            Some(Err(format!(
                "it is cut short or damaged: its data {fault} after {}% of the picture",
                done * 100 / units
            )))
        };
        // The data between two restart markers at a time.
        while done < units {
            let length = entropy_coded(&data[at..]);
            let until = if self.restart > 0 { units.min(done + self.restart) } else { units };
            let mut bits = Bits::new(&data[at..at + length]);
            band.run = 0;
            while done < until {
                if let Err(fault) = self.unit(&places, done, &mut bits, &mut band) {
                    return failed(fault, done);
                }
                done += 1;
            }
            at += length;
            if bits.left() > MOST_LEFT {
                return failed(DAMAGED, done);
            }
            if done < units {
                at += data[at..].iter().take_while(|&&byte| byte == 255).count();
                if !matches!(data.get(at), Some(0xd0..=0xd7)) {
                    return failed(END, done);
                }
                at += 1;
            }
        }
        Some(Ok(at))
    }

    /// Follows a unit of a scan: one block, or those of several components.
    #[inline]
    fn unit(
        &mut self,
        places: &[(usize, [usize; 2])],
        unit: usize,
        bits: &mut Bits,
        band: &mut Band,
    ) -> Result<(), JpegFault> {
        for &(place, codes) in places {
            let component = &mut self.components[place];
            let blocks = if places.len() > 1 { component.blocks_of_unit } else { 1 };
            for _ in 0..blocks {
                match &self.codes[0][codes[0] % 4] {
                    _ if band.from > 0 => {}
                    Some(codes) if !band.is_refinement => _ = bits.symbol(codes)?,
                    _ => _ = bits.take(1)?,
                }
                if let Some(codes) = self.codes[1][codes[1] % 4].as_ref().filter(|_| band.to > 0) {
                    match component.nonzero.get_mut(unit) {
                        Some(nonzero) => block::<true>(bits, codes, band, nonzero)?,
                        None => block::<false>(bits, codes, band, &mut 0)?,
                    }
                }
            }
        }
        Ok(())
    }
}

/// The number of bytes before the next marker.
fn entropy_coded(data: &[u8]) -> usize {
    let mut at = 0;
    while let Some(found) = data.get(at..).and_then(|rest| rest.iter().position(|&byte| byte == 255)) {
        at += found;
        match data.get(at + 1) {
            Some(0) => at += 2,
            _ => return at,
        }
    }
    data.len()
}

/// Follows the coefficients of a block beyond the first, in a band of them, or a further bit of each (T.81, F.2.2.2, G.1.2.2 and G.1.2.3).
#[inline]
fn block<const PROGRESSIVE: bool>(
    kept: &mut Bits,
    codes: &HuffmanCodes,
    band: &mut Band,
    nonzero: &mut u64,
) -> Result<(), JpegFault> {
    // A copy stays in registers.
    let mut bits = *kept;
    let (mut k, to) = if PROGRESSIVE { (band.from.max(1), band.to) } else { (1, 63) };
    while k <= to && (!PROGRESSIVE || band.run == 0) {
        let symbol = bits.symbol(codes)?;
        let (mut zeros, has_value) = (usize::from(symbol >> 4), symbol & 15 > 0);
        if zeros < 15 && !has_value {
            band.run = (1 << zeros) + bits.take(zeros as u32)?;
            break;
        }
        if PROGRESSIVE && band.is_refinement {
            // Each coefficient that was not zero before has a further bit here; the zeros that count are the others.
            while k <= to && (*nonzero >> k & 1 == 1 || zeros > 0) {
                match *nonzero >> k & 1 {
                    1 => _ = bits.take(1)?,
                    _ => zeros -= 1,
                }
                k += 1;
            }
        } else {
            k += zeros;
        }
        if has_value {
            if k > to {
                return Err(DAMAGED);
            }
            *nonzero |= u64::from(PROGRESSIVE) << k;
        }
        k += 1;
    }
    if band.run > 0 {
        band.run -= 1;
        let further = (k..=to).filter(|&k| band.is_refinement && *nonzero >> k & 1 == 1).count();
        (0..further).try_for_each(|_| bits.take(1).map(drop))?;
    }
    *kept = bits;
    Ok(())
}

//! DEFLATE into a buffer whose size is known: what tiles and strips of TIFF files need.
//!
//! ```text
//!   78 9c │ block │ block │ .. │ last block │ Adler-32
//!           └ bits ──▶ table of 2^10 entries ──▶ up to three literals and a match at once
//! ```
//!
//! Terrain after a predictor is short matches with a literal or two between them, in no order that a
//! processor could guess. So an entry of the table holds the literals and the match behind them, as
//! far as its index reaches, and each step is the same whatever it yields. That makes this faster
//! than general inflaters, which besides must be able to stop anywhere and go on later.
//!
//! The stream may claim anything: it writes into the buffer and nowhere else, and allocates nothing.
//!
//! # References
//!
//! * RFC 1950, *ZLIB Compressed Data Format*; RFC 1951, *DEFLATE Compressed Data Format*.
//! * E. Biggers, libdeflate: tables by doubling, refilling without a branch.

mod bits;
mod code;

use self::bits::Bits;
use self::code::{Alphabet, Code, Distances, Lengths, Symbols};

/// Why a stream does not decode.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub(crate) enum InflateError {
    #[error("no zlib stream: it starts with {:#04x} {:#04x}", .0[0], .0[1])]
    Header([u8; 2]),
    #[error("the DEFLATE stream ends in the middle")]
    Truncated,
    #[error("a DEFLATE block of the reserved type 3")]
    BlockType,
    #[error("a stored DEFLATE block whose length and its complement differ")]
    StoredLength,
    #[error("code lengths of a DEFLATE block that make no code")]
    Lengths,
    #[error("a DEFLATE code that stands for nothing")]
    Code,
    #[error("a DEFLATE match from before the start")]
    Distance,
    #[error("{found} bytes decode, not {expected}")]
    TooShort { found: usize, expected: usize },
    #[error("the checksum of the samples is {found:#010x}, the stream says {expected:#010x}")]
    Checksum { found: u32, expected: u32 },
}

/// Bytes that a fast step may write: literals and the longest match, rounded up to whole chunks.
const FAST_ROOM: usize = 4 + 258 + 2 * CHUNK;

/// Bytes copied at once.
const CHUNK: usize = 16;

/// Tables that are filled anew for every block, 20 KiB; kept by the caller so that they are not
/// made anew for every stream.
#[derive(Debug)]
pub(crate) struct Inflater {
    symbols: Code<Symbols, { 1 << <Symbols as Alphabet>::BITS }>,
    distances: Code<Distances, { 1 << <Distances as Alphabet>::BITS }>,
    lengths: Code<Lengths, { 1 << <Lengths as Alphabet>::BITS }>,
}

impl Default for Inflater {
    fn default() -> Self {
        Self { symbols: Code::new(), distances: Code::new(), lengths: Code::new() }
    }
}

impl Inflater {
    /// Fills `out` from a zlib stream.
    ///
    /// What a stream holds beyond `out` is not looked at. The checksum is compared where the stream
    /// ends with `out` and has one.
    ///
    /// # Errors
    ///
    /// [`InflateError`] if the stream is damaged or does not fill `out`, which then holds anything.
    pub(crate) fn zlib(&mut self, stream: &[u8], out: &mut [u8]) -> Result<(), InflateError> {
        const DEFLATE: u8 = 8;
        const GREATEST_WINDOW: u8 = 7;
        const DICTIONARY: u8 = 0x20;
        let [method, flags, ..] = *stream else { return Err(InflateError::Truncated) };
        let sum = u16::from_le_bytes([flags, method]);
        if method & 15 != DEFLATE
            || method >> 4 > GREATEST_WINDOW
            || !sum.is_multiple_of(31)
            || flags & DICTIONARY != 0
        {
            return Err(InflateError::Header([method, flags]));
        }
        let mut bits = Bits::new(&stream[2..]);
        let filled = self.blocks(&mut bits, out)?;
        let found = adler32(out);
        match filled {
            Filled::StreamGoesOn => Ok(()),
            Filled::WholeStream => match bits.rest().first_chunk() {
                Some(&[a, b, c, d]) if u32::from_le_bytes([d, c, b, a]) != found => {
                    Err(InflateError::Checksum {
                        found,
                        expected: u32::from_le_bytes([d, c, b, a]),
                    })
                }
                _ => Ok(()),
            },
        }
    }

    fn blocks(&mut self, bits: &mut Bits, out: &mut [u8]) -> Result<Filled, InflateError> {
        let mut at = 0;
        loop {
            let full = at == out.len();
            match self.block(bits, out, &mut at) {
                // A block behind the output matters only if it is an empty one that ends the stream.
                Err(_) if full => return Ok(Filled::StreamGoesOn),
                Err(error) => return Err(error),
                Ok((_, BlockEnd::OutputFull)) => return Ok(Filled::StreamGoesOn),
                Ok((Place::Last, BlockEnd::Marked)) if at == out.len() => {
                    return Ok(Filled::WholeStream);
                }
                Ok((Place::Last, BlockEnd::Marked)) => {
                    return Err(InflateError::TooShort { found: at, expected: out.len() });
                }
                Ok((Place::Before, BlockEnd::Marked)) => {}
            }
        }
    }

    fn block(
        &mut self,
        bits: &mut Bits,
        out: &mut [u8],
        at: &mut usize,
    ) -> Result<(Place, BlockEnd), InflateError> {
        let place = if bits.take(1)? == 1 { Place::Last } else { Place::Before };
        let end = match bits.take(2)? {
            0 => stored(bits, out, at)?,
            1 => {
                self.fixed()?;
                self.coded(bits, out, at)?
            }
            2 => {
                self.dynamic(bits)?;
                self.coded(bits, out, at)?
            }
            _ => return Err(InflateError::BlockType),
        };
        Ok((place, end))
    }

    fn fixed(&mut self) -> Result<(), InflateError> {
        let mut lengths = [8; 288];
        lengths[144..256].fill(9);
        lengths[256..280].fill(7);
        self.symbols.build(&lengths)?;
        self.symbols.join();
        self.distances.build(&[5; 32])
    }

    /// Reads the codes of a block.
    fn dynamic(&mut self, bits: &mut Bits) -> Result<(), InflateError> {
        const ORDER: [usize; 19] =
            [16, 17, 18, 0, 8, 7, 9, 6, 10, 5, 11, 4, 12, 3, 13, 2, 14, 1, 15];
        let symbols = bits.take(5)? as usize + 257;
        let distances = bits.take(5)? as usize + 1;
        let count = bits.take(4)? as usize + 4;
        if symbols > 286 || distances > 30 {
            return Err(InflateError::Lengths);
        }
        let mut of_lengths = [0; 19];
        for &place in &ORDER[..count] {
            of_lengths[place] = bits.take_byte(3)?;
        }
        self.lengths.build(&of_lengths)?;

        let mut lengths = [0_u8; 286 + 30];
        let total = symbols + distances;
        let mut at = 0;
        while at < total {
            bits.refill();
            let entry = self.lengths.entry(bits)?;
            let symbol = entry.value(bits.peek());
            bits.consume(entry.bits())?;
            let (value, times) = match symbol {
                length @ 0..=15 => (u8::try_from(length).expect("below 16"), 1),
                16 if at == 0 => return Err(InflateError::Lengths),
                16 => (lengths[at - 1], 3 + bits.take(2)? as usize),
                17 => (0, 3 + bits.take(3)? as usize),
                _ => (0, 11 + bits.take(7)? as usize),
            };
            let Some(places) = lengths[..total].get_mut(at..at + times) else {
                return Err(InflateError::Lengths);
            };
            places.fill(value);
            at += times;
        }
        let (symbols, distances) = lengths[..total].split_at(symbols);
        if symbols[256] == 0 {
            return Err(InflateError::Lengths);
        }
        self.symbols.build(symbols)?;
        self.symbols.join();
        self.distances.build(distances)
    }

    /// Decodes a block of codes up to its end or that of `out`.
    fn coded(
        &self,
        bits: &mut Bits,
        out: &mut [u8],
        at: &mut usize,
    ) -> Result<BlockEnd, InflateError> {
        if let Some(end) = self.coded_fast(bits, out, at)? {
            return Ok(end);
        }
        while *at < out.len() {
            bits.refill();
            let entry = self.symbols.entry(bits)?;
            let seen = bits.peek();
            bits.consume(entry.bits())?;
            let count = entry.literals().min(out.len() - *at);
            out[*at..*at + count].copy_from_slice(&entry.literal_bytes()[..count]);
            *at += count;
            if count < entry.literals() {
                return Ok(BlockEnd::OutputFull);
            }
            if entry.is_end() {
                return Ok(BlockEnd::Marked);
            }
            if !entry.is_match() {
                continue;
            }
            let length = entry.value(seen);
            if *at == out.len() {
                return Ok(BlockEnd::OutputFull);
            }
            bits.refill();
            let entry = self.distances.entry(bits)?;
            let seen = bits.peek();
            bits.consume(entry.bits())?;
            let distance = entry.value(seen);
            if distance > *at {
                return Err(InflateError::Distance);
            }
            let room = out.len() - *at;
            for place in *at..*at + length.min(room) {
                out[place] = out[place - distance];
            }
            *at += length.min(room);
            if length > room {
                return Ok(BlockEnd::OutputFull);
            }
        }
        // The output is full; the end of the block may still follow, and the checksum with it.
        bits.refill();
        match self.symbols.entry(bits) {
            Ok(entry) if entry.is_end() && bits.consume(entry.bits()).is_ok() => {
                Ok(BlockEnd::Marked)
            }
            _ => Ok(BlockEnd::OutputFull),
        }
    }

    /// Decodes while input and output have room for a whole step; `None` when they have not.
    fn coded_fast(
        &self,
        bits: &mut Bits,
        out: &mut [u8],
        place: &mut usize,
    ) -> Result<Option<BlockEnd>, InflateError> {
        let mut fast = *bits;
        let mut at = *place;
        let last = out.len().saturating_sub(FAST_ROOM);
        let mut end = None;
        // 56 bits are there after a refill: a length takes 20 of them at most, a distance 28.
        while at < last && fast.refill_fast() {
            let mut entry = self.symbols.look(&fast);
            if entry.is_long() {
                entry = self.symbols.long(&fast)?;
            }
            let seen = fast.peek();
            fast.drop(entry.bits());
            out[at..at + 4].copy_from_slice(&entry.literal_bytes());
            at += entry.literals();
            if entry.is_match() {
                let length = entry.value(seen);
                let mut entry = self.distances.look(&fast);
                if entry.is_long() {
                    entry = self.distances.long(&fast)?;
                }
                let distance = entry.value(fast.peek());
                fast.drop(entry.bits());
                if distance > at {
                    return Err(InflateError::Distance);
                }
                repeat(out, at, distance, length);
                at += length;
            } else if entry.is_end() {
                end = Some(BlockEnd::Marked);
                break;
            }
        }
        (*bits, *place) = (fast, at);
        Ok(end)
    }
}

/// How the output came to be full.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Filled {
    WholeStream,
    StreamGoesOn,
}

/// Where a block is among those of its stream.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Place {
    Before,
    Last,
}

/// Why a block is done with.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum BlockEnd {
    /// The block says so.
    Marked,
    OutputFull,
}

/// Copies a match. Up to two chunks behind it are overwritten.
#[inline(always)]
fn repeat(out: &mut [u8], at: usize, distance: usize, length: usize) {
    let from = at - distance;
    if distance >= CHUNK {
        let mut done = 0;
        while done < length {
            let chunk: [u8; CHUNK] = *out[from + done..].first_chunk().expect("room for a step");
            out[at + done..at + done + CHUNK].copy_from_slice(&chunk);
            done += CHUNK;
        }
        return;
    }
    // As many whole repetitions as a word holds.
    let mut word = u64::from_le_bytes(*out[from..].first_chunk().expect("room for a step"));
    let mut step = 8;
    if distance < 8 {
        let bits = 8 * distance;
        word &= (1 << bits) - 1;
        word |= word << bits;
        word |= if bits < 32 { word << (2 * bits) } else { 0 };
        word |= if bits < 16 { word << (4 * bits) } else { 0 };
        step -= 8 % distance;
    }
    let mut done = 0;
    while done < length {
        if distance >= 8 {
            word = u64::from_le_bytes(*out[from + done..].first_chunk().expect("room for a step"));
        }
        out[at + done..at + done + 8].copy_from_slice(&word.to_le_bytes());
        done += step;
    }
}

fn stored(bits: &mut Bits, out: &mut [u8], at: &mut usize) -> Result<BlockEnd, InflateError> {
    let rest = bits.rest();
    let Some(&[a, b, c, d]) = rest.first_chunk() else { return Err(InflateError::Truncated) };
    let length = u16::from_le_bytes([a, b]);
    if length != !u16::from_le_bytes([c, d]) {
        return Err(InflateError::StoredLength);
    }
    let length = usize::from(length);
    let count = length.min(out.len() - *at);
    let bytes = rest.get(4..4 + count).ok_or(InflateError::Truncated)?;
    out[*at..*at + count].copy_from_slice(bytes);
    *at += count;
    if count < length {
        return Ok(BlockEnd::OutputFull);
    }
    *bits = Bits::new(&rest[4 + count..]);
    Ok(BlockEnd::Marked)
}

fn adler32(bytes: &[u8]) -> u32 {
    let mut sum = simd_adler32::Adler32::new();
    sum.write(bytes);
    sum.finish()
}

#[cfg(test)]
mod tests;

//! Huffman codes as tables.
//!
//! ```text
//!   63..48 base   39..32 end, match, long   31..8 up to three literals   7..6 how many
//!   47..40 bits before the extra ones       5..0 bits of all, extra ones included
//! ```
//!
//! A table is indexed by the next bits of the stream. An entry is what its first code stands for,
//! joined with what the codes after it stand for where the index holds those too: up to three
//! literals and then a match. Codes longer than the index are found by counting, length after
//! length: they are rare by their nature.

use std::marker::PhantomData;

use super::InflateError;
use super::bits::Bits;

/// What the next bits stand for: literals first, then a match or a distance, or the block's end.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Entry(u64);

/// A code that the index does not hold, or none; the entry says nothing else.
const LONG: u64 = 1 << 32;
const NONE: Entry = Entry(LONG);
/// A length or a distance.
const MATCH: u64 = 1 << 33;
const END: u64 = 1 << 34;
const ONE_LITERAL: u64 = 1 << 6;

impl Entry {
    /// One code's meaning, but for the bits of the code.
    const fn with_base(base: u32, extra_bits: u32) -> Self {
        Self((base as u64) << 48 | MATCH | extra_bits as u64)
    }

    const fn literal(byte: u8) -> Self {
        Self((byte as u64) << 8 | ONE_LITERAL)
    }

    /// The meaning of a code of `code_bits`.
    const fn coded(self, code_bits: u32) -> Self {
        Self((self.0 + code_bits as u64) | ((code_bits as u64) << 40))
    }

    #[inline(always)]
    pub(super) const fn is_long(self) -> bool {
        self.0 & LONG != 0
    }

    #[inline(always)]
    pub(super) const fn is_match(self) -> bool {
        self.0 & MATCH != 0
    }

    #[inline(always)]
    pub(super) const fn is_end(self) -> bool {
        self.0 & END != 0
    }

    #[inline(always)]
    pub(super) const fn literals(self) -> usize {
        (self.0 >> 6 & 3) as usize
    }

    /// The literals, and bytes that mean nothing.
    #[inline(always)]
    pub(super) const fn literal_bytes(self) -> [u8; 4] {
        let [_, first, second, third, nothing, ..] = self.0.to_le_bytes();
        [first, second, third, nothing]
    }

    /// Bits of all codes, and of what is added to the base.
    #[inline(always)]
    pub(super) const fn bits(self) -> u32 {
        (self.0 & 63) as u32
    }

    /// The length or distance, given the bits of the entry and any behind them.
    #[inline(always)]
    pub(super) const fn value(self, bits: u64) -> usize {
        let extra = (bits & ((1 << self.bits()) - 1)) >> (self.0 >> 40 & 63);
        #[expect(clippy::cast_possible_truncation, reason = "at most 13 bits")]
        let extra = extra as usize;
        (self.0 >> 48) as usize + extra
    }

    /// This entry of literals, and behind them what the single code `next` stands for.
    const fn then(self, next: Self) -> Self {
        const BYTES: u64 = 0xffff_ff00;
        const COUNTS: u64 = 0xff;
        const BITS_BEFORE: u64 = 0xff << 40;
        let bytes = (next.0 & BYTES) << (8 * self.literals());
        let before = (self.0 & BITS_BEFORE) + (next.0 & BITS_BEFORE);
        let rest = next.0 & !(BYTES | COUNTS | BITS_BEFORE);
        let counts = (self.0 & COUNTS) + (next.0 & COUNTS);
        Self(rest | before | (self.0 & BYTES) | bytes | counts)
    }

    /// Whether the code that stands for this alone fits in `bits`.
    const fn code_fits(self, bits: u32) -> bool {
        self.0 >> 40 & 63 <= bits as u64
    }
}

/// An alphabet.
pub(super) trait Alphabet {
    /// Bits of a table's index.
    const BITS: u32;
    /// What each symbol stands for, but for the bits of its code; [`NONE`] is not allowed in a stream.
    const MEANINGS: [Entry; 288];
}

/// Literals, the end of the block, and lengths.
#[derive(Debug)]
pub(super) struct Symbols;

/// Distances.
#[derive(Debug)]
pub(super) struct Distances;

/// Lengths of codes, and their repetitions; an entry's base is the symbol itself.
#[derive(Debug)]
pub(super) struct Lengths;

impl Alphabet for Symbols {
    const BITS: u32 = 10;
    const MEANINGS: [Entry; 288] = {
        let mut meanings = [NONE; 288];
        let mut byte = 0_u8;
        loop {
            meanings[byte as usize] = Entry::literal(byte);
            if byte == u8::MAX {
                break;
            }
            byte += 1;
        }
        meanings[256] = Entry(END);
        let (mut symbol, mut base) = (257, 3);
        while symbol < 285 {
            let extra_bits = if symbol < 265 { 0 } else { (symbol - 261) / 4 };
            meanings[symbol as usize] = Entry::with_base(base, extra_bits);
            base += 1 << extra_bits;
            symbol += 1;
        }
        meanings[285] = Entry::with_base(258, 0);
        meanings
    };
}

impl Alphabet for Distances {
    const BITS: u32 = 10;
    const MEANINGS: [Entry; 288] = {
        let mut meanings = [NONE; 288];
        let (mut symbol, mut base) = (0_u32, 1);
        while symbol < 30 {
            let extra_bits = if symbol < 4 { 0 } else { symbol / 2 - 1 };
            meanings[symbol as usize] = Entry::with_base(base, extra_bits);
            base += 1 << extra_bits;
            symbol += 1;
        }
        meanings
    };
}

impl Alphabet for Lengths {
    const BITS: u32 = 7;
    const MEANINGS: [Entry; 288] = {
        let mut meanings = [NONE; 288];
        let mut symbol = 0_u32;
        while symbol < 19 {
            meanings[symbol as usize] = Entry::with_base(symbol, 0);
            symbol += 1;
        }
        meanings
    };
}

/// A canonical code of an alphabet.
#[derive(Debug)]
pub(super) struct Code<A, const ENTRIES: usize> {
    table: [Entry; ENTRIES],
    /// Codes of each length.
    counts: [u16; 16],
    /// Symbols in the order of their codes.
    symbols: [u16; 288],
    alphabet: PhantomData<A>,
}

impl<A: Alphabet, const ENTRIES: usize> Code<A, ENTRIES> {
    pub(super) const fn new() -> Self {
        let (table, counts, symbols) = ([NONE; ENTRIES], [0; 16], [0; 288]);
        Self { table, counts, symbols, alphabet: PhantomData }
    }

    /// Makes the code in which symbol `i` has a code of `lengths[i]` bits, 0 for none.
    ///
    /// Like zlib, it takes an incomplete code only if no code is longer than 1 bit.
    pub(super) fn build(&mut self, lengths: &[u8]) -> Result<(), InflateError> {
        self.counts = [0; 16];
        for &length in lengths {
            self.counts[usize::from(length & 15)] += 1;
        }
        self.counts[0] = 0;
        let mut free = 1_i32;
        let mut starts = [0_u16; 16];
        for length in 1..16 {
            free = 2 * free - i32::from(self.counts[length]);
            if free < 0 {
                return Err(InflateError::Lengths);
            }
            starts[length] = starts[length - 1] + self.counts[length - 1];
        }
        let longest = self.counts.iter().rposition(|&count| count > 0).unwrap_or(0);
        if free > 0 && longest > 1 {
            return Err(InflateError::Lengths);
        }
        for (symbol, &length) in (0_u16..).zip(lengths) {
            if length > 0 {
                let start = &mut starts[usize::from(length & 15)];
                self.symbols[usize::from(*start)] = symbol;
                *start += 1;
            }
        }
        self.fill();
        Ok(())
    }

    /// Fills the table: that of codes up to each length is twice that of the length before.
    fn fill(&mut self) {
        let mut symbols = self.symbols.iter();
        let mut filled = 1;
        self.table[0] = NONE;
        // The next code, its first bit lowest.
        let mut code = 0_usize;
        for (length, &count) in (0_u32..).zip(&self.counts).skip(1) {
            if length > A::BITS {
                break;
            }
            self.table.copy_within(..filled, filled);
            filled *= 2;
            for &symbol in symbols.by_ref().take(count.into()) {
                self.table[code] = A::MEANINGS[usize::from(symbol)].coded(length);
                // Adds 1 at the last bit, which is the highest; a carry goes downward.
                let carries = (code ^ (filled - 1)).checked_ilog2();
                code = carries.map_or(0, |bit| code & ((1 << bit) - 1) | 1 << bit);
            }
        }
    }

    /// The entry that the next bits stand for; see [`Entry::is_long`].
    #[inline(always)]
    pub(super) fn look(&self, bits: &Bits) -> Entry {
        #[expect(clippy::cast_possible_truncation, reason = "only the lowest bits are looked at")]
        let index = bits.peek() as usize;
        self.table[index & (ENTRIES - 1)]
    }

    /// The entry of the next code, however long it is.
    pub(super) fn entry(&self, bits: &Bits) -> Result<Entry, InflateError> {
        let entry = self.look(bits);
        if entry.is_long() { self.long(bits) } else { Ok(entry) }
    }

    /// The entry of a code that is longer than the table's index.
    #[cold]
    pub(super) fn long(&self, bits: &Bits) -> Result<Entry, InflateError> {
        let (symbol, length) = self.search(bits).ok_or(InflateError::Code)?;
        let meaning = A::MEANINGS[usize::from(symbol)];
        if meaning == NONE { Err(InflateError::Code) } else { Ok(meaning.coded(length)) }
    }

    /// The symbol of the next code and the code's length.
    fn search(&self, bits: &Bits) -> Option<(u16, u32)> {
        let mut rest = bits.peek();
        // Code, first code and first symbol of the length.
        let (mut code, mut first, mut place) = (0_u32, 0_u32, 0_u32);
        for (length, &count) in (0_u32..).zip(&self.counts).skip(1) {
            code |= u32::from(rest & 1 == 1);
            rest >>= 1;
            if code < first + u32::from(count) {
                let symbol = self.symbols.get((place + code - first) as usize)?;
                return Some((*symbol, length));
            }
            place += u32::from(count);
            (first, code) = ((first + u32::from(count)) << 1, code << 1);
        }
        None
    }

    /// Joins codes that the index holds together: literals, and a match behind them.
    pub(super) fn join(&mut self) {
        const MOST_LITERALS: usize = 3;
        // What follows a code lies further down in the table, or is the entry itself: it is still
        // that of a single code.
        for index in (0..ENTRIES).rev() {
            let mut entry = self.table[index];
            while !entry.is_match() && (1..=MOST_LITERALS).contains(&entry.literals()) {
                let next = self.table[index >> entry.bits()];
                let room = A::BITS - entry.bits();
                let joins = next.is_match() || next.literals() + entry.literals() <= MOST_LITERALS;
                if next.is_long() || next.is_end() || !joins || !next.code_fits(room) {
                    break;
                }
                entry = entry.then(next);
            }
            self.table[index] = entry;
        }
    }
}

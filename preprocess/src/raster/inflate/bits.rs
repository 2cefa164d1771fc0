//! Bits of a stream, the lowest of each byte first.

use super::InflateError;

/// Where a stream is read.
#[derive(Clone, Copy, Debug)]
pub(super) struct Bits<'stream> {
    stream: &'stream [u8],
    /// The next byte to be taken into `buffer`.
    at: usize,
    /// The next bits, the first one lowest. Bits beyond `count` are those of the stream or 0.
    buffer: u64,
    /// Bits in `buffer` that are taken from the stream.
    count: u32,
}

impl<'stream> Bits<'stream> {
    pub(super) const fn new(stream: &'stream [u8]) -> Self {
        Self { stream, at: 0, buffer: 0, count: 0 }
    }

    /// Sees to it that at least 56 bits are here, if the stream has them in a word of 8 bytes.
    #[inline(always)]
    pub(super) fn refill_fast(&mut self) -> bool {
        let Some(word) = self.stream.get(self.at..).and_then(|rest| rest.first_chunk()) else {
            return false;
        };
        // Bytes of the word that do not fit whole stay in the buffer; the next refill ORs the same
        // bits over them.
        self.buffer |= u64::from_le_bytes(*word) << (self.count & 63);
        self.at += ((63 - (self.count & 63)) >> 3) as usize;
        self.count |= 56;
        true
    }

    /// Takes bytes for as long as they fit and the stream has them.
    pub(super) fn refill(&mut self) {
        while self.count < 56
            && let Some(&byte) = self.stream.get(self.at)
        {
            self.buffer |= u64::from(byte) << self.count;
            (self.at, self.count) = (self.at + 1, self.count + 8);
        }
    }

    /// The next bits; beyond the end of the stream they are 0.
    #[inline(always)]
    pub(super) const fn peek(&self) -> u64 {
        self.buffer
    }

    /// Consumes bits that a fast refill brought.
    #[inline(always)]
    pub(super) fn drop(&mut self, count: u32) {
        self.buffer >>= count & 63;
        self.count = self.count.wrapping_sub(count);
    }

    /// Consumes bits that may not be there.
    pub(super) fn consume(&mut self, count: u32) -> Result<(), InflateError> {
        if self.count < count {
            return Err(InflateError::Truncated);
        }
        self.drop(count);
        Ok(())
    }

    /// The next up to 15 bits.
    pub(super) fn take(&mut self, count: u32) -> Result<u32, InflateError> {
        self.refill();
        let mask = (1_u64 << count) - 1;
        let value = u32::try_from(self.buffer & mask).expect("at most 15 bits");
        self.consume(count)?;
        Ok(value)
    }

    /// The next up to 8 bits.
    pub(super) fn take_byte(&mut self, count: u32) -> Result<u8, InflateError> {
        Ok(u8::try_from(self.take(count)?).expect("at most 8 bits"))
    }

    /// The stream from the next whole byte onwards.
    pub(super) fn rest(&self) -> &'stream [u8] {
        &self.stream[self.at - (self.count / 8) as usize..]
    }
}

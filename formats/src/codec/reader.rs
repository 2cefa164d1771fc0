//! Reading a payload from front to back.

use super::error::DecodeError;

/// The unread rest of a payload, which knows where it is.
#[derive(Debug)]
pub(super) struct Reader<'a> {
    payload: &'a [u8],
    position: usize,
}

impl<'a> Reader<'a> {
    /// Starts at the first byte.
    pub(super) const fn new(payload: &'a [u8]) -> Self {
        Self { payload, position: 0 }
    }

    /// Bytes read so far.
    pub(super) const fn position(&self) -> usize {
        self.position
    }

    /// The next `len` bytes.
    pub(super) fn bytes(
        &mut self,
        what: &'static str,
        len: usize,
    ) -> Result<&'a [u8], DecodeError> {
        let start = self.position;
        let end = start.saturating_add(len);
        let len = self.payload.len();
        let bytes =
            self.payload.get(start..end).ok_or(DecodeError::Truncated { what, start, end, len })?;
        self.position = end;
        Ok(bytes)
    }

    /// The next `N` bytes.
    pub(super) fn array<const N: usize>(
        &mut self,
        what: &'static str,
    ) -> Result<[u8; N], DecodeError> {
        let bytes = self.bytes(what, N)?;
        Ok(*bytes.first_chunk().expect("as many bytes as asked for"))
    }

    /// Checks that nothing is left.
    pub(super) const fn finish(self) -> Result<(), DecodeError> {
        if self.position == self.payload.len() {
            Ok(())
        } else {
            Err(DecodeError::Trailing { end: self.position, len: self.payload.len() })
        }
    }
}

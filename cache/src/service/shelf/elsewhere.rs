//! Where the system has no such files: bytes are copied.

use std::io::{self, IoSlice};
use std::task::{Context, Poll};

use tokio::net::TcpStream;

use bytes::Bytes;

/// One that keeps nothing.
#[derive(Debug)]
pub(in super::super) struct Shelf;

impl Shelf {
    pub(in super::super) fn new() -> Self {
        Self
    }

    pub(in super::super) fn put(&self, bytes: Vec<u8>) -> Bytes {
        Bytes::from(bytes)
    }

    pub(in super::super) fn poll_send(
        &self,
        _: &TcpStream,
        _: &mut Context<'_>,
        _: &[IoSlice<'_>],
        _: &mut u64,
    ) -> Option<Poll<io::Result<usize>>> {
        None
    }
}

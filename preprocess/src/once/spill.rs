//! Where parcels wait that memory has no room for.

use std::fmt::Debug;
use std::io;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

/// Says where bytes were stored. Only the [`Spill`] that gave it knows what it means.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Ticket(pub u64);

/// A place for bytes that are needed again in this run, such as a scratch file.
///
/// # Contract
///
/// * Any thread may call anything at any time.
/// * [`Self::load`] gives back exactly the bytes that [`Self::store`] was given, as often as asked,
///   until [`Self::free`].
/// * No two tickets that are not free are the same.
/// * The caller asks for as many bytes as it stored, frees each ticket once, and then never names
///   it again.
/// * Nothing is kept beyond the run, so bytes may be in the host's order.
pub trait Spill: Send + Sync + Debug {
    /// Stores bytes.
    ///
    /// # Errors
    ///
    /// [`io::Error`] if there is no room; nothing is stored then.
    fn store(&self, bytes: &[u8]) -> io::Result<Ticket>;

    /// Fills `bytes` with those stored.
    ///
    /// # Errors
    ///
    /// [`io::Error`] if they cannot be read; they stay where they are.
    fn load(&self, ticket: Ticket, bytes: &mut [u8]) -> io::Result<()>;

    /// Ends a ticket: its bytes are not asked for again.
    fn free(&self, ticket: Ticket);
}

/// How many bytes of parcels may be in memory, and where the others go.
///
/// Caches may share one: each then sets its own parcels aside while all together have too many.
/// Parcels in use are in memory whatever the budget; so is the one being read.
#[derive(Debug)]
pub struct Overflow {
    pub(super) spill: Arc<dyn Spill>,
    budget_bytes: u64,
    resident_bytes: AtomicU64,
}

impl Overflow {
    /// Keeps up to `budget_bytes` in memory, and the others in `spill`.
    #[must_use]
    pub fn new(spill: Arc<dyn Spill>, budget_bytes: u64) -> Self {
        Self { spill, budget_bytes, resident_bytes: AtomicU64::new(0) }
    }

    /// Bytes of the parcels that all caches keep in memory now.
    #[must_use]
    pub fn resident_bytes(&self) -> u64 {
        self.resident_bytes.load(Ordering::Relaxed)
    }

    pub(super) fn is_over(&self) -> bool {
        self.resident_bytes() > self.budget_bytes
    }

    pub(super) fn add(&self, bytes: u64) {
        self.resident_bytes.fetch_add(bytes, Ordering::Relaxed);
    }

    pub(super) fn subtract(&self, bytes: u64) {
        self.resident_bytes.fetch_sub(bytes, Ordering::Relaxed);
    }
}

/// The twin in memory, and what every [`Spill`] has to pass.
#[cfg(test)]
pub(crate) mod test_support {
    use super::*;
    use std::collections::HashMap;
    use std::sync::Mutex;

    /// A [`Spill`] that keeps all in memory.
    #[derive(Debug, Default)]
    pub(crate) struct MemorySpill {
        next: AtomicU64,
        stored: Mutex<HashMap<u64, Vec<u8>>>,
        /// Calls of [`Spill::store`] that succeed before one fails, if any does.
        pub(crate) fails_after: Option<u64>,
    }

    impl MemorySpill {
        /// Tickets that are not free.
        pub(crate) fn tickets(&self) -> usize {
            self.stored.lock().unwrap().len()
        }

        /// Tickets given so far.
        pub(crate) fn given(&self) -> u64 {
            self.next.load(Ordering::Relaxed)
        }
    }

    impl Spill for MemorySpill {
        fn store(&self, bytes: &[u8]) -> io::Result<Ticket> {
            let ticket = self.next.fetch_add(1, Ordering::Relaxed);
            if self.fails_after.is_some_and(|most| ticket >= most) {
                return Err(io::ErrorKind::StorageFull.into());
            }
            self.stored.lock().unwrap().insert(ticket, bytes.to_vec());
            Ok(Ticket(ticket))
        }

        fn load(&self, ticket: Ticket, bytes: &mut [u8]) -> io::Result<()> {
            bytes.copy_from_slice(&self.stored.lock().unwrap()[&ticket.0]);
            Ok(())
        }

        fn free(&self, ticket: Ticket) {
            self.stored.lock().unwrap().remove(&ticket.0).expect("a ticket is freed once");
        }
    }

    /// Holds a [`Spill`] against its contract.
    pub(crate) fn keeps_the_contract(spill: &dyn Spill) {
        let bytes = |seed: usize| -> Vec<u8> {
            let len = [0, 1, 7, 4096, 100_001][seed % 5];
            (0..len).map(|at| u8::try_from((at * 31 + seed * 7) % 251).unwrap()).collect()
        };
        std::thread::scope(|scope| {
            for thread in 0..4 {
                scope.spawn(move || {
                    for round in 0..3 {
                        let seeds: Vec<usize> =
                            (0..10).map(|at| thread * 100 + round * 10 + at).collect();
                        let tickets: Vec<Ticket> =
                            seeds.iter().map(|&seed| spill.store(&bytes(seed)).unwrap()).collect();
                        for _twice in 0..2 {
                            for (&seed, &ticket) in seeds.iter().zip(&tickets).rev() {
                                let mut loaded = vec![0xee; bytes(seed).len()];
                                spill.load(ticket, &mut loaded).unwrap();
                                assert_eq!(loaded, bytes(seed));
                            }
                        }
                        tickets.into_iter().for_each(|ticket| spill.free(ticket));
                    }
                });
            }
        });
    }

    #[test]
    fn the_twin_keeps_the_contract() {
        let spill = MemorySpill::default();
        keeps_the_contract(&spill);
        assert_eq!(spill.tickets(), 0);
    }
}

//! Which thread serves a connection: the one that has the fewest.
//!
//! All threads take connections from one listener, and whichever wakes first takes what is there. Left at
//! that, one of them may have most of the clients, whose answers then take the longest.

use std::net::SocketAddr;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering::Relaxed};

use tokio::net::TcpStream;
use tokio::sync::{OwnedSemaphorePermit, mpsc};

/// A connection that another thread took.
#[derive(Debug)]
pub(super) struct Handed {
    pub(super) stream: std::net::TcpStream,
    pub(super) peer: SocketAddr,
    pub(super) place: OwnedSemaphorePermit,
    pub(super) counted: Counted,
}

#[derive(Debug)]
struct Lanes {
    open: Vec<AtomicUsize>,
    /// What is in them is bounded by the places of connections.
    doors: Vec<mpsc::UnboundedSender<Handed>>,
}

/// A thread's connections.
#[derive(Debug)]
pub(super) struct Lane {
    number: usize,
    lanes: Arc<Lanes>,
    handed: mpsc::UnboundedReceiver<Handed>,
}

/// A connection among those of its thread, until it is dropped.
#[derive(Debug)]
pub(super) struct Counted {
    number: usize,
    lanes: Arc<Lanes>,
}

impl Lane {
    /// One for each of so many threads.
    pub(super) fn all(count: usize) -> Vec<Self> {
        let (doors, handed): (Vec<_>, Vec<_>) =
            (0..count).map(|_| mpsc::unbounded_channel()).unzip();
        let open = doors.iter().map(|_| AtomicUsize::new(0)).collect();
        let lanes = Arc::new(Lanes { open, doors });
        let lane = |(number, handed)| Self { number, lanes: Arc::clone(&lanes), handed };
        handed.into_iter().enumerate().map(lane).collect()
    }

    /// Counts a connection where there are the fewest; this thread's lane goes before others.
    pub(super) fn count(&self) -> Counted {
        let open = |number: &usize| self.lanes.open[*number].load(Relaxed);
        let all = std::iter::once(self.number).chain(0..self.lanes.open.len());
        let number = all.min_by_key(open).unwrap_or(self.number);
        self.lanes.open[number].fetch_add(1, Relaxed);
        Counted { number, lanes: Arc::clone(&self.lanes) }
    }

    /// Whether it is this thread's.
    pub(super) fn has(&self, counted: &Counted) -> bool {
        counted.number == self.number
    }

    /// Gives a connection to the thread that it is counted with; whether that still takes any.
    pub(super) fn hand(
        &self,
        stream: TcpStream,
        peer: SocketAddr,
        place: OwnedSemaphorePermit,
        counted: Counted,
    ) -> bool {
        let door = &self.lanes.doors[counted.number];
        let stream = stream.into_std();
        stream.is_ok_and(|stream| door.send(Handed { stream, peer, place, counted }).is_ok())
    }

    /// The next connection that another thread gives to this one.
    ///
    /// # Cancel safety
    ///
    /// Nothing is lost.
    pub(super) async fn handed(&mut self) -> Handed {
        match self.handed.recv().await {
            Some(handed) => handed,
            // The doors are open as long as the lane is.
            None => std::future::pending().await,
        }
    }
}

impl Counted {
    /// Whether its thread has no other.
    pub(super) fn is_alone(&self) -> bool {
        self.lanes.open[self.number].load(Relaxed) == 1
    }
}

impl Drop for Counted {
    fn drop(&mut self) {
        self.lanes.open[self.number].fetch_sub(1, Relaxed);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn whoever_takes_them_connections_are_spread_evenly() {
        let lanes = Lane::all(3);
        let mut open: Vec<Counted> = (0..7).map(|_| lanes[1].count()).collect();
        let numbers = |open: &[Counted]| open.iter().map(|one| one.number).collect::<Vec<_>>();
        assert_eq!(numbers(&open), [1, 0, 2, 1, 0, 2, 1]);
        open.retain(|one| one.number != 2);
        open.extend([lanes[0].count(), lanes[1].count(), lanes[2].count()]);
        assert_eq!(numbers(&open[5..]), [2, 2, 2]);
        let alone = |open: &[Counted]| open.iter().map(Counted::is_alone).collect::<Vec<_>>();
        assert_eq!(alone(&open), [false; 8]);
        open.truncate(2);
        assert_eq!((numbers(&open), alone(&open)), (vec![1, 0], vec![true; 2]));
    }
}

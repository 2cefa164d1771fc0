//! A way to a server that can be made slow.

use std::io::{self, Read as _, Write as _};
use std::net::{Shutdown, SocketAddr, TcpListener, TcpStream};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering::Relaxed};
use std::thread;
use std::time::Duration;

/// Connections to `address` go on to the server. It lasts as long as the process.
pub(crate) struct Road {
    pub(crate) address: SocketAddr,
    state: Arc<State>,
}

#[derive(Default)]
struct State {
    is_slow: AtomicBool,
    /// Bytes that came while it was.
    slow_bytes: AtomicUsize,
}

impl Road {
    /// On a slow road, so many bytes come in so long.
    const STEP: (usize, Duration) = (8, Duration::from_millis(20));

    pub(crate) fn to(server: SocketAddr) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let (address, state) = (listener.local_addr().unwrap(), Arc::<State>::default());
        let shared = Arc::clone(&state);
        thread::spawn(move || {
            for client in listener.incoming().map_while(Result::ok) {
                let Ok(server) = TcpStream::connect(server) else { continue };
                let (to_server, to_client) = (server.try_clone(), client.try_clone());
                let (Ok(to_server), Ok(to_client)) = (to_server, to_client) else { continue };
                thread::spawn(|| carry(client, to_server, &State::default()));
                let state = Arc::clone(&shared);
                thread::spawn(move || carry(server, to_client, &state));
            }
        });
        Self { address, state }
    }

    pub(crate) fn slow_down(&self, is_slow: bool) {
        self.state.is_slow.store(is_slow, Relaxed);
    }

    pub(crate) fn slow_bytes(&self) -> usize {
        self.state.slow_bytes.load(Relaxed)
    }
}

/// Until one of both ends.
fn carry(mut from: TcpStream, mut to: TcpStream, state: &State) {
    let mut carry = || -> io::Result<()> {
        let mut buffer = [0; 4096];
        loop {
            let count = from.read(&mut buffer)?;
            if count == 0 {
                return Ok(());
            }
            let (step, pause) = Road::STEP;
            for piece in buffer[..count].chunks(step) {
                to.write_all(piece)?;
                if state.is_slow.load(Relaxed) {
                    state.slow_bytes.fetch_add(piece.len(), Relaxed);
                    thread::sleep(pause);
                }
            }
        }
    };
    // Whoever ends it has a reason of its own.
    let _ = carry();
    for end in [from, to] {
        let _ = end.shutdown(Shutdown::Both);
    }
}

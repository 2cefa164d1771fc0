//! The binary, serving.

use std::io::{BufRead as _, BufReader};
use std::net::SocketAddr;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::thread;

use super::rig::Place;

/// A server of a place in a process of its own.
pub(crate) struct Process {
    pub(crate) child: Child,
    pub(crate) public: SocketAddr,
    admin: Option<SocketAddr>,
}

impl Process {
    /// Behind what a shell does first.
    pub(crate) fn start(place: &Place, first: &str) -> Self {
        Self::start_on(place, &place.catalog(), first, &[])
    }

    /// The same with a catalog that may lie elsewhere, and more options.
    pub(crate) fn start_on(place: &Place, catalog: &Path, first: &str, options: &[&str]) -> Self {
        let mut child = Command::new("sh")
            .args([
                "-c",
                &format!("{first} exec \"$0\" \"$@\""),
                env!("CARGO_BIN_EXE_areoid"),
                "serve",
            ])
            .arg(catalog)
            .args(["--listen", "127.0.0.1:0", "--admin", "127.0.0.1:0", "--token-file"])
            .arg(place.path("token"))
            .arg("--allow")
            .arg(place.path("rasters"))
            .args(options)
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        let (public, admin) = listening(&mut child);
        Self { child, public, admin }
    }

    /// With these options alone.
    pub(crate) fn start_bare(catalog: &Path, options: &[&str]) -> Self {
        let mut command = Command::new(env!("CARGO_BIN_EXE_areoid"));
        command.arg("serve").arg(catalog).args(options).stderr(Stdio::piped());
        let mut child = command.spawn().unwrap();
        let (public, admin) = listening(&mut child);
        Self { child, public, admin }
    }

    pub(crate) fn has_admin(&self) -> bool {
        self.admin.is_some()
    }

    pub(crate) fn admin(&self) -> SocketAddr {
        self.admin.unwrap()
    }

    pub(crate) fn signal(&self, signal: &str) {
        let sent = Command::new("kill").args([signal, &self.child.id().to_string()]).status();
        assert!(sent.unwrap().success());
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// Where a service that begins says that it listens.
fn listening(child: &mut Child) -> (SocketAddr, Option<SocketAddr>) {
    let mut lines = BufReader::new(child.stderr.take().unwrap()).lines().map(Result::unwrap);
    let line = lines.find_map(|line| Some(line.strip_prefix("serving on http://")?.to_owned()));
    // Whoever does not read would stop it.
    thread::spawn(move || lines.for_each(drop));
    let line = line.unwrap();
    let address = |text: &str| text.parse().unwrap();
    match line.split_once(", changed on ") {
        Some((public, admin)) => (address(public), Some(address(admin))),
        None => (address(&line), None),
    }
}

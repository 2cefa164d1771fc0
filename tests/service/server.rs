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
    pub(crate) admin: SocketAddr,
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
        let mut lines = BufReader::new(child.stderr.take().unwrap()).lines().map(Result::unwrap);
        let line = lines.find(|line| line.starts_with("serving on http://")).unwrap();
        // Whoever does not read would stop it.
        thread::spawn(move || lines.for_each(drop));
        let (public, admin) = line.split_once(", changed on ").unwrap();
        let public = public.strip_prefix("serving on http://").unwrap().parse().unwrap();
        Self { child, public, admin: admin.parse().unwrap() }
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

//! Servers that run while they are measured, each in a process of its own.

use std::fs;
use std::io::{self, BufRead as _, BufReader};
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::thread;
use std::time::{Duration, Instant};

/// How long a server may take to listen.
const PATIENCE: Duration = Duration::from_secs(20);

/// `areoid serve`; it ends with this.
#[derive(Debug)]
pub(super) struct Areoid {
    child: Child,
    pub(super) public: SocketAddr,
    pub(super) admin: Option<SocketAddr>,
}

impl Areoid {
    /// Serves `catalog` on so many threads; `admin` is a token file and a folder of rasters.
    pub(super) fn start(
        catalog: &Path,
        threads: usize,
        admin: Option<(&Path, &Path)>,
    ) -> io::Result<Self> {
        let mut command = Command::new(std::env::current_exe()?);
        command.arg("serve").arg(catalog).args(["--listen", "127.0.0.1:0"]);
        command.arg("--threads").arg(threads.to_string());
        if let Some((token, rasters)) = admin {
            command.args(["--admin", "127.0.0.1:0", "--token-file"]).arg(token);
            command.arg("--allow").arg(rasters);
        } else {
            command.args(["--admin", "none"]);
        }
        let mut child = command.stderr(Stdio::piped()).stdout(Stdio::null()).spawn()?;
        let said = child.stderr.take().map(BufReader::new);
        let mut lines = said.into_iter().flat_map(BufReader::lines).map_while(Result::ok);
        let line =
            lines.find_map(|line| line.strip_prefix("serving on http://").map(str::to_owned));
        // Whoever does not read would stop it.
        thread::spawn(move || lines.for_each(drop));
        let address = |text: &str| text.parse::<SocketAddr>().map_err(io::Error::other);
        let listening = line.ok_or_else(|| io::Error::other("areoid serve did not start"));
        let listening = listening.and_then(|line| match line.split_once(", changed on ") {
            Some((public, admin)) => Ok((address(public)?, Some(address(admin)?))),
            None => Ok((address(&line)?, None)),
        });
        match listening {
            Ok((public, admin)) => Ok(Self { child, public, admin }),
            Err(error) => {
                end(&mut child);
                Err(error)
            }
        }
    }
}

impl Drop for Areoid {
    fn drop(&mut self) {
        end(&mut self.child);
    }
}

fn end(child: &mut Child) {
    // It may have ended by itself.
    let _ = child.kill();
    let _ = child.wait();
}

/// nginx with files of a folder; it ends with this.
#[derive(Debug)]
pub(super) struct Nginx {
    program: PathBuf,
    folder: PathBuf,
    child: Child,
    pub(super) public: SocketAddr,
}

impl Nginx {
    /// Serves `root` with so many workers, its own files in `folder`.
    pub(super) fn start(
        program: &Path,
        workers: usize,
        root: &Path,
        folder: &Path,
    ) -> io::Result<Self> {
        fs::create_dir_all(folder)?;
        let (folder, root) = (folder.canonicalize()?, root.canonicalize()?);
        // One that is free now: nginx must be told.
        let public = TcpListener::bind("127.0.0.1:0")?.local_addr()?;
        fs::write(folder.join("nginx.conf"), configuration(workers, public, &root, &folder))?;
        let mut command = program_in(program, &folder);
        let child = command.stdout(Stdio::null()).stderr(Stdio::null()).spawn()?;
        let mut nginx = Self { program: program.to_owned(), folder, child, public };
        let start = Instant::now();
        while TcpStream::connect(public).is_err() {
            if start.elapsed() > PATIENCE || nginx.child.try_wait()?.is_some() {
                let log = fs::read_to_string(nginx.folder.join("error.log")).unwrap_or_default();
                return Err(io::Error::other(format!("nginx did not start: {log}")));
            }
            thread::sleep(Duration::from_millis(10));
        }
        Ok(nginx)
    }
}

fn program_in(program: &Path, folder: &Path) -> Command {
    let mut command = Command::new(program);
    command.arg("-p").arg(folder).arg("-c").arg(folder.join("nginx.conf"));
    command.arg("-e").arg(folder.join("error.log"));
    command
}

impl Drop for Nginx {
    fn drop(&mut self) {
        // Killed, it would leave its workers behind.
        let asked = program_in(&self.program, &self.folder).args(["-s", "stop"]).output();
        if !asked.is_ok_and(|asked| asked.status.success()) {
            let _ = self.child.kill();
        }
        let _ = self.child.wait();
    }
}

fn configuration(workers: usize, public: SocketAddr, root: &Path, folder: &Path) -> String {
    // Workers of a superuser's nginx are nobody, who may not read everything.
    let user = if is_superuser() { "user root;\n" } else { "" };
    let (root, folder) = (root.display(), folder.display());
    let temporary: String = ["client_body", "proxy", "fastcgi", "uwsgi", "scgi"]
        .iter()
        .map(|kind| format!("  {kind}_temp_path \"{folder}/{kind}\";\n"))
        .collect();
    format!(
        "{user}daemon off;\nworker_processes {workers};\npid \"{folder}/pid\";\n\
         events {{ worker_connections 1024; }}\nhttp {{\n  access_log off;\n  sendfile on;\n  \
         tcp_nopush on;\n  keepalive_requests 1000000000;\n{temporary}  \
         server {{ listen {public}; root \"{root}\"; }}\n}}\n"
    )
}

#[cfg(unix)]
fn is_superuser() -> bool {
    use std::os::unix::fs::MetadataExt as _;
    fs::metadata("/proc/self").is_ok_and(|own| own.uid() == 0)
}

#[cfg(not(unix))]
fn is_superuser() -> bool {
    false
}

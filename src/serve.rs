//! `areoid serve`.

use std::net::{AddrParseError, Ipv4Addr, SocketAddr};
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::str::FromStr;
use std::time::Duration;

use areoid_cache::service::{Admin, Limits, Options, Service, run};
use serde::{Deserialize, Serialize};

use crate::failure::Failure;
use crate::output;

/// Serve a catalog over HTTP until asked to end; asked twice, end at once.
///
/// Anybody may read. What state it is in is told by a second listener; datasets come and go through
/// that, for which --token-file is needed.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// The catalog.
    #[arg(value_name = "DIR")]
    catalog: PathBuf,

    #[command(flatten)]
    settings: Settings,

    /// A TOML file of these options, without their dashes and with underscores; the options above
    /// it override it.
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,

    /// Print what the options and the file come to, and end.
    #[arg(long)]
    print_config: bool,
}

/// What may stand in the file, too.
#[derive(Clone, Debug, Default, clap::Args, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Settings {
    /// Where anybody may ask [default: 127.0.0.1:8360].
    #[arg(long, value_name = "ADDRESS:PORT")]
    listen: Option<SocketAddr>,

    /// Memory for pages [default: 512].
    #[arg(long, value_name = "MIB")]
    memory_mib: Option<u64>,

    /// Where state, counters and changes are, or `none`; beyond the loopback only with a token [default: on
    /// the loopback, at the port after the one of --listen, if that is free].
    #[arg(long, value_name = "ADDRESS:PORT|none")]
    admin: Option<Door>,

    /// A file whose first line is the token of whoever may change the catalog: at least 16 characters.
    #[arg(long, value_name = "FILE")]
    token_file: Option<PathBuf>,

    /// A folder that rasters to insert may lie in; may be given several times.
    #[arg(long, value_name = "DIR")]
    #[serde(default)]
    allow: Vec<PathBuf>,

    /// Threads that answer [default: one a core].
    #[arg(long, value_name = "COUNT")]
    threads: Option<usize>,

    /// Connections at a time [default: 4096].
    #[arg(long, value_name = "COUNT")]
    max_connections: Option<usize>,

    /// Requests in flight at a time [default: 1024].
    #[arg(long, value_name = "COUNT")]
    max_requests: Option<usize>,

    /// How long the header of a request may take to come [default: 30].
    #[arg(long, value_name = "SECONDS")]
    header_timeout_s: Option<u64>,

    /// Insertions at a time, one under way and the others waiting for it [default: 16].
    #[arg(long, value_name = "COUNT")]
    max_insertions: Option<usize>,

    /// How long a client may take nothing of what is sent to it, or less than 256 KiB [default: 30].
    #[arg(long, value_name = "SECONDS")]
    stall_timeout_s: Option<u64>,

    /// How long requests in flight have when asked to end [default: 10].
    #[arg(long, value_name = "SECONDS")]
    drain_s: Option<u64>,

    /// Log in JSON.
    #[arg(long, num_args = 0, default_missing_value = "true")]
    log_json: Option<bool>,
}

/// Where the second listener is to be, if anywhere.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
enum Door {
    At(SocketAddr),
    None,
}

impl FromStr for Door {
    type Err = AddrParseError;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        if text == "none" { Ok(Self::None) } else { text.parse().map(Self::At) }
    }
}

impl TryFrom<String> for Door {
    type Error = AddrParseError;

    fn try_from(text: String) -> Result<Self, Self::Error> {
        text.parse()
    }
}

impl From<Door> for String {
    fn from(door: Door) -> Self {
        match door {
            Door::At(address) => address.to_string(),
            Door::None => "none".to_owned(),
        }
    }
}

impl Door {
    /// Behind that of anybody, where nobody else comes.
    fn behind(listen: SocketAddr) -> Self {
        // Behind any port stands any port, and behind the last none.
        let port = if listen.port() == 0 { Some(0) } else { listen.port().checked_add(1) };
        port.map_or(Self::None, |port| Self::At((Ipv4Addr::LOCALHOST, port).into()))
    }
}

const LISTEN: SocketAddr = SocketAddr::new(std::net::IpAddr::V4(Ipv4Addr::LOCALHOST), 8360);
const MEMORY_MIB: u64 = 512;

impl Settings {
    /// These, else those of the file, else the defaults.
    fn over(self, file: Self) -> Self {
        let limits = Limits::default();
        let seconds = |limit: Duration| Some(limit.as_secs());
        Self {
            listen: self.listen.or(file.listen).or(Some(LISTEN)),
            memory_mib: self.memory_mib.or(file.memory_mib).or(Some(MEMORY_MIB)),
            admin: self.admin.or(file.admin),
            token_file: self.token_file.or(file.token_file),
            allow: if self.allow.is_empty() { file.allow } else { self.allow },
            threads: self.threads.or(file.threads),
            max_connections: self
                .max_connections
                .or(file.max_connections)
                .or(Some(limits.connections)),
            max_requests: self.max_requests.or(file.max_requests).or(Some(limits.requests)),
            max_insertions: self.max_insertions.or(file.max_insertions).or(Some(limits.insertions)),
            header_timeout_s: self
                .header_timeout_s
                .or(file.header_timeout_s)
                .or(seconds(limits.header)),
            stall_timeout_s: self
                .stall_timeout_s
                .or(file.stall_timeout_s)
                .or(seconds(limits.stalled)),
            drain_s: self.drain_s.or(file.drain_s).or(seconds(limits.drain)),
            log_json: self.log_json.or(file.log_json).or(Some(false)),
        }
    }

    /// Where the second listener is to be.
    fn door(&self) -> Door {
        self.admin.unwrap_or_else(|| Door::behind(self.listen.unwrap_or(LISTEN)))
    }

    fn options(self, folder: PathBuf) -> Result<Options, Failure> {
        let changes = self.token_file.is_some() || !self.allow.is_empty();
        let is_optional = self.admin.is_none() && !changes;
        let door = self.door();
        if door == Door::None && changes {
            let reason = match self.admin {
                Some(_) => "--token-file and --allow are of no use with --admin none",
                None => "there is no port after 65535 for the second listener: say --admin",
            };
            return Err(Failure::Misused(reason.to_owned()));
        }
        let default = Limits::default();
        let seconds = |given: Option<u64>, default| given.map_or(default, Duration::from_secs);
        Ok(Options {
            folder,
            listen: self.listen.unwrap_or(LISTEN),
            memory_bytes: self.memory_mib.unwrap_or(MEMORY_MIB).saturating_mul(1 << 20),
            admin: match door {
                Door::At(listen) => Some(Admin {
                    listen,
                    is_optional,
                    token_file: self.token_file,
                    allowed: self.allow,
                }),
                Door::None => None,
            },
            threads: self.threads,
            limits: Limits {
                connections: self.max_connections.unwrap_or(default.connections),
                requests: self.max_requests.unwrap_or(default.requests),
                insertions: self.max_insertions.unwrap_or(default.insertions),
                header: seconds(self.header_timeout_s, default.header),
                stalled: seconds(self.stall_timeout_s, default.stalled),
                drain: seconds(self.drain_s, default.drain),
            },
        })
    }
}

impl Args {
    pub(crate) fn run(self) -> Result<ExitCode, Failure> {
        let file = self.config.as_deref().map(read_config).transpose()?.unwrap_or_default();
        let settings = self.settings.over(file);
        if self.print_config {
            output::line(toml::to_string(&settings)?.trim_end())?;
            if settings.admin.is_none() {
                let door: String = settings.door().into();
                output::line(format!("# admin = \"{door}\", if that is free"))?;
            }
            return Ok(ExitCode::SUCCESS);
        }
        log(settings.log_json == Some(true));
        let options = settings.options(self.catalog)?;
        run(&options, say)?;
        Ok(ExitCode::SUCCESS)
    }
}

fn say(service: &Service) {
    let admin = service.admin().map(|admin| format!(", changed on {admin}")).unwrap_or_default();
    output::say(format_args!("serving on http://{}{admin}", service.public()));
}

fn read_config(path: &Path) -> Result<Settings, Failure> {
    let failed = |reason: String| Failure::Failed(format!("{}: {reason}", path.display()).into());
    let text = std::fs::read_to_string(path).map_err(|error| failed(error.to_string()))?;
    toml::from_str(&text).map_err(|error| failed(error.to_string()))
}

/// Logs what is done, and done otherwise than asked, to stderr.
fn log(as_json: bool) {
    let log = tracing_subscriber::fmt()
        .with_writer(std::io::stderr)
        .with_max_level(tracing::Level::INFO)
        .with_target(false);
    // Nobody else listens in this process.
    let _ = if as_json { log.json().try_init() } else { log.with_ansi(false).try_init() };
}

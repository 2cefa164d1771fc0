//! wrk: as many requests as there are answers, over so many connections.

use std::fs;
use std::io;
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::process::Command;

use serde::Serialize;

use crate::bench::report::{Spread, cores};

/// The program, and the script that asks for pages in turn.
#[derive(Clone, Debug)]
pub(super) struct Wrk {
    program: PathBuf,
    script: PathBuf,
}

/// What a run has found.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub(super) struct Load {
    pub(super) requests_per_s: f64,
    pub(super) p50_ms: f64,
    pub(super) p99_ms: f64,
}

impl Wrk {
    /// It will ask for `paths`; the script is written to `script`.
    pub(super) fn new(program: &Path, paths: &[String], script: &Path) -> io::Result<Self> {
        let paths: String = paths.iter().map(|path| format!("  {path:?},\n")).collect();
        let text = format!(
            "local paths = {{\n{paths}}}\nlocal requests = {{}}\nlocal last = 0\n\
             function init()\n  for place, path in ipairs(paths) do\n    \
             requests[place] = wrk.format(\"GET\", path)\n  end\nend\n\
             function request()\n  last = last % #requests + 1\n  return requests[last]\nend\n"
        );
        fs::write(script, text)?;
        Ok(Self { program: program.to_owned(), script: script.to_owned() })
    }

    /// Asks for some seconds.
    pub(super) fn run(
        &self,
        address: SocketAddr,
        connections: usize,
        seconds: u64,
    ) -> io::Result<Load> {
        let mut command = Command::new(&self.program);
        command.arg("-t").arg(connections.min(cores()).to_string());
        command.arg("-c").arg(connections.to_string());
        command.arg("-d").arg(format!("{seconds}s")).arg("--latency").arg("-s").arg(&self.script);
        let output = command.arg(format!("http://{address}")).output()?;
        let said = String::from_utf8_lossy(&output.stdout);
        parse(&said).ok_or_else(|| {
            let said_else = String::from_utf8_lossy(&output.stderr);
            io::Error::other(format!("wrk: {}", format!("{said}{said_else}").trim()))
        })
    }
}

/// `None` of what is no report, or one of answers that are none.
fn parse(said: &str) -> Option<Load> {
    let field =
        |name: &str| said.lines().find_map(|line| line.trim().strip_prefix(name).map(str::trim));
    if field("Non-2xx").is_some() || field("Socket errors").is_some() {
        return None;
    }
    Some(Load {
        requests_per_s: field("Requests/sec:")?.parse().ok()?,
        p50_ms: milliseconds(field("50%")?)?,
        p99_ms: milliseconds(field("99%")?)?,
    })
}

fn milliseconds(text: &str) -> Option<f64> {
    let units = [("us", 1e-3), ("ms", 1.0), ("s", 1e3), ("m", 6e4)];
    let (number, unit) =
        units.iter().find_map(|(unit, ms)| Some((text.strip_suffix(unit)?, ms)))?;
    Some(number.parse::<f64>().ok()? * unit)
}

/// Runs over those of others, round by round.
pub(super) fn ratio(ours: &[Load], theirs: &[Load], of: fn(&Load) -> f64) -> Option<Spread> {
    Spread::of(ours.iter().zip(theirs).map(|(one, other)| of(one) / of(other)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_wrk_says_is_understood() {
        let said = "Running 2s test @ http://127.0.0.1:8398\n  2 threads and 8 connections\n  \
                    Thread Stats   Avg      Stdev     Max   +/- Stdev\n    \
                    Latency   541.48us  342.61us   9.50ms   93.72%\n  Latency Distribution\n     \
                    50%  417.00us\n     75%  573.00us\n     90%  745.00us\n     99%    1.36ms\n  \
                    30000 requests in 2.00s, 5.70GB read\nRequests/sec:  15062.98\n\
                    Transfer/sec:      2.85GB\n";
        let load = Load { requests_per_s: 15_062.98, p50_ms: 0.417, p99_ms: 1.36 };
        assert_eq!(parse(said), Some(load));
        assert_eq!(parse(&format!("{said}  Non-2xx or 3xx responses: 3\n")), None);
        assert_eq!(parse("unable to connect"), None);
        assert_eq!(milliseconds("1.20s"), Some(1200.0));
    }
}

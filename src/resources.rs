//! What this process has used, where the system tells.

use std::fs;

/// Processor seconds of all threads so far, or `None` if the system does not tell.
pub(crate) fn cpu_seconds() -> Option<f64> {
    // Fields 14 and 15 of proc(5), counted behind the command's closing parenthesis, in ticks of
    // a hundredth of a second on every Linux.
    let stat = fs::read_to_string("/proc/self/stat").ok()?;
    let mut fields = stat.rsplit_once(')')?.1.split_whitespace().skip(11);
    let mut ticks = || fields.next()?.parse::<f64>().ok();
    Some((ticks()? + ticks()?) / 100.0)
}

/// Anonymous memory held now, in bytes, or `None` if the system does not tell.
pub(crate) fn anonymous_bytes() -> Option<u64> {
    let status = fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find_map(|line| line.strip_prefix("RssAnon:"))?;
    let kib: u64 = line.trim().strip_suffix("kB")?.trim().parse().ok()?;
    Some(kib * 1024)
}

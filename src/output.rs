//! Where results and messages leave the program.

use std::fs;
use std::io::{self, Write};
use std::path::Path;

use serde::Serialize;

use crate::failure::Failure;

/// Prints a line on stdout.
pub(crate) fn line(text: impl std::fmt::Display) -> Result<(), Failure> {
    Ok(writeln!(io::stdout().lock(), "{text}")?)
}

/// Prints one JSON document on stdout.
pub(crate) fn json(document: &impl Serialize) -> Result<(), Failure> {
    let mut stdout = io::stdout().lock();
    serde_json::to_writer_pretty(&mut stdout, document).map_err(io::Error::from)?;
    Ok(writeln!(stdout)?)
}

/// Says something on stderr.
pub(crate) fn say(text: impl std::fmt::Display) {
    // Nobody to hear it is no reason to stop.
    let _ = writeln!(io::stderr().lock(), "{text}");
}

/// Writes a file so that it appears whole or not at all.
pub(crate) fn write_file(path: &Path, bytes: &[u8]) -> Result<(), Failure> {
    let failed = |source: io::Error| {
        io::Error::new(source.kind(), format!("cannot write {}: {source}", path.display()))
    };
    let name = path.file_name().ok_or_else(|| {
        Failure::Misused(format!("{} cannot be written: it names no file", path.display()))
    })?;
    let mut temporary = name.to_owned();
    temporary.push(format!(".{}.tmp", std::process::id()));
    let temporary = path.with_file_name(temporary);
    fs::write(&temporary, bytes).and_then(|()| fs::rename(&temporary, path)).map_err(|error| {
        // What was begun is nobody's; if it cannot be removed, the first error says more.
        let _ = fs::remove_file(&temporary);
        failed(error).into()
    })
}

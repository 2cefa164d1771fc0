//! Where results and messages leave the program.

use std::fs;
use std::io::{self, Write};
use std::path::Path;

use serde::Serialize;

use crate::failure::Failure;

/// Prints a line on stdout.
pub(crate) fn line(text: impl std::fmt::Display) -> Result<(), Failure> {
    Ok(writeln!(io::stdout().lock(), "{}", plain(text))?)
}

/// Control characters, but ends of lines and tabs, as escapes: what a file or a server says does not
/// steer a terminal.
fn plain(text: impl std::fmt::Display) -> String {
    let mut plain = String::new();
    for character in text.to_string().chars() {
        if character.is_control() && !matches!(character, '\n' | '\t') {
            plain.extend(character.escape_default());
        } else {
            plain.push(character);
        }
    }
    plain
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
    let _ = writeln!(io::stderr().lock(), "{}", plain(text));
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

#[cfg(test)]
mod tests {
    use super::plain;

    #[test]
    fn nothing_that_is_said_steers_a_terminal() {
        assert_eq!(plain("höher\tals\n21 km"), "höher\tals\n21 km");
        assert_eq!(plain("a\u{1b}[2J\r\u{9b}b\u{7f}"), "a\\u{1b}[2J\\r\\u{9b}b\\u{7f}");
    }
}

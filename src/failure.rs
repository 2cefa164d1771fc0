//! What went wrong, as the user hears of it.

use std::error::Error;
use std::process::ExitCode;

use crate::output;

/// Exit status of a call that makes no sense.
const MISUSED: u8 = 2;

/// Why a command did not do what was asked.
#[derive(Debug)]
pub(crate) enum Failure {
    /// It could not.
    Failed(Box<dyn Error>),
    /// It could not, and this is a command that goes on from there.
    Unfinished {
        /// Why.
        reason: Box<dyn Error>,
        /// What to type.
        command: String,
    },
    /// It was asked for something that makes no sense.
    Misused(String),
}

impl<E: Error + 'static> From<E> for Failure {
    fn from(error: E) -> Self {
        Self::Failed(Box::new(error))
    }
}

impl Failure {
    /// The error and its causes in one line.
    #[cfg(feature = "viewer")]
    pub(crate) fn in_full(&self) -> String {
        match self {
            Self::Failed(error) | Self::Unfinished { reason: error, .. } => in_full(error.as_ref()),
            Self::Misused(reason) => reason.clone(),
        }
    }

    /// Prints it, a line for each cause, and says how to exit.
    pub(crate) fn report(&self) -> ExitCode {
        match self {
            // Whoever reads our output has had enough of it.
            Self::Failed(error) if is_broken_pipe(error.as_ref()) => ExitCode::SUCCESS,
            Self::Failed(error) => {
                say_why("error", error.as_ref());
                ExitCode::FAILURE
            }
            Self::Unfinished { reason, command } => {
                say_why("error", reason.as_ref());
                output::say(format!("to go on: {command}"));
                ExitCode::FAILURE
            }
            Self::Misused(reason) => {
                output::say(format!("error: {reason}"));
                ExitCode::from(MISUSED)
            }
        }
    }
}

/// An error and its causes in one line.
#[cfg(feature = "viewer")]
pub(crate) fn in_full(error: &(dyn Error + 'static)) -> String {
    let errors = std::iter::successors(Some(error), |&error| error.source());
    let texts: Vec<String> = errors.map(|error| error.to_string().trim_end().to_owned()).collect();
    texts.join(": ")
}

/// Says what went wrong, and on a line for each what that came from.
pub(crate) fn say_why(what: &str, error: &(dyn Error + 'static)) {
    output::say(format!("{what}: {error}"));
    for cause in std::iter::successors(error.source(), |&cause| cause.source()) {
        // Some decoders end theirs with a line's end.
        output::say(format!("  caused by: {}", cause.to_string().trim_end()));
    }
}

fn is_broken_pipe(error: &(dyn Error + 'static)) -> bool {
    let io = error.downcast_ref::<std::io::Error>();
    io.is_some_and(|error| error.kind() == std::io::ErrorKind::BrokenPipe)
}

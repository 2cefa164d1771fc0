//! Errors in words.

use std::error::Error;

/// An error and its causes on one line.
pub(crate) fn in_words(error: &dyn Error) -> String {
    let causes = std::iter::successors(error.source(), |&cause| cause.source());
    causes.fold(error.to_string(), |text, cause| format!("{text}: {cause}"))
}

//! Ctrl-C and its like: the first asks, the second ends the program at once.

use std::process;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use areoid_preprocess::build::Proceed;

use crate::failure::Failure;

/// Whether someone wants the program to end.
#[derive(Clone, Debug)]
pub(crate) struct Interrupt {
    asked: Arc<AtomicBool>,
}

impl Interrupt {
    /// Listens from now on, which only one can; `answer` is called, from a thread of its own, when
    /// the program is asked to end.
    pub(crate) fn listen(answer: impl Fn() + Send + 'static) -> Result<Self, Failure> {
        let asked = Arc::new(AtomicBool::new(false));
        let heard = Arc::clone(&asked);
        ctrlc::set_handler(move || {
            if heard.swap(true, Ordering::Relaxed) {
                process::exit(1);
            }
            answer();
        })?;
        Ok(Self { asked })
    }

    pub(crate) fn proceed(&self) -> Proceed {
        if self.asked.load(Ordering::Relaxed) { Proceed::No } else { Proceed::Yes }
    }
}

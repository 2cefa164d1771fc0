//! Vulkan's validation layer, where it is installed, is heard by all tests: what it complains of ends them.
//!
//! A build with assertions loads it, and wgpu logs what it says.

use std::io::Write as _;

use log::{LevelFilter, Log, Metadata, Record};

/// Said of shaders that are sound: a layer older than the language does not know that it exists.
const OLD_LAYER: &str = "SPIR-V module not valid: Invalid source language operand: 10";

struct Listener;

impl Log for Listener {
    fn enabled(&self, metadata: &Metadata<'_>) -> bool {
        metadata.target().starts_with("wgpu_hal::vulkan")
    }

    /// wgpu catches what panics here: the process has to end.
    fn log(&self, record: &Record<'_>) {
        let said = record.args().to_string();
        if self.enabled(record.metadata()) && is_complaint(&said) {
            // Past what the test harness keeps to itself, and would lose.
            let _ = writeln!(std::io::stderr(), "the validation layer says: {said}");
            std::process::abort();
        }
    }

    fn flush(&self) {}
}

/// By the kind of message that wgpu begins with.
fn is_complaint(said: &str) -> bool {
    ["VALIDATION [", "PERFORMANCE ["].iter().any(|kind| said.starts_with(kind))
        && !said.contains(OLD_LAYER)
}

/// Before a device is made.
pub(super) fn listen() {
    log::set_logger(&Listener).expect("nobody else listens");
    log::set_max_level(LevelFilter::Warn);
}

#[test]
fn complaints_are_told_from_notes() {
    assert!(is_complaint("VALIDATION [VUID-vkCmdDraw-None-02699 (0x1)]\n\tan error"));
    assert!(!is_complaint("GENERAL [Loader Message (0x0)]\n\ta note"));
    assert!(!is_complaint(&format!("VALIDATION [UNASSIGNED (0x2)]\n\t{OLD_LAYER}")));
}

//! What Vulkan's validation layer says of a program, if the layer is installed: `./setup.sh tests`
//! does that.
//!
//! A program that is built with assertions loads the layer, and hears what it says without telling
//! anybody. The layer's own settings let it write that down.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

/// Said of shaders that are sound: a layer older than the language does not know that it exists.
const OLD_LAYER: &str = "SPIR-V module not valid: Invalid source language operand: 10";

/// The layer's notes on one program.
pub(crate) struct Validation {
    folder: PathBuf,
}

impl Validation {
    /// Notes in a folder.
    pub(crate) fn new(folder: &Path) -> Self {
        let notes = Self { folder: folder.to_owned() };
        let settings = format!(
            "khronos_validation.debug_action = VK_DBG_LAYER_ACTION_LOG_MSG\n\
             khronos_validation.report_flags = error,warn,perf,info\n\
             khronos_validation.log_filename = {}\n",
            notes.log().display()
        );
        fs::write(folder.join("vk_layer_settings.txt"), settings).unwrap();
        notes
    }

    fn log(&self) -> PathBuf {
        self.folder.join("validation.txt")
    }

    /// Notes what is said of a program yet to run.
    pub(crate) fn watch(&self, command: &mut Command) {
        command.env("VK_LAYER_SETTINGS_PATH", &self.folder);
    }

    /// Fails if anything was said of the program, which has ended.
    pub(crate) fn assert_silent(&self) {
        let Ok(said) = fs::read_to_string(self.log()) else {
            assert!(!is_installed(), "the validation layer is there and noted nothing");
            return;
        };
        let is_complaint = |line: &&str| {
            ["(ERROR / ", "(WARN / ", "(PERF / "].iter().any(|severity| line.contains(severity))
                && !line.contains(OLD_LAYER)
        };
        assert!(said.contains("Khronos Validation Layer Active"), "{said}");
        let complaints: Vec<&str> = said.lines().filter(is_complaint).collect();
        assert!(complaints.is_empty(), "{complaints:#?}");
    }
}

fn is_installed() -> bool {
    Path::new("/usr/share/vulkan/explicit_layer.d/VkLayer_khronos_validation.json").exists()
}

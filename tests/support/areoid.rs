//! The command line, run as anyone would.

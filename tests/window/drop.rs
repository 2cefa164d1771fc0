//! The other end of a file dropped on a window: a source of the X drag-and-drop protocol.
//!
//! ```text
//!   source:  XdndEnter ▶ XdndPosition ▶              ▶ answer ▶ XdndDrop
//!   window:                            asks for paths                    ▶ XdndFinished
//! ```
//!
//! # References
//!
//! *Drag-and-Drop Protocol for the X Window System*, version 5.

use std::path::Path;

use x11rb::connection::Connection as _;
use x11rb::protocol::Event;
use x11rb::protocol::xproto::{
    ConnectionExt as _, CreateWindowAux, EventMask, PropMode, SELECTION_NOTIFY_EVENT,
    SelectionNotifyEvent, Window, WindowClass,
};
use x11rb::wrapper::ConnectionExt as _;
use x11rb::{COPY_DEPTH_FROM_PARENT, COPY_FROM_PARENT, CURRENT_TIME};

use super::display::{Display, wait_for};

const VERSION: u32 = 5;

/// Drops a file on a window, and waits until the window has it.
pub(crate) fn drop_file(display: &Display, window: Window, file: &Path) {
    let connection = &display.connection;
    let root = connection.setup().roots[0].root;
    let source = connection.generate_id().unwrap();
    let (depth, class) = (COPY_DEPTH_FROM_PARENT, WindowClass::INPUT_OUTPUT);
    let looks = CreateWindowAux::new();
    connection
        .create_window(depth, source, root, 0, 0, 1, 1, 0, class, COPY_FROM_PARENT, &looks)
        .unwrap();
    let [selection, paths, copy] =
        ["XdndSelection", "text/uri-list", "XdndActionCopy"].map(|name| display.atom(name));
    connection.set_selection_owner(source, selection, CURRENT_TIME).unwrap();

    display.tell(window, "XdndEnter", [source, VERSION << 24, paths, 0, 0]);
    display.tell(window, "XdndPosition", [source, 0, 0, CURRENT_TIME, copy]);
    wait_for("a window that asks what is dropped", || {
        while let Some(event) = connection.poll_for_event().unwrap() {
            let Event::SelectionRequest(asked) = event else { continue };
            let text = format!("file://{}\r\n", file.display());
            let (mode, kind) = (PropMode::REPLACE, asked.target);
            connection
                .change_property8(mode, asked.requestor, asked.property, kind, text.as_bytes())
                .unwrap();
            let answer = SelectionNotifyEvent {
                response_type: SELECTION_NOTIFY_EVENT,
                sequence: 0,
                time: asked.time,
                requestor: asked.requestor,
                selection: asked.selection,
                target: asked.target,
                property: asked.property,
            };
            let mask = EventMask::NO_EVENT;
            connection.send_event(false, asked.requestor, mask, answer).unwrap();
            return Ok(());
        }
        Err("it did not".to_owned())
    });
    display.tell(window, "XdndDrop", [source, 0, CURRENT_TIME, 0, 0]);
    let finished = display.atom("XdndFinished");
    wait_for("a window that has what is dropped", || {
        while let Some(event) = connection.poll_for_event().unwrap() {
            if matches!(event, Event::ClientMessage(told) if told.type_ == finished) {
                return Ok(());
            }
        }
        Err("it did not say so".to_owned())
    });
}

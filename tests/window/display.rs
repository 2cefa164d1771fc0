//! A display of its own, and a hand on it: Xvfb, driven through the XTEST extension.

use std::io::{BufRead as _, BufReader};
use std::process::{Child, Command, Stdio};
use std::thread;
use std::time::{Duration, Instant};

use image::{Rgb, RgbImage};
use x11rb::CURRENT_TIME;
use x11rb::connection::Connection as _;
use x11rb::protocol::xproto::{
    Atom, AtomEnum, BUTTON_PRESS_EVENT, BUTTON_RELEASE_EVENT, ClientMessageEvent,
    ConfigureWindowAux, ConnectionExt as _, EventMask, ImageFormat, InputFocus, KEY_PRESS_EVENT,
    KEY_RELEASE_EVENT, MOTION_NOTIFY_EVENT, MapState, Window,
};
use x11rb::protocol::xtest::ConnectionExt as _;
use x11rb::rust_connection::RustConnection;

/// How long anything may take, on a machine however slow.
const PATIENCE: Duration = Duration::from_secs(150);
/// Between two looks at something that is waited for.
const LOOK_AGAIN: Duration = Duration::from_millis(50);

/// Buttons of a pointer, as X numbers them.
pub(crate) const LEFT: u8 = 1;
pub(crate) const RIGHT: u8 = 3;
pub(crate) const WHEEL_UP: u8 = 4;

/// A display without a screen that anybody sees, ended with its owner.
pub(crate) struct Display {
    server: Child,
    /// What `DISPLAY` has to be.
    pub(crate) name: String,
    pub(crate) connection: RustConnection,
    root: Window,
}

impl Display {
    pub(crate) fn open() -> Self {
        let mut command = Command::new("Xvfb");
        command.args(["-displayfd", "1", "-screen", "0", "1400x800x24", "-nolisten", "tcp"]);
        let mut server = command
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn()
            .expect("Xvfb is there: ./setup.sh tests installs it");
        let mut number = String::new();
        BufReader::new(server.stdout.take().unwrap()).read_line(&mut number).unwrap();
        let name = format!(":{}", number.trim());
        let (connection, screen) = RustConnection::connect(Some(&name)).unwrap();
        let root = connection.setup().roots[screen].root;
        Self { server, name, connection, root }
    }

    pub(crate) fn atom(&self, name: &str) -> Atom {
        self.connection.intern_atom(false, name.as_bytes()).unwrap().reply().unwrap().atom
    }

    /// The visible window of a title, which the keys go to from now on.
    pub(crate) fn window(&self, title: &str) -> Window {
        let window = wait_for(title, || {
            let tree = self.connection.query_tree(self.root).unwrap().reply().unwrap();
            let found = tree.children.into_iter().find(|&window| self.is_seen(window, title));
            found.ok_or_else(|| "no such window".to_owned())
        });
        self.connection.set_input_focus(InputFocus::PARENT, window, CURRENT_TIME).unwrap();
        self.connection.flush().unwrap();
        window
    }

    /// Windows come and go while they are asked for.
    fn is_seen(&self, window: Window, title: &str) -> bool {
        let (name, text) = (AtomEnum::WM_NAME, AtomEnum::ANY);
        let name = self.connection.get_property(false, window, name, text, 0, 256).unwrap().reply();
        let state = self.connection.get_window_attributes(window).unwrap().reply();
        name.is_ok_and(|name| name.value == title.as_bytes())
            && state.is_ok_and(|state| state.map_state == MapState::VIEWABLE)
    }

    /// Width and height in pixels.
    pub(crate) fn size(&self, window: Window) -> [u32; 2] {
        let geometry = self.connection.get_geometry(window).unwrap().reply().unwrap();
        [geometry.width, geometry.height].map(u32::from)
    }

    pub(crate) fn resize(&self, window: Window, [width, height]: [u32; 2]) {
        let size = ConfigureWindowAux::new().width(width).height(height);
        self.connection.configure_window(window, &size).unwrap();
        self.connection.flush().unwrap();
    }

    /// What a window shows.
    pub(crate) fn look(&self, window: Window) -> RgbImage {
        let [width, height] = self.size(window);
        let [columns, rows] = [width, height].map(|side| u16::try_from(side).unwrap());
        let format = ImageFormat::Z_PIXMAP;
        let asked = self.connection.get_image(format, window, 0, 0, columns, rows, !0).unwrap();
        let bytes = asked.reply().unwrap().data;
        RgbImage::from_fn(width, height, |x, y| {
            let at = 4 * (y * width + x) as usize;
            Rgb([bytes[at + 2], bytes[at + 1], bytes[at]])
        })
    }

    /// Presses and releases the key of a character that needs no other.
    pub(crate) fn press(&self, key: char) {
        let setup = self.connection.setup();
        let first = setup.min_keycode;
        let asked = self.connection.get_keyboard_mapping(first, setup.max_keycode - first + 1);
        let mapping = asked.unwrap().reply().unwrap();
        let codes = mapping.keysyms.chunks(usize::from(mapping.keysyms_per_keycode));
        let place = codes.into_iter().position(|symbols| symbols[0] == u32::from(key)).unwrap();
        let code = first + u8::try_from(place).unwrap();
        self.fake(KEY_PRESS_EVENT, code, [0, 0]);
        self.fake(KEY_RELEASE_EVENT, code, [0, 0]);
    }

    pub(crate) fn click(&self, button: u8, at: [i16; 2]) {
        self.fake(MOTION_NOTIFY_EVENT, 0, at);
        self.fake(BUTTON_PRESS_EVENT, button, at);
        self.fake(BUTTON_RELEASE_EVENT, button, at);
    }

    /// Drags with a button from one place to another, in steps.
    pub(crate) fn drag(&self, button: u8, from: [i16; 2], to: [i16; 2]) {
        const STEPS: i16 = 8;

        self.fake(MOTION_NOTIFY_EVENT, 0, from);
        self.fake(BUTTON_PRESS_EVENT, button, from);
        for step in 1..=STEPS {
            let at = [0, 1].map(|axis| from[axis] + (to[axis] - from[axis]) * step / STEPS);
            self.fake(MOTION_NOTIFY_EVENT, 0, at);
        }
        self.fake(BUTTON_RELEASE_EVENT, button, to);
    }

    fn fake(&self, event: u8, detail: u8, [x, y]: [i16; 2]) {
        let faked = self.connection.xtest_fake_input(event, detail, 0, self.root, x, y, 0);
        faked.unwrap().check().unwrap();
    }

    /// Asks a window to close, as the button in its title bar does.
    pub(crate) fn close(&self, window: Window) {
        self.tell(window, "WM_PROTOCOLS", [self.atom("WM_DELETE_WINDOW"), 0, 0, 0, 0]);
    }

    pub(crate) fn tell(&self, window: Window, what: &str, data: [u32; 5]) {
        let message = ClientMessageEvent::new(32, window, self.atom(what), data);
        self.connection.send_event(false, window, EventMask::NO_EVENT, message).unwrap();
        self.connection.flush().unwrap();
    }
}

impl Drop for Display {
    fn drop(&mut self) {
        let _ = self.server.kill();
        let _ = self.server.wait();
    }
}

/// Looks until something is there. Fails with what was seen last.
pub(crate) fn wait_for<T>(what: &str, mut look: impl FnMut() -> Result<T, String>) -> T {
    let end = Instant::now() + PATIENCE;
    loop {
        match look() {
            Ok(found) => return found,
            Err(seen) if Instant::now() > end => panic!("waited for {what}: {seen}"),
            Err(_) => thread::sleep(LOOK_AGAIN),
        }
    }
}

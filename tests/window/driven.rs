//! The real window, driven as anyone would: keys, pointer, a raster dropped on it, a new size, the end.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Child, ExitStatus};

use image::RgbImage;
use serde_json::Value;
use tempfile::TempDir;
use x11rb::protocol::xproto::Window;

use super::display::{Display, LEFT, RIGHT, WHEEL_UP, wait_for};
use super::drop::drop_file;
use super::pictures::{changed, halves, lit, redness};
use crate::support::validation::Validation;
use crate::{areoid, run};

/// `areoid view` on a display of its own.
struct Driven {
    display: Display,
    window: Window,
    program: Child,
    validation: Validation,
    folder: TempDir,
    /// Screenshots so far.
    saved: u32,
}

/// The size that all but the first pictures have: drawing is slow on a processor.
const SIZE: [u32; 2] = [640, 400];

impl Driven {
    /// A window on the heights of Mars alone.
    fn open() -> Self {
        let folder = TempDir::new().unwrap();
        let catalog = folder.path().join("heights");
        run(areoid()
            .arg("ingest")
            .arg(demo("mola_height_8ppd.tif"))
            .arg("--catalog")
            .arg(&catalog));
        let display = Display::open();
        let validation = Validation::new(folder.path());
        let mut command = areoid();
        validation.watch(&mut command);
        command.arg("view").arg(&catalog).arg("--start=-90,-8").current_dir(folder.path());
        command.env("DISPLAY", &display.name).env("WINIT_X11_SCALE_FACTOR", "1");
        command.env_remove("XAUTHORITY").env_remove("XMODIFIERS");
        command.stderr(fs::File::create(folder.path().join("stderr")).unwrap());
        let program = command.spawn().unwrap();
        let window = display.window(&format!("Areoid: {}", catalog.display()));
        Self { display, window, program, validation, folder, saved: 0 }
    }

    /// What the window shows, once it is as it has to be: `None`, or what is wrong with it.
    fn shows(
        &mut self,
        what: &str,
        mut wrong: impl FnMut(&RgbImage) -> Option<String>,
    ) -> RgbImage {
        let ended = self.program.try_wait().unwrap();
        assert!(ended.is_none(), "{ended:?} before {what}: {}", self.said());
        let (display, window) = (&self.display, self.window);
        let picture = wait_for(what, || {
            let picture = display.look(window);
            wrong(&picture).map_or(Ok(picture), Err)
        });
        if let Some(folder) = std::env::var_os("AREOID_KEEP_PICTURES") {
            let name = format!("{}.png", what.replace(' ', "_"));
            picture.save(Path::new(&folder).join(name)).unwrap();
        }
        picture
    }

    /// Waits for a picture that differs from `before` in at least `percent` of its pixels.
    fn changes(&mut self, what: &str, before: &RgbImage, percent: u32) -> RgbImage {
        self.shows(what, |picture| {
            let share = changed(picture, before);
            (share < percent).then(|| format!("{share} % of the pixels changed"))
        })
    }

    /// Waits for `before` to come back, but for pages that came since.
    fn returns(&mut self, what: &str, before: &RgbImage) {
        self.shows(what, |picture| {
            let share = changed(picture, before);
            (share > 5).then(|| format!("{share} % of the pixels differ"))
        });
    }

    /// Waits until no more pages come: nothing has changed for a while.
    fn rests(&mut self) -> RgbImage {
        const LOOKS: u32 = 20;

        let (mut before, mut equal) = (self.display.look(self.window), 0);
        let rests = |picture: &RgbImage| {
            equal = if changed(picture, &before) == 0 { equal + 1 } else { 0 };
            before = picture.clone();
            (equal < LOOKS).then(|| "it changes".to_owned())
        };
        self.shows("a picture at rest", rests)
    }

    /// The screenshot that a key saves is what the window shows.
    fn is_saved(&mut self, what: &str) {
        self.saved += 1;
        let path = self.folder.path().join(format!("areoid-{:04}.png", self.saved));
        self.display.press('p');
        let saved = wait_for(what, || image::open(&path).map_err(|error| error.to_string()));
        self.returns(what, &saved.to_rgb8());
    }

    /// The eyes of the flight that was recorded.
    fn recorded(&self) -> Vec<Value> {
        let path = self.folder.path().join("flight-0001.json");
        let flight = wait_for("a flight", || {
            let text = fs::read_to_string(&path).map_err(|error| error.to_string())?;
            serde_json::from_str::<Value>(&text).map_err(|error| error.to_string())
        });
        flight["keys"].as_array().unwrap().iter().map(|key| key["eye"].clone()).collect()
    }

    fn said(&self) -> String {
        fs::read_to_string(self.folder.path().join("stderr")).unwrap()
    }

    fn ends(&mut self) -> ExitStatus {
        let program = &mut self.program;
        wait_for("the end", || program.try_wait().unwrap().ok_or_else(|| "it runs".to_owned()))
    }
}

impl Drop for Driven {
    fn drop(&mut self) {
        let _ = self.program.kill();
        let _ = self.program.wait();
    }
}

fn demo(raster: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("demo/mars").join(raster)
}

/// One window, from its opening to its end: each thing done shows, and what is undone is gone.
#[test]
fn a_window_does_what_the_hand_says() {
    let mut driven = Driven::open();
    let window = driven.window;

    let [width, height] = driven.display.size(window);
    assert_eq!([width, height], [1280, 720]);
    let opened = driven.shows("a planet and a panel", |picture| {
        let (ground, panel) =
            (lit(picture, [0.4, 0.4], [0.6, 0.6]), lit(picture, [0.01, 0.01], [0.1, 0.05]));
        (ground < 99 || panel < 50)
            .then(|| format!("{ground} % of the middle, {panel} % of the panel"))
    });

    driven.display.press('h');
    let bare = driven.shows("no panel", |picture| {
        let corner = lit(picture, [0.0, 0.0], [0.2, 0.2]);
        (corner > 0).then(|| format!("{corner} % of the corner"))
    });
    assert!(lit(&bare, [0.4, 0.4], [0.6, 0.6]) > 98, "the planet is gone, too");
    assert!(changed(&bare, &opened) < 25, "the panel is not all that went");

    // The same view in fewer pixels: the disc covers as much of the height as it did.
    let breadth = |picture: &RgbImage| {
        lit(picture, [0.0, 0.49], [1.0, 0.51]) * picture.width() / picture.height()
    };
    driven.display.resize(window, SIZE);
    let small = driven.shows("a smaller window", |picture| {
        let breadths = [&bare, picture].map(breadth);
        let is_whole = picture.dimensions() == SIZE.into() && breadths[0].abs_diff(breadths[1]) < 3;
        (!is_whole).then(|| format!("{:?}, {breadths:?} % as broad", picture.dimensions()))
    });
    let disc = lit(&small, [0.0, 0.0], [1.0, 1.0]);

    for _ in 0..6 {
        driven.display.click(WHEEL_UP, [320, 200]);
    }
    driven.shows("a nearer planet", |picture| {
        let now = lit(picture, [0.0, 0.0], [1.0, 1.0]);
        (now < 99).then(|| format!("{disc} %, then {now} % is planet"))
    });
    let near = driven.rests();
    driven.is_saved("a screenshot");

    driven.display.press('d');
    let levels = driven.changes("levels", &near, 90);
    driven.display.press('d');
    driven.changes("datasets", &levels, 90);
    (0..4).for_each(|_| driven.display.press('d'));
    driven.returns("no levels", &near);

    driven.display.drag(LEFT, [280, 180], [360, 210]);
    driven.changes("ground under the hand", &near, 5);

    driven.display.drag(RIGHT, [320, 380], [320, 140]);
    let tilted = driven.shows("sky over a tilted view", |picture| {
        let [sky, ground] =
            [[0.0, 0.2], [0.8, 1.0]].map(|[top, bottom]| lit(picture, [0.0, top], [1.0, bottom]));
        (sky > 5 || ground < 95)
            .then(|| format!("{sky} % of the sky and {ground} % of the ground are lit"))
    });

    let gray = redness(&tilted);
    drop_file(&driven.display, window, &demo("viking_color.jpg"));
    let red = driven.shows("the colors of a raster dropped", |picture| {
        let now = redness(picture);
        (now < gray + 20).then(|| format!("red is {gray} above blue, then {now}"))
    });

    driven.display.press('v');
    driven.changes("two views", &red, 30);
    let two = driven.rests();
    let [left, right] = halves(&two);
    assert!(changed(&left, &right) > 30, "the second view is the first");
    driven.display.press('r');
    driven.display.drag(LEFT, [440, 200], [520, 200]);
    driven.shows("the right place moved alone", |picture| {
        let now = halves(picture);
        let shares = [changed(&now[0], &left), changed(&now[1], &right)];
        (shares[0] > 5 || shares[1] < 8).then(|| format!("{shares:?} % of the halves changed"))
    });
    driven.display.drag(LEFT, [520, 200], [440, 200]);
    driven.returns("the right place moved back", &two);
    driven.display.press('r');
    let eyes = driven.recorded();
    assert!(eyes.iter().any(|eye| *eye != eyes[0]), "the place that moved is not recorded");
    driven.rests();
    driven.is_saved("a screenshot of two views");

    driven.display.close(window);
    let status = driven.ends();
    assert_eq!((status.code(), driven.said().as_str()), (Some(0), ""));
    driven.validation.assert_silent();
}

//! Pictures of Mars, drawn by the program itself, held against an f64 ray caster that knows
//! nothing of the viewer, and against golden images.
//!
//! The ray caster marches each pixel's ray to the composed surface that `areoid height` answers
//! with (law 7). The viewer may be off by its tolerance: a pixel.

#![cfg(feature = "viewer")]
#![expect(clippy::unwrap_used, reason = "a failed test may panic")]

mod support {
    pub(crate) mod npy;
    pub(crate) mod ray;
    #[cfg(target_os = "linux")]
    pub(crate) mod validation;
}

mod flight {
    mod fly;
    mod styles;
}

#[cfg(target_os = "linux")]
mod window {
    mod display;
    mod driven;
    mod drop;
    mod pictures;
}

use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use std::sync::LazyLock;

use areoid_formats::catalog::Catalog;
use areoid_formats::query::HeightQuery;
use glam::DVec3;
use support::npy::Array;
use support::ray::{Camera, MARS_RADIUS, cast};
use tempfile::TempDir;

struct Scene {
    name: &'static str,
    eye: [f64; 3],
    target: [f64; 3],
    sun: [f64; 2],
    fov_deg: f64,
}

/// The views of the demo.
const SCENES: [Scene; 5] = [
    Scene {
        name: "disc",
        eye: [-90.0, 5.0, 7_400_000.0],
        target: [-90.0, 5.0, 0.0],
        sun: [-110.0, 20.0],
        fov_deg: 45.0,
    },
    Scene {
        name: "olympus_mons",
        eye: [-138.0, 7.0, 900_000.0],
        target: [-133.8, 17.6, 0.0],
        sun: [-75.0, 5.0],
        fov_deg: 30.0,
    },
    Scene {
        name: "valles_marineris",
        eye: [-80.0, -24.0, 1_000_000.0],
        target: [-69.0, -11.5, 0.0],
        sun: [-15.0, 5.0],
        fov_deg: 30.0,
    },
    Scene {
        name: "north_pole",
        eye: [0.0, 90.0, 3_000_000.0],
        target: [0.0, 90.0, 0.0],
        sun: [60.0, 40.0],
        fov_deg: 45.0,
    },
    Scene {
        name: "south_pole",
        eye: [0.0, -90.0, 3_000_000.0],
        target: [0.0, -90.0, 0.0],
        sun: [60.0, -40.0],
        fov_deg: 45.0,
    },
];

fn areoid() -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_areoid"));
    // The driver looks for a window system it does not need.
    command.env("XDG_RUNTIME_DIR", std::env::temp_dir());
    command
}

fn run(command: &mut Command) {
    let output = command.output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
}

/// Runs what draws, and hears what the validation layer says of it.
fn draw(command: &mut Command) -> Output {
    #[cfg(target_os = "linux")]
    let notes = TempDir::new().unwrap();
    #[cfg(target_os = "linux")]
    let validation = support::validation::Validation::new(notes.path());
    #[cfg(target_os = "linux")]
    validation.watch(command);
    let output = command.output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    #[cfg(target_os = "linux")]
    validation.assert_silent();
    output
}

/// The demo's catalog, made once.
static CATALOG: LazyLock<(TempDir, PathBuf)> = LazyLock::new(|| {
    let folder = TempDir::new().unwrap();
    let catalog = folder.path().join("mars");
    let demo = Path::new(env!("CARGO_MANIFEST_DIR")).join("demo/mars");
    for raster in [
        "mola_height_8ppd.tif",
        "mola_north_polar_4km.tif",
        "mola_south_polar_4km.tif",
        "viking_color.jpg",
    ] {
        run(areoid().arg("ingest").arg(demo.join(raster)).arg("--catalog").arg(&catalog));
    }
    (folder, catalog)
});

fn list(numbers: &[f64]) -> String {
    numbers.iter().map(f64::to_string).collect::<Vec<_>>().join(",")
}

fn snapshot(scene: &Scene, size: &str, picture: &Path, aovs: &[(&str, &Path)]) {
    snapshot_with(scene, size, picture, aovs, &[]);
}

fn snapshot_with(
    scene: &Scene,
    size: &str,
    picture: &Path,
    aovs: &[(&str, &Path)],
    options: &[String],
) {
    let mut command = areoid();
    command.arg("snapshot").arg(&CATALOG.1).arg("-o").arg(picture).args(["--size", size]);
    command.arg("--eye").arg(list(&scene.eye)).arg("--target").arg(list(&scene.target));
    command.arg("--sun").arg(list(&scene.sun)).arg("--fov-deg").arg(scene.fov_deg.to_string());
    command.args(options);
    for (name, path) in aovs {
        command.arg("--aov").arg(format!("{name}={}", path.display()));
    }
    draw(&mut command);
}

/// Every fourth pixel of 512 × 512, both ways: position within a pixel and a half of where the
/// ray meets the surface, height within what a pixel resolves. What is seen beside the ray is what the
/// triangles are off by: a quarter of the tolerance is theirs.
#[test]
fn positions_and_heights_are_those_of_the_composed_surface() {
    const SIDE: usize = 512;
    let folder = TempDir::new().unwrap();
    let path = |name: &str| folder.path().join(name);
    let (_, archives) = Catalog::open_with_archives(&CATALOG.1).unwrap();
    for scene in &SCENES {
        let aovs = [path("p.npy"), path("h.npy"), path("g.npy")];
        let named = [("position", &*aovs[0]), ("height", &*aovs[1]), ("geographic", &*aovs[2])];
        snapshot(scene, "512x512", &path("s.png"), &named);
        let [positions, heights, geographic] = aovs.map(|path| Array::read(&path));
        assert_eq!(positions.shape, [SIDE, SIDE, 3]);
        assert_eq!((heights.shape.as_slice(), geographic.shape.len()), (&[SIDE, SIDE][..], 3));

        let camera = Camera::new(scene.eye, scene.target, scene.fov_deg, SIDE);
        let mut query = HeightQuery::new(&archives, None);
        let (mut on_planet, mut off, mut differ) = (0, 0, 0);
        for row in (0..SIDE).step_by(4) {
            for col in (0..SIDE).step_by(4) {
                let at = row * SIDE + col;
                let drawn = DVec3::from_slice(&positions.values[3 * at..]);
                let ray = camera.ray(row, col);
                let Some(hit) = cast(&mut query, camera.eye, ray) else {
                    off += usize::from(drawn.is_finite());
                    continue;
                };
                // Where the surface is seen edge-on, a pixel spans many kilometers.
                let slope = hit.point.normalize().dot(-ray);
                if slope < 0.15 {
                    continue;
                }
                on_planet += 1;
                let pixel_m = (hit.point - camera.eye).length() * camera.pixel_angle;
                let beside = (drawn - hit.point).reject_from(ray).length() / pixel_m;
                let along = (drawn - hit.point).dot(ray).abs() * slope / pixel_m;
                let height = (heights.values[at] - hit.height).abs() / pixel_m;
                let longitude = geographic.values[2 * at].to_radians();
                let latitude = geographic.values[2 * at + 1].to_radians();
                let direction = DVec3::new(
                    latitude.cos() * longitude.cos(),
                    latitude.cos() * longitude.sin(),
                    latitude.sin(),
                );
                let astray = (direction - drawn.normalize()).length() * MARS_RADIUS / pixel_m;
                let close = beside < 0.25 && along < 1.5 && height < 1.5 && astray < 0.1;
                differ += usize::from(!close);
            }
        }
        assert!(on_planet > 5_000, "{}: {on_planet} rays meet the planet", scene.name);
        assert!(differ * 1000 <= on_planet, "{}: {differ} of {on_planet} differ", scene.name);
        assert!(off * 1000 <= on_planet, "{}: {off} drawn beside the planet", scene.name);
    }
}

/// From so far that the coarsest page would do, and with a tolerance so fine that the finest is
/// needed: heights and colors are there all over the disc.
#[test]
fn a_planet_keeps_its_face_from_afar() {
    let folder = TempDir::new().unwrap();
    let [level, picture] = ["l.npy", "s.png"].map(|name| folder.path().join(name));
    for (altitude, size, tolerance) in
        [(7.4e6, 256, 1.0), (1e7, 400, 1.0), (3e7, 200, 1.0), (2e7, 300, 0.02), (4e7, 64, 0.1)]
    {
        let eye = [-90.0, 5.0, altitude];
        let sun = [-90.0, 5.0];
        let scene = Scene { name: "far", eye, target: [-90.0, 5.0, 0.0], sun, fov_deg: 30.0 };
        let tolerance = ["--tolerance-px", &f64::to_string(&tolerance)].map(str::to_owned);
        let size = format!("{size}x{size}");
        snapshot_with(&scene, &size, &picture, &[("level", &level)], &tolerance);
        let levels = Array::read(&level).values;
        let drawn = image::open(&picture).unwrap().to_rgb8();
        let (mut on, mut flat, mut pale) = (0, 0, 0);
        for (pixel, level) in drawn.pixels().zip(levels) {
            let [red, green, blue] = pixel.0.map(f64::from);
            // The night and the limb are too dark to tell.
            if red + green + blue < 120.0 {
                continue;
            }
            on += 1;
            flat += usize::from(level.is_nan());
            // The hue of ground without a color, however lit.
            pale +=
                usize::from((red / blue - 1.24).abs() < 0.05 && (green / blue - 1.1).abs() < 0.04);
        }
        assert!(on > 200, "{altitude}: {on} pixels are lit");
        assert_eq!(flat, 0, "{altitude}: pixels without a height of {on}");
        assert!(pale * 20 <= on, "{altitude}: {pale} of {on} pixels have no color");
    }
}

/// A pixel may differ by 2 of 255, one in 500 by more: drivers round differently.
#[test]
fn pictures_look_as_they_did() {
    let folder = TempDir::new().unwrap();
    let golden = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/golden");
    for scene in &SCENES {
        let file = format!("{}.png", scene.name);
        let picture = folder.path().join(&file);
        snapshot(scene, "320x180", &picture, &[]);
        if std::env::var_os("UPDATE_GOLDEN").is_some() {
            std::fs::create_dir_all(&golden).unwrap();
            std::fs::copy(&picture, golden.join(&file)).unwrap();
            continue;
        }
        let [drawn, expected] =
            [picture, golden.join(&file)].map(|path| image::open(path).unwrap().to_rgb8());
        assert_eq!(drawn.dimensions(), expected.dimensions());
        let pairs = drawn.pixels().zip(expected.pixels());
        let far = pairs.filter(|(one, other)| {
            one.0.iter().zip(other.0).any(|(&one, other)| one.abs_diff(other) > 2)
        });
        let (far, all) = (far.count(), (drawn.width() * drawn.height()) as usize);
        assert!(far * 500 <= all, "{file}: {far} of {all} pixels differ");
    }
}

/// A server, ended with its owner.
struct Serving(std::process::Child);

impl Drop for Serving {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

#[test]
fn a_picture_of_a_server_is_that_of_its_folder() {
    use std::io::BufRead as _;

    let mut serving = areoid();
    serving.arg("serve").arg(&CATALOG.1).args(["--listen", "127.0.0.1:0", "--admin", "none"]);
    let mut serving = Serving(serving.stderr(std::process::Stdio::piped()).spawn().unwrap());
    let lines = std::io::BufReader::new(serving.0.stderr.take().unwrap()).lines();
    let mut said = lines.map(Result::unwrap);
    let url = said.find_map(|line| Some(line.strip_prefix("serving on ")?.to_owned())).unwrap();
    std::thread::spawn(move || said.for_each(drop));

    let folder = TempDir::new().unwrap();
    let path = |name: &str| folder.path().join(name);
    let shoot = |place: &std::ffi::OsStr, picture: &Path, options: &[&std::ffi::OsStr]| {
        let mut command = areoid();
        command.arg("snapshot").arg(place).arg("-o").arg(picture).args(options);
        draw(command.args(["--size", "320x180", "--eye=-138,7,900000", "--target=-133.8,17.6"]));
    };
    shoot(CATALOG.1.as_os_str(), &path("near.png"), &[]);
    let disk = path("disk");
    let kept = ["--disk-cache".as_ref(), disk.as_os_str()];
    for options in [&[][..], &kept, &kept] {
        shoot(url.as_ref(), &path("far.png"), options);
        let [near, far] = ["near.png", "far.png"].map(|name| std::fs::read(path(name)).unwrap());
        assert!(near == far, "with {options:?}");
    }
    assert!(disk.read_dir().unwrap().count() > 0);
}

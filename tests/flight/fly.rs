//! `areoid fly`: reports are complete, films are pictures of the same eyes, and nothing half done
//! stays.

use std::ffi::OsStr;
use std::fs;
use std::path::Path;
use std::process::{Command, Output};
use std::time::{Duration, Instant};

use serde_json::{Value, json};
use tempfile::TempDir;

use crate::{CATALOG, areoid, draw, run};

const EYES: [[f64; 3]; 3] =
    [[-90.0, 5.0, 7_400_000.0], [-120.0, 10.0, 900_000.0], [-133.0, 17.0, 60_000.0]];
const LOOKS: [[f64; 2]; 3] = [[0.0, -90.0], [-60.0, -50.0], [10.0, -25.0]];

/// A flight of two seconds in `folder`, with a key for each of its eyes.
fn flight(folder: &Path) -> std::path::PathBuf {
    let keys: Vec<Value> =
        (0..3).map(|key| json!({ "seconds": key, "eye": EYES[key], "look": LOOKS[key] })).collect();
    let path = folder.join("flight.json");
    fs::write(&path, json!({ "keys": keys }).to_string()).unwrap();
    path
}

fn fly(catalog: impl AsRef<OsStr>, path: &Path, options: &[&str]) -> Command {
    let mut command = areoid();
    command.arg("fly").arg(catalog).arg("--path").arg(path).args(["--size", "160x90"]);
    command.args(options);
    command
}

fn read(path: &Path) -> Value {
    serde_json::from_slice(&fs::read(path).unwrap()).unwrap()
}

/// The names of what is in a folder.
fn listing(folder: &Path) -> Vec<String> {
    let entries = fs::read_dir(folder).unwrap().map(Result::unwrap);
    let mut names: Vec<_> = entries.map(|entry| entry.file_name().into_string().unwrap()).collect();
    names.sort();
    names
}

#[test]
fn a_film_is_made_of_the_pictures_of_its_eyes_and_its_report_says_all() {
    let folder = TempDir::new().unwrap();
    let path = |name: &str| folder.path().join(name);
    let flight = flight(folder.path());
    let mut command = fly(&CATALOG.1, &flight, &["--frames", "3", "--pace", "complete", "--json"]);
    command.arg("--png").arg(path("film")).arg("--report").arg(path("report.json"));
    let output = draw(&mut command);

    let mut report = read(&path("report.json"));
    let frames = report.as_object_mut().unwrap().remove("frames").unwrap();
    assert_eq!(serde_json::from_slice::<Value>(&output.stdout).unwrap(), report);
    for time in ["update_ms", "render_ms", "gpu_ms", "frame_ms"] {
        let [median, p95, p99, max] =
            ["median", "p95", "p99", "max"].map(|of| report["summary"][time][of].as_f64().unwrap());
        assert!(0.0 < median && median <= p95 && p95 <= p99 && p99 <= max, "{time}: {report}");
    }
    let frames = frames.as_array().unwrap();
    let number = |frame: &Value, key: &str| {
        frame[key].as_f64().unwrap_or_else(|| panic!("{key} in {frame}"))
    };
    let mut seen = 0.0;
    for (place, frame) in frames.iter().enumerate() {
        let of = |key| number(frame, key);
        assert_eq!((of("frame"), of("seconds")), (place as f64, place as f64));
        let parts = of("update_ms") + of("render_ms") + of("gpu_ms");
        assert!((of("frame_ms") - parts).abs() < 1e-6, "{frame}");
        assert!(of("wanted") > 0.0 && of("missing") == 0.0 && of("failed") == 0.0, "{frame}");
        assert_eq!(of("resident"), of("wanted"));
        assert_eq!(of("needed"), of("resident") + of("missing"));
        assert_eq!((of("pending_pages"), of("left_out_pages"), of("late_ms")), (0.0, 0.0, 0.0));
        assert!(of("error_px") <= of("tolerance_px") && of("tolerance_px") == 1.0, "{frame}");
        assert!(of("patches") > 0.0 && of("triangles") > of("patches"), "{frame}");
        assert!(of("memory_bytes") > 0.0 && of("memory_bytes") <= of("budget_bytes"), "{frame}");
        assert!((of("uploaded_bytes") > 0.0) == (of("uploaded_pages") > 0.0), "{frame}");
        assert!((of("loaded_bytes") > 0.0) == (of("loaded_pages") > 0.0), "{frame}");
        seen += of("uploaded_pages");
    }
    assert_eq!(frames.len(), 3);
    assert_eq!(seen, number(&report["summary"], "uploaded_pages"));
    assert!(seen >= number(&frames[2], "wanted"), "{seen} pages were uploaded");

    let names = listing(&path("film"));
    assert_eq!(names, [0, 1, 2].map(|number| format!("frame-0000{number}.png")));
    let list = |numbers: &[f64]| numbers.iter().map(f64::to_string).collect::<Vec<_>>().join(",");
    for ((eye, look), name) in EYES.iter().zip(&LOOKS).zip(names) {
        let mut command = areoid();
        command.arg("snapshot").arg(&CATALOG.1).arg("-o").arg(path("picture.png"));
        command.arg(format!("--eye={}", list(eye))).arg(format!("--look={}", list(look)));
        draw(command.args(["--size", "160x90"]));
        let [film, picture] = [path("film").join(&name), path("picture.png")]
            .map(|path| image::open(path).unwrap().to_rgb8());
        assert_eq!(film.dimensions(), (160, 90));
        let lit = picture.pixels().filter(|pixel| pixel.0[0] > 40).count();
        assert!(lit > 2000, "{lit} pixels are lit");
        // Eyes on keys are rounded otherwise.
        let pairs = film.pixels().zip(picture.pixels());
        let differ = pairs.filter(|(one, other)| one != other).count();
        assert!(differ <= 10, "{name:?}: {differ} pixels differ");
    }
}

#[test]
fn real_time_is_kept_and_other_paces_do_not_wait_for_it() {
    let folder = TempDir::new().unwrap();
    let flight = flight(folder.path());
    let took = |pace: &str| {
        let options = ["--frames", "4", "--json", "--pace", pace];
        let output = fly(&CATALOG.1, &flight, &options).output().unwrap();
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        let said: Value = serde_json::from_slice(&output.stdout).unwrap();
        assert_eq!((said["pace"].as_str(), said["flight_s"].as_f64()), (Some(pace), Some(2.0)));
        said["summary"]["took_s"].as_f64().unwrap()
    };
    let [real, fast] = ["real", "fast"].map(took);
    assert!(real >= 2.0, "{real}");
    assert!(fast < real, "{fast}");
}

#[test]
fn what_cannot_be_flown_is_told_and_leaves_nothing() {
    let folder = TempDir::new().unwrap();
    let path = |name: &str| folder.path().join(name);
    let good = flight(folder.path());
    fs::write(path("empty.json"), r#"{"keys":[]}"#).unwrap();
    fs::write(path("torn.json"), r#"{"keys":[{"#).unwrap();
    let far = r#"{"keys":[{"seconds":0,"eye":[0,0,9],"look":[0,0]},{"seconds":1e300,"eye":[0,0,9],"look":[0,0]}]}"#;
    fs::write(path("long.json"), far).unwrap();
    fs::write(path("report.json"), "mine").unwrap();
    fs::create_dir(path("mine")).unwrap();
    fs::write(path("mine/notes.txt"), "mine").unwrap();
    let before = listing(folder.path());
    let catalog = CATALOG.1.as_os_str();
    let text = |name: &str| path(name).to_str().unwrap().to_owned();
    let [report, mine, film] = ["report.json", "mine", "film"].map(text);
    let server = OsStr::new("http://127.0.0.1:1");
    let absent = path("absent");
    let cases: [(&OsStr, &str, &[&str], i32, &str); 11] = [
        (catalog, "no.json", &[], 1, "cannot read the flight"),
        (catalog, "empty.json", &[], 1, "empty.json: a flight needs at least one key"),
        (catalog, "torn.json", &[], 1, "torn.json: no flight: EOF"),
        (catalog, "long.json", &[], 2, "with --frames"),
        (catalog, "flight.json", &["--frames", "0"], 2, "--frames"),
        (catalog, "flight.json", &["--tolerance-px", "0"], 2, "--tolerance-px"),
        (catalog, "flight.json", &["--exaggeration", "-1"], 2, "--exaggeration"),
        (catalog, "flight.json", &["--report", &report], 1, "--force"),
        (catalog, "flight.json", &["--png", &mine, "--force"], 1, "is no film"),
        (server, "flight.json", &["--png", &film], 1, "127.0.0.1:1"),
        (absent.as_os_str(), "flight.json", &["--png", &film], 1, "absent"),
    ];
    for (catalog, name, options, code, why) in cases {
        let Output { status, stdout, stderr } =
            fly(catalog, &path(name), options).output().unwrap();
        let said = String::from_utf8_lossy(&stderr);
        assert_eq!(status.code(), Some(code), "{name} {options:?}: {said}");
        assert!(said.contains(why), "{name} {options:?}: {said}");
        assert_eq!(stdout, b"");
        assert_eq!(listing(folder.path()), before);
    }
    assert_eq!(fs::read(path("report.json")).unwrap(), b"mine");

    // A film in its place is replaced if that is asked for, frames of the longer one too.
    let film = |options: &[&str]| fly(catalog, &good, &[&["--pace", "fast"], options].concat());
    draw(film(&["--frames", "3"]).arg("--png").arg(path("film")));
    let again = film(&["--frames", "2"]).arg("--png").arg(path("film")).output().unwrap();
    assert_eq!(again.status.code(), Some(1));
    assert_eq!(fs::read_dir(path("film")).unwrap().count(), 3);
    draw(film(&["--frames", "2", "--force"]).arg("--png").arg(path("film")));
    assert_eq!(fs::read_dir(path("film")).unwrap().count(), 2);
    assert_eq!(listing(folder.path()).len(), before.len() + 1);
}

#[cfg(unix)]
#[test]
fn an_interrupted_film_leaves_nothing() {
    let folder = TempDir::new().unwrap();
    let path = |name: &str| folder.path().join(name);
    let flight = flight(folder.path());
    let mut command = fly(&CATALOG.1, &flight, &["--frames", "100000", "--pace", "fast"]);
    command.arg("--png").arg(path("film")).arg("--report").arg(path("report.json"));
    let flying = command.stderr(std::process::Stdio::piped()).spawn().unwrap();
    let entries = || fs::read_dir(folder.path()).unwrap().count();
    let start = Instant::now();
    while entries() < 2 {
        assert!(start.elapsed() < Duration::from_secs(60), "no film was begun");
        std::thread::yield_now();
    }
    run(Command::new("kill").args(["-INT", &flying.id().to_string()]));
    let Output { status, stderr, .. } = flying.wait_with_output().unwrap();
    let said = String::from_utf8_lossy(&stderr);
    assert_eq!(status.code(), Some(1), "{said}");
    assert!(said.contains("interrupted at frame"), "{said}");
    assert_eq!(entries(), 1);
}

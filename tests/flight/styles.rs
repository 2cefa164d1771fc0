//! Styles, dates and air on the command line.

use std::fs;
use std::path::Path;
use std::process::{Command, Output};

use serde_json::Value;
use tempfile::TempDir;

use crate::{CATALOG, areoid, draw};

/// A snapshot of Olympus Mons with options, into `folder`.
fn snapshot(folder: &Path, options: &[&str]) -> Command {
    let mut command = areoid();
    command.arg("snapshot").arg(&CATALOG.1).arg("-o").arg(folder.join("picture.png"));
    command.args(["--eye=-133,18,900000", "--size", "96x64", "--json"]).args(options);
    command
}

fn said(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

#[test]
fn what_a_style_leaves_out_is_neither_drawn_nor_loaded() {
    let folder = TempDir::new().unwrap();
    let style = folder.path().join("style.json");
    let drawn = |text: &str| {
        fs::write(&style, text).unwrap();
        let output = draw(&mut snapshot(folder.path(), &["--style", style.to_str().unwrap()]));
        let report: Value = serde_json::from_slice(&output.stdout).unwrap();
        let picture = fs::read(folder.path().join("picture.png")).unwrap();
        (picture, report["pages"].as_u64().unwrap(), said(&output))
    };
    let (whole, pages, warned) = drawn("{}");
    assert!(!warned.contains("names"), "{warned}");
    let (bare, fewer, _) = drawn(r#"{"layers": [{"dataset": "viking_color", "weight": 0}]}"#);
    assert!(fewer < pages && bare != whole, "{fewer} of {pages} pages");
    let (same, as_many, warned) = drawn(r#"{"layers": [{"dataset": "nobody", "weight": 0}]}"#);
    assert!((same, as_many) == (whole.clone(), pages) && warned.contains("nobody"), "{warned}");
    let (colored, as_many, _) = drawn(
        r#"{"layers": [{"dataset": "mola_height_8ppd", "priority": 9,
            "ramp": {"stops": [{"height_m": 0, "color": [0, 0, 200]}]}}]}"#,
    );
    assert!(colored != whole && as_many == pages);
    let picture = image::load_from_memory(&colored).unwrap().to_rgb8();
    let is_blue = |pixel: &&image::Rgb<u8>| pixel.0[2] > 20 && pixel.0[0] < 10;
    assert!(picture.pixels().filter(is_blue).count() > 2000);
}

#[test]
fn what_is_no_style_date_or_light_is_told() {
    let folder = TempDir::new().unwrap();
    let torn = folder.path().join("torn.json");
    fs::write(&torn, "{").unwrap();
    let heavy = folder.path().join("heavy.json");
    fs::write(&heavy, r#"{"layers": [{"dataset": "viking_color", "weight": 2}]}"#).unwrap();
    let [torn, heavy] = [&torn, &heavy].map(|path| path.to_str().unwrap());
    let cases: [(&[&str], i32, &str); 11] = [
        (&["--style", torn], 1, "torn.json: no style: EOF"),
        (&["--style", heavy], 1, "heavy.json: layer \"viking_color\": the weight must lie"),
        (&["--style", "none.json"], 1, "cannot read the style none.json"),
        (&["--date", "2026-02-29"], 2, "expected a date in UTC"),
        (&["--exposure", "nan"], 2, "--exposure"),
        (&["--relief", "--sun", "1,1"], 2, "--relief"),
        (&["--relief=1"], 2, "--relief"),
        (&["--relief=0,91"], 2, "--relief"),
        (&["--target=-133,18,900000"], 2, "--target"),
        (&["--look", "0,91"], 2, "pitch"),
        (&["--aov", "height=h.npy", "--aov", "level=h.npy"], 2, "written twice"),
    ];
    for (options, code, why) in cases {
        let output = snapshot(folder.path(), options).output().unwrap();
        assert_eq!(output.status.code(), Some(code), "{options:?}: {}", said(&output));
        assert!(said(&output).contains(why), "{options:?}: {}", said(&output));
        assert!(!folder.path().join("picture.png").exists(), "{options:?}");
    }
}

/// At noon by its date the disc is light, and half a sol later dark.
#[test]
fn the_sun_is_where_it_was_on_a_date() {
    let folder = TempDir::new().unwrap();
    let brightness = |date: &str| -> u64 {
        draw(&mut snapshot(folder.path(), &["--date", date, "--atmosphere"]));
        let picture = image::open(folder.path().join("picture.png")).unwrap().into_luma8();
        picture.pixels().map(|pixel| u64::from(pixel.0[0])).sum()
    };
    // The sun stands over 174.7° west at 00:00; Olympus Mons has noon some 21 hours later.
    let (noon, midnight) = (brightness("2000-01-06T21:50"), brightness("2000-01-06T09:30"));
    // The night has 6 % of the light, and its codes a third.
    assert!(noon > 3 * midnight, "{noon} and {midnight}");
}

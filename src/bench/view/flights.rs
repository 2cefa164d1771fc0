//! Known flights, and what their authors published.

use std::fs;
use std::io;
use std::process::Command;

use serde_json::{Value, json};

use super::Setting;
use crate::bench::ingest::said;
use crate::bench::report::{Chapter, Table};
use crate::failure::Failure;

/// A flight that the repository carries.
struct Known {
    name: &'static str,
    json: &'static str,
    source: &'static str,
    /// Frames a second that its author published, with the text, if they are known here.
    published: Option<&'static str>,
}

const KNOWN: [Known; 4] = [
    Known {
        name: "planet",
        json: include_str!("../../../flights/white_planet.json"),
        source: "White 2011",
        published: None,
    },
    Known {
        name: "Olympus Mons",
        json: include_str!("../../../flights/white_olympus.json"),
        source: "White 2011",
        published: None,
    },
    Known {
        name: "equator at 100 m",
        json: include_str!("../../../flights/white_equator.json"),
        source: "White 2011",
        published: None,
    },
    Known {
        name: "descent and return",
        json: include_str!("../../../flights/kooima_descent.json"),
        source: "Kooima 2008",
        published: None,
    },
];

const HEAD: [&str; 14] = [
    "flight",
    "after",
    "published frames/s",
    "frames",
    "frames/s",
    "frame ms median",
    "p95",
    "p99",
    "max",
    "update ms p99",
    "render ms p99",
    "wanted median",
    "frames lacking pages",
    "error px p99",
];

pub(super) fn measure(setting: &Setting) -> Result<Chapter, Failure> {
    let catalog = match &setting.catalog {
        Some(catalog) => catalog.into(),
        None => setting.world.whole()?,
    };
    let folder = setting.world.work();
    fs::create_dir_all(&folder)?;
    let [width, height] = setting.size;
    let (mut rows, mut data) = (Vec::new(), Vec::new());
    for known in KNOWN {
        let path = folder.join("flight.json");
        fs::write(&path, known.json)?;
        let mut command = Command::new(std::env::current_exe()?);
        command.arg("fly").arg(&catalog).arg("--path").arg(&path).arg("--json");
        command.args(["--size", &format!("{width}x{height}")]);
        command.args(["--pace", &setting.pace.to_string()]);
        if let Some(frames) = setting.frames {
            command.args(["--frames", &frames.to_string()]);
        }
        let flown = said(&mut command).map_err(|error| {
            io::Error::new(error.kind(), format!("the flight {:?}: {error}", known.name))
        })?;
        let summary = &flown["summary"];
        let published = known.published.unwrap_or("–").to_owned();
        rows.push(row(&known, published, summary));
        data.push(json!({
            "flight": known.name, "after": known.source, "published": known.published,
            "flight_s": flown["flight_s"], "summary": summary,
        }));
    }
    let over = match &setting.catalog {
        Some(catalog) => format!("Flown over `{catalog}`."),
        None => "Flown over a made-up planet: see `--catalog`.".to_owned(),
    };
    Ok(Chapter {
        name: "flights",
        title: "Known flights",
        notes: vec![
            setting.drawn_with(),
            over,
            format!(
                "Flown by `areoid fly --pace {}`. Frames a second are frames over the time spent on \
                 them, waiting for their turn left out. *Frames lacking pages* were drawn with \
                 coarser ones, which the error counts. The scenes are those that the texts name, on \
                 other data and other machines; the frame rates that the texts publish were not at \
                 hand, hence the dashes.",
                setting.pace
            ),
        ],
        tables: vec![Table { title: "Frame by frame".to_owned(), head: HEAD.to_vec(), rows }],
        targets: Vec::new(),
        data: json!(data),
    })
}

fn row(known: &Known, published: String, summary: &Value) -> Vec<String> {
    let figure = |name: &str, of: &str, digits: usize| {
        let figure = summary[name][of].as_f64();
        figure.map_or_else(|| "none".to_owned(), |figure| format!("{figure:.digits$}"))
    };
    let mut row = vec![known.name.to_owned(), known.source.to_owned(), published];
    row.push(summary["frames"].to_string());
    row.push(format!("{:.1}", summary["frames_per_s"].as_f64().unwrap_or(f64::NAN)));
    row.extend(["median", "p95", "p99", "max"].map(|of| figure("frame_ms", of, 1)));
    row.push(figure("update_ms", "p99", 2));
    row.push(figure("render_ms", "p99", 2));
    row.push(figure("wanted", "median", 0));
    row.push(summary["missing_frames"].to_string());
    row.push(figure("error_px", "p99", 2));
    row
}

#[cfg(test)]
mod tests {
    use super::*;
    use areoid_cache::flight::Flight;

    #[test]
    fn the_flights_that_come_along_are_flights() {
        for known in KNOWN {
            let flight = Flight::from_json(known.json).unwrap();
            assert!(flight.seconds() >= 20.0, "{}", known.name);
        }
        let descent = Flight::from_json(KNOWN[3].json).unwrap();
        assert_eq!(descent.seconds() * 30.0, 4800.0);
    }
}

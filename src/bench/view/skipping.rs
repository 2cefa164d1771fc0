//! What a picture is made of, beside what of it shows: pages, patches, fragments, bytes.

use std::path::Path;
use std::thread;
use std::time::Duration;

use areoid_viewer::Usage;
use serde_json::{Value, json};

use super::Setting;
use super::stage::{OVER, Spot, Stage};
use super::world::{cache, datasets};
use crate::bench::report::{Chapter, Relation, Table, Target};
use crate::failure::Failure;

const PLENTY: usize = 2 << 30;

/// Fragments composed over fragments seen, with the points of the mesh.
const LIMIT: f64 = 1.5;

/// Frames until all is there, and how long it is waited between them.
const MOST_LATER: u32 = 5;
const PAUSE: Duration = Duration::from_millis(100);

/// From afar, straight down, toward the horizon, from low above the ground, and over a pole.
const SPOTS: [(&str, Spot); 5] = [
    ("disc", Spot { position: [20.0, 10.0], altitude_m: 9e6, look: [0.0, -90.0] }),
    ("down", OVER),
    ("oblique", Spot { position: [20.0, 10.0], altitude_m: 1e5, look: [60.0, -25.0] }),
    ("low", Spot { position: [20.0, 10.0], altitude_m: 1.5e4, look: [60.0, -8.0] }),
    ("pole", Spot { position: [20.0, 90.0], altitude_m: 1e6, look: [0.0, -60.0] }),
];

struct Line {
    name: String,
    usage: Usage,
    uploaded_bytes: u64,
    /// Bytes written for a second frame of the same view, and whether it was drawn.
    again: (u64, bool),
}

pub(super) fn measure(setting: &Setting) -> Result<Chapter, Failure> {
    let mut lines = Vec::new();
    for (catalog, of) in [(setting.world.whole()?, "one grid"), (setting.world.split()?, "split")] {
        for (name, spot) in SPOTS {
            lines.push(measured(setting, &catalog, format!("{name}, {of}"), spot)?);
        }
    }
    let fragments = lines.iter().map(|line| line.fragments()).fold(0.0, f64::max);
    let at_rest = lines.iter().map(|line| line.again.0 as f64 + f64::from(u8::from(line.again.1)));
    let at_rest = at_rest.fold(0.0, f64::max);
    Ok(Chapter {
        name: "skipping",
        title: "What a frame does beyond what shows",
        notes: vec![
            setting.drawn_with(),
            "Of each figure: what the frame had, over what some pixel of it shows. A pixel is \
             composed once, after the triangles are drawn; points are those of the mesh, composed \
             once each before. A page counts as shown if the height or the color of some pixel is \
             made of it. Uploads are those until the view is at rest; roots, which stand in for \
             pages that there is no room or time for, are among them."
                .to_owned(),
        ],
        tables: vec![table(&lines)],
        targets: vec![
            Target::new(
                "fragments and points composed over fragments seen, the worst",
                Relation::AtMost,
                LIMIT,
                Some(fragments),
            ),
            Target::new(
                "bytes uploaded and pictures drawn for a view at rest",
                Relation::AtMost,
                0.0,
                Some(at_rest),
            ),
        ],
        data: json!(lines.iter().map(Line::json).collect::<Vec<_>>()),
    })
}

fn measured(setting: &Setting, catalog: &Path, name: String, spot: Spot) -> Result<Line, Failure> {
    let cache = cache(datasets(catalog, 1)?, PLENTY)?;
    let mut stage = Stage::new(&setting.gpu, cache, setting.size, spot);
    let mut uploaded_bytes = stage.first().uploaded_bytes;
    // Roots that stand in for nothing may come a little later.
    for _ in 0..MOST_LATER {
        let frame = stage.frame(0);
        uploaded_bytes += frame.uploaded_bytes;
        thread::sleep(PAUSE);
    }
    let again = stage.frame(0);
    Ok(Line {
        name,
        usage: stage.usage(),
        uploaded_bytes,
        again: (again.uploaded_bytes, again.is_drawn),
    })
}

impl Line {
    fn fragments(&self) -> f64 {
        let seen = self.usage.visible_pixels;
        (seen + self.usage.composed_points) as f64 / seen.max(1) as f64
    }

    fn json(&self) -> Value {
        let usage = &self.usage;
        json!({
            "name": self.name, "pages": usage.pages, "pages_seen": usage.pages_seen,
            "patches": usage.patches, "patches_seen": usage.patches_seen,
            "pixels": usage.visible_pixels, "points": usage.composed_points,
            "bytes_uploaded": self.uploaded_bytes, "bytes_seen": usage.bytes_seen,
            "again_bytes": self.again.0, "again_drawn": self.again.1,
        })
    }
}

fn table(lines: &[Line]) -> Table {
    let over = |all: usize, seen: usize| format!("{all} / {seen}");
    let megabytes = |bytes: u64| format!("{:.2}", bytes as f64 / 1e6);
    let rows = lines.iter().map(|line| {
        let usage = &line.usage;
        vec![
            line.name.clone(),
            over(usage.pages, usage.pages_seen),
            over(usage.patches, usage.patches_seen),
            usage.visible_pixels.to_string(),
            usage.composed_points.to_string(),
            format!("{:.2}", line.fragments()),
            format!("{} / {}", megabytes(line.uploaded_bytes), megabytes(usage.bytes_seen)),
        ]
    });
    let head =
        vec!["", "pages", "patches", "fragments", "points", "composed over seen", "MB uploaded"];
    Table { title: "Had over seen".to_owned(), head, rows: rows.collect() }
}

//! What was measured, as JSON and as tables.

use std::fmt::Write as _;
use std::fs;
use std::io;
use std::path::Path;
use std::time::{SystemTime, UNIX_EPOCH};

use serde::Serialize;
use serde_json::{Value, json};

use super::peers::Peers;
use crate::failure::Failure;
use crate::output;
pub(super) use crate::quantile::quantile;

/// Least, median and greatest.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub(super) struct Spread {
    pub(super) median: f64,
    pub(super) min: f64,
    pub(super) max: f64,
}

impl Spread {
    /// `None` of nothing.
    pub(super) fn of(figures: impl Iterator<Item = f64>) -> Option<Self> {
        let mut sorted: Vec<f64> = figures.collect();
        sorted.sort_by(f64::total_cmp);
        let (&min, &max) = (sorted.first()?, sorted.last()?);
        Some(Self { median: quantile(&sorted, 0.5), min, max })
    }

    /// `median (min–max)`.
    pub(super) fn text(&self, digits: usize) -> String {
        let Self { median, min, max } = self;
        format!("{median:.digits$} ({min:.digits$}–{max:.digits$})")
    }
}

/// Which side of its limit a figure should be on.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum Relation {
    AtMost,
    AtLeast,
}

/// What should be reached.
#[derive(Clone, Debug, Serialize)]
pub(super) struct Target {
    pub(super) what: String,
    pub(super) relation: Relation,
    pub(super) limit: f64,
    /// `None` if a peer was absent.
    pub(super) measured: Option<f64>,
    pub(super) met: Option<bool>,
}

impl Target {
    pub(super) fn new(
        what: impl Into<String>,
        relation: Relation,
        limit: f64,
        measured: Option<f64>,
    ) -> Self {
        let met = measured.map(|measured| match relation {
            Relation::AtMost => measured <= limit,
            Relation::AtLeast => measured >= limit,
        });
        Self { what: what.into(), relation, limit, measured, met }
    }
}

/// Rows of text under a head.
#[derive(Clone, Debug)]
pub(super) struct Table {
    pub(super) title: String,
    pub(super) head: Vec<&'static str>,
    pub(super) rows: Vec<Vec<String>>,
}

/// A chapter of the book.
#[derive(Clone, Debug)]
pub(super) struct Chapter {
    pub(super) name: &'static str,
    pub(super) title: &'static str,
    /// How it was measured, a paragraph each.
    pub(super) notes: Vec<String>,
    pub(super) tables: Vec<Table>,
    pub(super) targets: Vec<Target>,
    /// All figures.
    pub(super) data: Value,
}

/// All of it.
pub(super) struct Report {
    pub(super) title: &'static str,
    pub(super) options: Value,
    pub(super) peers: Peers,
    pub(super) chapters: Vec<Chapter>,
}

impl Report {
    /// Writes it into `folder` as `name.json` and `name.md`, and prints one of them.
    pub(super) fn hand_out(&self, folder: &Path, name: &str, as_json: bool) -> Result<(), Failure> {
        let document = self.json();
        let bytes = serde_json::to_vec_pretty(&document).map_err(io::Error::from)?;
        output::write_file(&folder.join(format!("{name}.json")), &bytes)?;
        let tables = self.markdown();
        output::write_file(&folder.join(format!("{name}.md")), tables.as_bytes())?;
        if as_json { output::json(&document) } else { output::line(tables) }
    }

    pub(super) fn json(&self) -> Value {
        let targets: Vec<&Target> =
            self.chapters.iter().flat_map(|chapter| &chapter.targets).collect();
        let chapters: serde_json::Map<String, Value> = self
            .chapters
            .iter()
            .map(|chapter| (chapter.name.to_owned(), chapter.data.clone()))
            .collect();
        json!({
            "version": env!("CARGO_PKG_VERSION"),
            "machine": { "cpu": cpu(), "cores": cores(), "date": today() },
            "options": self.options,
            "peers": self.peers.json(),
            "targets": targets,
            "chapters": chapters,
        })
    }

    pub(super) fn markdown(&self) -> String {
        let mut text =
            format!("# {}\n\n{}, {} cores, {}.\n\n", self.title, cpu(), cores(), today());
        text.push_str(&self.peers.sentences());
        text.push_str("\n## Targets\n\n");
        let targets = self.chapters.iter().flat_map(|chapter| &chapter.targets);
        let rows = targets.map(|target| {
            let relation = match target.relation {
                Relation::AtMost => "at most",
                Relation::AtLeast => "at least",
            };
            let verdict = match target.met {
                Some(true) => "met",
                Some(false) => "**not met**",
                None => "not measured",
            };
            vec![
                target.what.clone(),
                format!("{relation} {}", rounded(target.limit)),
                target.measured.map_or_else(|| "–".to_owned(), rounded),
                verdict.to_owned(),
            ]
        });
        let head = vec!["target", "limit", "measured", ""];
        push_table(&mut text, &head, &rows.collect::<Vec<_>>());
        for chapter in &self.chapters {
            write!(text, "\n## {}\n", chapter.title).expect("a string takes everything");
            for note in &chapter.notes {
                write!(text, "\n{note}\n").expect("a string takes everything");
            }
            for table in &chapter.tables {
                write!(text, "\n### {}\n\n", table.title).expect("a string takes everything");
                push_table(&mut text, &table.head, &table.rows);
            }
        }
        text
    }
}

/// Three digits that mean something.
pub(super) fn rounded(figure: f64) -> String {
    let digits = match figure.abs() {
        large if large >= 100.0 => 0,
        small if small > 0.0 && small < 0.1 => 4,
        _ => 2,
    };
    format!("{figure:.digits$}")
}

/// A table whose columns stand under one another in plain text, too.
fn push_table(text: &mut String, head: &[&str], rows: &[Vec<String>]) {
    let width = |column: usize| {
        let cells = rows.iter().filter_map(|row| row.get(column)).map(|cell| cell.chars().count());
        cells.chain([head[column].chars().count(), 3]).max().unwrap_or(0)
    };
    let widths: Vec<usize> = (0..head.len()).map(width).collect();
    let line = |cells: &mut dyn Iterator<Item = &str>| {
        let padded = cells.zip(&widths).map(|(cell, &width)| format!(" {cell:width$} |"));
        format!("|{}\n", padded.collect::<String>())
    };
    text.push_str(&line(&mut head.iter().copied()));
    let rule: String = widths.iter().map(|width| format!("{}|", "-".repeat(width + 2))).collect();
    text.push_str(&format!("|{rule}\n"));
    for row in rows {
        text.push_str(&line(&mut row.iter().map(String::as_str)));
    }
}

/// Processors that this program may use.
pub(super) fn cores() -> usize {
    std::thread::available_parallelism().map_or(1, usize::from)
}

fn cpu() -> String {
    let info = fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
    let model = info.lines().find_map(|line| line.strip_prefix("model name")?.split_once(':'));
    model.map_or("an unknown processor", |(_, model)| model.trim()).to_owned()
}

/// The day, in UTC.
fn today() -> String {
    let since = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    date(since.as_secs() / 86_400)
}

/// A day counted from 1970-01-01, as year, month and day.
///
/// # References
///
/// * Howard Hinnant, *chrono-compatible low-level date algorithms*, `civil_from_days`: years begin
///   in March, eras have 400 of them.
fn date(days: u64) -> String {
    let days = days + 719_468;
    let (era, day_of_era) = (days / 146_097, days % 146_097);
    let year_of_era =
        (day_of_era - day_of_era / 1460 + day_of_era / 36_524 - day_of_era / 146_096) / 365;
    let day_of_year = day_of_era - (365 * year_of_era + year_of_era / 4 - year_of_era / 100);
    let from_march = (5 * day_of_year + 2) / 153;
    let day = day_of_year - (153 * from_march + 2) / 5 + 1;
    let month = if from_march < 10 { from_march + 3 } else { from_march - 9 };
    let year = 400 * era + year_of_era + u64::from(month <= 2);
    format!("{year:04}-{month:02}-{day:02}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn days_have_their_dates() {
        assert_eq!(date(0), "1970-01-01");
        assert_eq!(date(11_016), "2000-02-29");
        assert_eq!(date(20_454), "2026-01-01");
    }

    #[test]
    fn a_target_without_a_figure_is_neither_met_nor_missed() {
        assert_eq!(Target::new("", Relation::AtMost, 1.0, None).met, None);
        assert_eq!(Target::new("", Relation::AtMost, 1.0, Some(1.0)).met, Some(true));
        assert_eq!(Target::new("", Relation::AtLeast, 1.0, Some(0.9)).met, Some(false));
    }
}

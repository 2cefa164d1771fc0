//! How much farther from the finest data a page says it may be than it is.
//!
//! The exact errors are those of the verification, which finds them anew from the stored texels. A
//! loose bound costs whoever draws pages that need not be there.

use std::path::{Path, PathBuf};

use areoid_formats::address::Level;
use areoid_preprocess::verify::{PageError, verify};
use serde_json::{Value, json};

use super::ingest::{Setting, stem};
use super::rasters::{Look, Recipe};
use super::report::{Chapter, Relation, Table, Target, quantile};
use crate::failure::Failure;
use crate::output;

/// Megapixels at full size: finding exact errors takes a hundred times as long as an ingest.
const FULL_MEGAPIXELS: f64 = 33.554_432;

/// How tight bounds should be.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Goal {
    /// The median of a level at most 1.7, on what a planet looks like.
    Planet,
    /// The median at most 1.3, and 0.4 more for each halving after the first.
    Fractal,
    /// Told, not judged.
    Told,
}

/// The terrain, whole and with holes.
pub(super) fn recipes(setting: &Setting) -> Vec<Recipe> {
    let map = setting.map(FULL_MEGAPIXELS);
    [Look::Height, Look::Holes].map(|look| Recipe::tiled(look, map)).to_vec()
}

/// Measures.
pub(super) fn measure(setting: &Setting) -> Result<Chapter, Failure> {
    let mut subjects: Vec<(PathBuf, Goal)> =
        setting.given.iter().map(|path| (path.clone(), Goal::Planet)).collect();
    for recipe in recipes(setting) {
        let goal = if recipe.look == Look::Height { Goal::Fractal } else { Goal::Told };
        subjects.push((recipe.make(&setting.rasters())?, goal));
    }
    let mut chapter = Chapter {
        name: "tightness",
        title: "Bounds over exact errors",
        notes: vec![
            "Of the pages of each level: the bound over the exact greatest distance from the \
             finest level, which the verification recomputes. Pages that are exact and say so \
             count as 1; ∞ is a page that is exact and does not know it. Beside holes a bound \
             covers more than law 1 speaks of: those rasters are told and not judged."
                .to_owned(),
        ],
        tables: Vec::new(),
        targets: Vec::new(),
        data: json!([]),
    };
    let mut data = Vec::new();
    for (path, goal) in subjects {
        output::say(format!("verifying {}", stem(&path)));
        data.push(subject(setting, &path, goal, &mut chapter)?);
    }
    chapter.data = json!(data);
    Ok(chapter)
}

/// One raster; its table and targets go to the chapter.
fn subject(
    setting: &Setting,
    path: &Path,
    goal: Goal,
    chapter: &mut Chapter,
) -> Result<Value, Failure> {
    let name = stem(path);
    let (_, archive) = setting.ingested(path)?;
    let has_holes = archive.entries()?.iter().any(|entry| !entry.full);
    let goal = if has_holes { Goal::Told } else { goal };
    let report = verify(&archive, None)?;
    let pyramid = archive.description().grid.pyramid();

    let mut rows = Vec::new();
    let mut levels = Vec::new();
    let mut least = f64::INFINITY;
    for level in pyramid.levels().filter(|&level| level != pyramid.finest()).rev() {
        let ratios = ratios(&report.pages, level);
        if ratios.is_empty() {
            continue;
        }
        let halvings = pyramid.halvings(level);
        let median = quantile(&ratios, 0.5);
        let [low, high] = [0.1, 0.9].map(|share| quantile(&ratios, share));
        let (min, max) = (ratios[0], ratios[ratios.len() - 1]);
        least = least.min(min);
        let cells = [median, low, high, min, max].map(cell);
        rows.push([vec![halvings.to_string(), ratios.len().to_string()], cells.to_vec()].concat());
        levels.push(json!({
            "level": level.0, "halvings": halvings, "pages": ratios.len(), "median": median,
            "tenth": low, "ninetieth": high, "min": min, "max": max,
            "infinite": ratios.iter().filter(|ratio| ratio.is_infinite()).count(),
        }));
        let limit = match goal {
            Goal::Planet => 1.7,
            Goal::Fractal => 1.3 + 0.4 * f64::from(halvings - 1),
            Goal::Told => continue,
        };
        let what = format!("{name}: median bound ÷ exact, {halvings} halvings");
        chapter.targets.push(Target::new(what, Relation::AtMost, limit, Some(median)));
    }
    let what = format!("{name}: least bound ÷ exact");
    let least = least.is_finite().then_some(least);
    chapter.targets.push(Target::new(what, Relation::AtLeast, 1.0, least));
    let head = vec!["halvings", "pages", "median", "10 %", "90 %", "least", "greatest"];
    let title = if has_holes { format!("{name}, with holes") } else { name.clone() };
    chapter.tables.push(Table { title, head, rows });
    Ok(json!({
        "raster": name,
        "has_holes": has_holes,
        "problems": report.problems,
        "levels": levels,
    }))
}

/// Bound over exact error of the pages of a level, sorted.
fn ratios(pages: &[PageError], level: Level) -> Vec<f64> {
    let mut ratios: Vec<f64> = pages
        .iter()
        .filter(|error| error.page.level == level)
        .map(|error| match (error.bound, error.exact) {
            (0.0, 0.0) => 1.0,
            (bound, exact) => bound / exact,
        })
        .collect();
    ratios.sort_by(f64::total_cmp);
    ratios
}

fn cell(ratio: f64) -> String {
    if ratio.is_infinite() { "∞".to_owned() } else { format!("{ratio:.3}") }
}

#[cfg(test)]
mod tests {
    use super::*;
    use areoid_formats::address::PageAddress;

    #[test]
    fn an_exact_page_that_says_so_is_tight_and_one_that_does_not_is_infinitely_loose() {
        let error = |level, bound, exact| PageError {
            page: PageAddress::new(Level(level), 0, 0),
            bound,
            exact,
        };
        let pages = [error(0, 3.0, 2.0), error(1, 1.0, 0.0), error(0, 0.0, 0.0)];
        assert_eq!(ratios(&pages, Level(0)), [1.0, 1.5]);
        assert_eq!(ratios(&pages, Level(1)), [f64::INFINITY]);
    }
}

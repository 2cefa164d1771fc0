//! How datasets take part in a picture: the user's word, beside what the catalog says.
//!
//! ```json
//! { "layers": [ { "dataset": "themis", "role": "luminance", "weight": 0.8 },
//!               { "dataset": "ice-1999", "series": 1, "weight": 0.3 },
//!               { "dataset": "ice-2020", "series": 1, "weight": 0.7 } ],
//!   "ramp": { "stops": [ { "height_m": -8000, "color": [20, 30, 90] },
//!                        { "height_m": 21000, "color": [255, 250, 240] } ] } }
//! ```

use serde::{Deserialize, Serialize};

use areoid_cache::Datasets;
use areoid_formats::page::Kind;

/// What a dataset of colors is taken for.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Role {
    /// For colors.
    #[default]
    Color,
    /// For the luminance of the colors that the others make: a sharp panchromatic image over a
    /// coarse one in color.
    Luminance,
}

/// How one dataset, or all parts of a group, takes part.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Layer {
    /// Its name, or that of its group.
    pub dataset: String,
    /// The weight u in its priority, and its opacity over lower ones, 0 to 1; 0 leaves it out.
    #[serde(default = "whole")]
    pub weight: f64,
    /// Instead of the dataset's own priority.
    #[serde(default)]
    pub priority: Option<i32>,
    /// Layers of one priority and one series are states of one thing, such as two dates of it: weights
    /// that add up to 1 show nothing beneath. 0 stands alone.
    #[serde(default)]
    pub series: u32,
    /// Of colors.
    #[serde(default)]
    pub role: Role,
}

fn whole() -> f64 {
    1.0
}

impl Layer {
    /// A dataset as it is when nothing is said about it.
    #[must_use]
    pub fn of(dataset: &str) -> Self {
        let dataset = dataset.to_owned();
        Self { dataset, weight: whole(), priority: None, series: 0, role: Role::Color }
    }

    /// How closely this layer names a dataset: a name beats a group's.
    fn closeness(&self, dataset: &str) -> Option<usize> {
        let rest = dataset.strip_prefix(self.dataset.as_str())?;
        (rest.is_empty() || rest.starts_with('.')).then_some(self.dataset.len())
    }
}

/// A color for each height: sRGB, straight between the stops, and that of the nearest beyond them.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Ramp {
    /// From the lowest up, 1 to [`Ramp::MOST_STOPS`].
    pub stops: Vec<Stop>,
    /// 0 to 1, over the datasets' colors.
    #[serde(default = "whole")]
    pub opacity: f64,
}

/// A height and its color.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Stop {
    /// Composed meters above the reference surface.
    pub height_m: f32,
    /// sRGB codes.
    pub color: [u8; 3],
}

impl Ramp {
    /// Stops that a ramp has at most.
    pub const MOST_STOPS: usize = 16;

    /// sRGB codes at a height.
    #[must_use]
    pub fn color(&self, height_m: f64) -> [f64; 3] {
        let codes = |stop: &Stop| stop.color.map(f64::from);
        let above = self.stops.partition_point(|stop| f64::from(stop.height_m) <= height_m);
        let (Some(below), above) = (above.checked_sub(1), self.stops.get(above)) else {
            return self.stops.first().map_or([0.0; 3], codes);
        };
        let below = &self.stops[below];
        let Some(above) = above else { return codes(below) };
        let [low, high] = [below, above].map(|stop| f64::from(stop.height_m));
        let t = (height_m - low) / (high - low);
        let (from, to) = (codes(below), codes(above));
        std::array::from_fn(|i| from[i] + (to[i] - from[i]) * t)
    }
}

/// How a picture is composed.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Style {
    /// Of the datasets that are not shown as they are.
    #[serde(default)]
    pub layers: Vec<Layer>,
    /// Colors by height.
    #[serde(default)]
    pub ramp: Option<Ramp>,
}

/// Why a text is no style.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum StyleError {
    /// It is not the JSON of one.
    #[error("no style")]
    Json(#[from] serde_json::Error),
    /// A number out of range.
    #[error("layer {dataset:?}: the weight must lie between 0 and 1, found {found}")]
    Weight {
        /// The layer's name.
        dataset: String,
        /// Its weight.
        found: f64,
    },
    /// A ramp that is none.
    #[error("the ramp {reason}")]
    Ramp {
        /// What is wrong with it.
        reason: &'static str,
    },
}

impl Style {
    /// Reads the JSON above.
    ///
    /// # Errors
    ///
    /// Any [`StyleError`].
    pub fn from_json(text: &str) -> Result<Self, StyleError> {
        let style: Self = serde_json::from_str(text)?;
        let unit = 0.0..=1.0;
        if let Some(layer) = style.layers.iter().find(|layer| !unit.contains(&layer.weight)) {
            let (dataset, found) = (layer.dataset.clone(), layer.weight);
            return Err(StyleError::Weight { dataset, found });
        }
        if let Some(ramp) = &style.ramp {
            let bad = |reason| Err(StyleError::Ramp { reason });
            if ramp.stops.is_empty() || ramp.stops.len() > Ramp::MOST_STOPS {
                return bad("must have 1 to 16 stops");
            }
            if !ramp.stops.is_sorted_by(|one, next| one.height_m < next.height_m) {
                return bad("must have its stops from the lowest up");
            }
            if !unit.contains(&ramp.opacity) {
                return bad("must have an opacity between 0 and 1");
            }
        }
        Ok(style)
    }

    /// What is said of a dataset; the last of equally close names counts.
    #[must_use]
    pub fn layer(&self, dataset: &str) -> Option<&Layer> {
        let named = |layer: &&Layer| layer.closeness(dataset).is_some();
        self.layers.iter().filter(named).max_by_key(|layer| layer.closeness(dataset))
    }

    /// The names that mean none of some datasets.
    pub fn unknown(&self, datasets: &Datasets) -> impl Iterator<Item = &str> {
        let is_known =
            |layer: &&Layer| datasets.iter().any(|(_, info)| layer.closeness(&info.name).is_some());
        self.layers.iter().filter(move |layer| !is_known(layer)).map(|layer| layer.dataset.as_str())
    }

    /// Whether a dataset has no weight: nothing of it has to be loaded.
    #[must_use]
    pub fn hides(&self, dataset: &str) -> bool {
        self.layer(dataset).is_some_and(|layer| layer.weight == 0.0)
    }

    /// How a dataset of a name, a kind and a priority of its own takes part.
    pub(crate) fn part(&self, dataset: &str, kind: Kind, priority: i32) -> Part {
        let Some(layer) = self.layer(dataset) else {
            return Part { plane: Plane::of(kind, Role::Color), priority, series: 0, weight: 1.0 };
        };
        Part {
            plane: Plane::of(kind, layer.role),
            priority: layer.priority.unwrap_or(priority),
            series: layer.series,
            weight: layer.weight,
        }
    }
}

/// What is composed for itself. Their numbers are those of `shader/compose.wgsl`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Plane {
    Heights,
    Colors,
    Luminances,
    Normals,
}

impl Plane {
    pub(crate) const ALL: [Self; 4] =
        [Self::Heights, Self::Colors, Self::Luminances, Self::Normals];

    fn of(kind: Kind, role: Role) -> Self {
        match (kind, role) {
            (Kind::Height, _) => Self::Heights,
            (Kind::Normal, _) => Self::Normals,
            (Kind::Color, Role::Color) => Self::Colors,
            (Kind::Color, Role::Luminance) => Self::Luminances,
        }
    }
}

/// A dataset's part in a picture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Part {
    pub(crate) plane: Plane,
    pub(crate) priority: i32,
    pub(crate) series: u32,
    pub(crate) weight: f64,
}

/// `color` with the luminance of `other`, both sRGB codes from 0 to 1.
///
/// # References
///
/// W3C, Compositing and Blending Level 1, §10.2: the blend mode "luminosity", `SetLum` and
/// `ClipColor`.
#[must_use]
pub fn with_luminance_of(color: [f64; 3], other: [f64; 3]) -> [f64; 3] {
    let luminance = |c: [f64; 3]| 0.3 * c[0] + 0.59 * c[1] + 0.11 * c[2];
    let wanted = luminance(other);
    let raised = color.map(|channel| channel + wanted - luminance(color));
    let least = raised.into_iter().fold(f64::INFINITY, f64::min);
    let most = raised.into_iter().fold(f64::NEG_INFINITY, f64::max);
    let mut factor = 1.0;
    if least < 0.0 {
        factor = wanted / (wanted - least);
    }
    if most > 1.0 {
        factor = f64::min(factor, (1.0 - wanted) / (most - wanted));
    }
    raised.map(|channel| wanted + (channel - wanted) * factor)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn a_name_beats_its_groups_and_the_last_word_counts() {
        let weight = |dataset: &str, weight| Layer { weight, ..Layer::of(dataset) };
        let layers = vec![weight("mola.north", 0.2), weight("mola", 0.3), weight("mola", 0.4)];
        let style = Style { layers, ramp: None };
        let found = |name| style.layer(name).map(|layer| layer.weight);
        assert_eq!(found("mola.north"), Some(0.2));
        assert_eq!((found("mola.south"), found("mola")), (Some(0.4), Some(0.4)));
        assert_eq!((found("molar"), found("mol")), (None, None));
    }

    #[test]
    fn a_style_comes_back_from_its_json() {
        let stops = vec![Stop { height_m: -1.5, color: [1, 2, 3] }];
        let layer = Layer { series: 2, role: Role::Luminance, ..Layer::of("a") };
        let style = Style { layers: vec![layer], ramp: Some(Ramp { stops, opacity: 0.5 }) };
        assert_eq!(Style::from_json(&serde_json::to_string(&style).unwrap()).unwrap(), style);
        assert_eq!(Style::from_json("{}").unwrap(), Style::default());
    }

    #[test]
    fn what_is_no_style_is_told() {
        for (text, told) in [
            ("[", "no style"),
            (r#"{"layers": [{"dataset": "a", "weight": 1.5}]}"#, "between 0 and 1, found 1.5"),
            (r#"{"ramp": {"stops": []}}"#, "1 to 16 stops"),
            (
                r#"{"ramp": {"stops": [{"height_m": 1, "color": [0,0,0]}, {"height_m": 1, "color": [0,0,0]}]}}"#,
                "from the lowest up",
            ),
            (
                r#"{"ramp": {"stops": [{"height_m": 1, "color": [0,0,0]}], "opacity": -1}}"#,
                "opacity",
            ),
            (r#"{"ramp": {"stops": [{"height_m": 1e39, "color": [0,0,0]}]}}"#, "no style"),
            (r#"{"ramp": {"stops": [{"height_m": 0, "color": [0,0,256]}]}}"#, "no style"),
        ] {
            let error = Style::from_json(text).unwrap_err().to_string();
            assert!(error.contains(told), "{text}: {error}");
        }
    }

    #[test]
    fn a_ramp_is_straight_between_its_stops_and_level_beyond() {
        let stop = |height_m, code| Stop { height_m, color: [code; 3] };
        let ramp = Ramp { stops: vec![stop(0.0, 10), stop(10.0, 20), stop(11.0, 0)], opacity: 1.0 };
        for (height_m, code) in [(-5.0, 10.0), (0.0, 10.0), (2.5, 12.5), (10.5, 10.0), (99.0, 0.0)]
        {
            assert_eq!(ramp.color(height_m), [code; 3], "{height_m}");
        }
    }

    proptest! {
        #[test]
        fn luminance_is_taken_and_nothing_leaves_the_cube(
            color in prop::array::uniform3(0.0..1.0_f64), other in prop::array::uniform3(0.0..1.0_f64),
        ) {
            let luminance = |c: [f64; 3]| 0.3 * c[0] + 0.59 * c[1] + 0.11 * c[2];
            let mixed = with_luminance_of(color, other);
            prop_assert!((luminance(mixed) - luminance(other)).abs() < 1e-12);
            prop_assert!(mixed.iter().all(|channel| (-1e-12..=1.0 + 1e-12).contains(channel)));
            let itself = with_luminance_of(color, color);
            prop_assert!((0..3).all(|i| (itself[i] - color[i]).abs() < 1e-12));
        }
    }
}

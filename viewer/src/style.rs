//! How datasets take part in a picture: the user's word, beside what the catalog says.
//!
//! ```json
//! { "layers": [ { "dataset": "themis", "role": "luminance", "weight": 0.8 },
//!               { "dataset": "ice-1999", "series": 1, "weight": 0.3 },
//!               { "dataset": "ice-2020", "series": 1, "weight": 0.7 },
//!               { "dataset": "lola", "ramp": { "stops": [ { "height_m": 0, "color": [9, 9, 9] } ] } } ],
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
    /// Of heights: the dataset has colors, too, those of its own heights, and takes part with them as a
    /// dataset of colors does.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub ramp: Option<Ramp>,
}

fn whole() -> f64 {
    1.0
}

impl Layer {
    /// A dataset as it is when nothing is said about it.
    #[must_use]
    pub fn of(dataset: &str) -> Self {
        let dataset = dataset.to_owned();
        Self { dataset, weight: whole(), priority: None, series: 0, role: Role::Color, ramp: None }
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
    /// 0 to 1, over what there is without it.
    #[serde(default = "whole")]
    pub opacity: f64,
}

/// A height and its color.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Stop {
    /// Meters above the reference surface, composed or of a dataset, not exaggerated.
    pub height_m: f32,
    /// sRGB codes.
    pub color: [u8; 3],
}

impl Ramp {
    /// Stops that a ramp has at most.
    pub const MOST_STOPS: usize = 16;

    /// Stops of all ramps of a style.
    pub const MOST_STOPS_IN_ALL: usize = 256;

    /// The most that any code of a ramp of these stops changes by a meter.
    pub(crate) fn steepness(stops: &[Stop]) -> f64 {
        let pairs = stops.windows(2);
        let slope = |pair: &[Stop]| {
            let codes = (0..3).map(|i| pair[0].color[i].abs_diff(pair[1].color[i])).max();
            f64::from(codes.unwrap_or(0)) / f64::from(pair[1].height_m - pair[0].height_m)
        };
        pairs.map(slope).fold(0.0, f64::max)
    }

    /// It is `called` so in an error.
    fn check(&self, called: &str) -> Result<(), StyleError> {
        let bad = |reason| Err(StyleError::Ramp { ramp: called.to_owned(), reason });
        if self.stops.is_empty() || self.stops.len() > Self::MOST_STOPS {
            return bad("must have 1 to 16 stops");
        }
        if !self.stops.is_sorted_by(|one, next| one.height_m < next.height_m) {
            return bad("must have its stops from the lowest up");
        }
        if !(0.0..=1.0).contains(&self.opacity) {
            return bad("must have an opacity between 0 and 1");
        }
        Ok(())
    }

    /// sRGB codes at a height.
    #[must_use]
    pub fn color(&self, height_m: f64) -> [f64; 3] {
        Self::color_of(&self.stops, height_m)
    }

    pub(crate) fn color_of(stops: &[Stop], height_m: f64) -> [f64; 3] {
        let codes = |stop: &Stop| stop.color.map(f64::from);
        let above = stops.partition_point(|stop| f64::from(stop.height_m) <= height_m);
        let (Some(below), above) = (above.checked_sub(1), stops.get(above)) else {
            return stops.first().map_or([0.0; 3], codes);
        };
        let below = &stops[below];
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
    #[error("{ramp} {reason}")]
    Ramp {
        /// Which it is.
        ramp: String,
        /// What is wrong with it.
        reason: &'static str,
    },
    /// More than there is room for.
    #[error("the ramps have {found} stops together, and 256 is the most")]
    Stops {
        /// How many there are.
        found: usize,
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
            ramp.check("the ramp")?;
        }
        for layer in &style.layers {
            if let Some(ramp) = &layer.ramp {
                ramp.check(&format!("layer {:?}: its ramp", layer.dataset))?;
            }
        }
        let found = style.ramps().map(|ramp| ramp.stops.len()).sum();
        if found > Ramp::MOST_STOPS_IN_ALL {
            return Err(StyleError::Stops { found });
        }
        Ok(style)
    }

    /// Where the stops of one of its ramps stand among [`Self::stops`]; none, if it has none or there are too
    /// many.
    fn place_of(&self, ramp: &Ramp) -> Option<[u32; 2]> {
        let before = self.ramps().take_while(|other| !std::ptr::eq(*other, ramp));
        let (first, count) = (before.map(|other| other.stops.len()).sum(), ramp.stops.len());
        let fits = count > 0 && first + count <= Ramp::MOST_STOPS_IN_ALL;
        let narrow = |place: usize| u32::try_from(place).ok();
        Some([narrow(first)?, narrow(count)?]).filter(|_| fits)
    }

    /// The stops of all ramps, one behind the other.
    pub(crate) fn stops(&self) -> impl Iterator<Item = Stop> {
        self.ramps().flat_map(|ramp| ramp.stops.iter().copied())
    }

    /// That of the composed heights, and those of datasets.
    fn ramps(&self) -> impl Iterator<Item = &Ramp> {
        self.ramp.iter().chain(self.layers.iter().filter_map(|layer| layer.ramp.as_ref()))
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

    /// The names of layers whose ramp colors nothing: their datasets have no heights.
    pub fn idle_ramps(&self, datasets: &Datasets) -> impl Iterator<Item = &str> {
        let is_idle = |layer: &&Layer| {
            let is_meant = |name: &str| layer.closeness(name).is_some();
            let mut meant = datasets.iter().filter(|(_, info)| is_meant(&info.name)).peekable();
            meant.peek().is_some() && meant.all(|(_, info)| info.kind != Kind::Height)
        };
        let with_ramps = self.layers.iter().filter(|layer| layer.ramp.is_some());
        with_ramps.filter(is_idle).map(|layer| layer.dataset.as_str())
    }

    /// Whether there is room for so many stops more.
    pub(crate) fn has_room(&self, stops: usize) -> bool {
        self.stops().count() + stops <= Ramp::MOST_STOPS_IN_ALL
    }

    /// Whether a dataset has no weight: nothing of it has to be loaded.
    #[must_use]
    pub fn hides(&self, dataset: &str) -> bool {
        self.layer(dataset).is_some_and(|layer| layer.weight == 0.0)
    }

    /// How a dataset of a name, a kind and a priority of its own takes part, if it does: heights with a ramp do so
    /// twice.
    pub(crate) fn parts(
        &self,
        dataset: &str,
        kind: Kind,
        priority: i32,
    ) -> impl Iterator<Item = Part> + use<> {
        let layer = self.layer(dataset);
        let own = Part {
            plane: Plane::of(kind, layer.map_or(Role::Color, |layer| layer.role)),
            priority: layer.and_then(|layer| layer.priority).unwrap_or(priority),
            series: layer.map_or(0, |layer| layer.series),
            weight: layer.map_or(1.0, |layer| layer.weight),
            stops: NO_STOPS,
        };
        let ramp = layer.and_then(|layer| layer.ramp.as_ref()).filter(|_| kind == Kind::Height);
        let colored = ramp.and_then(|ramp| {
            let weight = own.weight * ramp.opacity;
            Some(Part { plane: Plane::Colors, weight, stops: self.place_of(ramp)?, ..own })
        });
        [Some(own), colored].into_iter().flatten().filter(|part| part.weight > 0.0)
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

/// A dataset's part in a plane of a picture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Part {
    pub(crate) plane: Plane,
    pub(crate) priority: i32,
    pub(crate) series: u32,
    /// Above 0.
    pub(crate) weight: f64,
    /// Of heights in the plane of colors: the first of their ramp's stops among all, and how many there are.
    pub(crate) stops: [u32; 2],
}

const NO_STOPS: [u32; 2] = [0; 2];

impl Part {
    /// Of a dataset of which nothing is said.
    #[cfg(test)]
    pub(crate) fn of(kind: Kind) -> Self {
        Style::default().parts("", kind, 0).next().unwrap()
    }

    /// Whether it is made of heights.
    pub(crate) fn is_of_heights(&self) -> bool {
        self.plane == Plane::Heights || self.stops != NO_STOPS
    }
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
        let ramp = Ramp { stops, opacity: 0.5 };
        let layer = Layer { series: 2, role: Role::Luminance, ..Layer::of("a") };
        let colored = Layer { ramp: Some(ramp.clone()), ..Layer::of("b") };
        let style = Style { layers: vec![layer, colored], ramp: Some(ramp) };
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
            (
                r#"{"layers": [{"dataset": "a", "ramp": {"stops": []}}]}"#,
                "layer \"a\": its ramp must have 1 to 16 stops",
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

    #[test]
    fn heights_with_a_ramp_take_part_twice() {
        let stop = |height_m, code| Stop { height_m, color: [code; 3] };
        let ramp = |stops: Vec<Stop>, opacity| Some(Ramp { stops, opacity });
        let layers = vec![
            Layer { ramp: ramp(vec![stop(0.0, 1); 1], 1.0), ..Layer::of("a") },
            Layer {
                weight: 0.5,
                ramp: ramp(vec![stop(0.0, 2), stop(4.0, 22)], 0.5),
                ..Layer::of("b")
            },
        ];
        let style = Style { layers, ramp: ramp(vec![stop(0.0, 0); 3], 1.0) };
        let parts = |name, kind| style.parts(name, kind, 7).collect::<Vec<_>>();
        let [heights, colors] = parts("b", Kind::Height)[..] else { panic!("two parts") };
        assert_eq!((heights.plane, heights.weight, heights.stops), (Plane::Heights, 0.5, [0; 2]));
        assert_eq!((colors.plane, colors.weight, colors.priority), (Plane::Colors, 0.25, 7));
        let [first, count] = colors.stops.map(|place| place as usize);
        let stops: Vec<Stop> = style.stops().collect();
        assert_eq!(stops[first..][..count], [stop(0.0, 2), stop(4.0, 22)]);
        assert_eq!(Ramp::steepness(&stops[first..][..count]), 5.0);
        // It is of heights, and those of which nothing is said have none.
        assert_eq!(parts("b", Kind::Color).len(), 1);
        assert_eq!(parts("c", Kind::Height).len(), 1);
        let many = Layer {
            ramp: ramp((0..16_u8).map(|m| stop(m.into(), 0)).collect(), 1.0),
            ..Layer::of("a")
        };
        let all = Style { layers: vec![many; 17], ramp: None };
        // One that does not go through JSON draws what fits.
        let drawn = |first: usize| {
            let style = Style { layers: all.layers[first..].to_vec(), ramp: None };
            style.parts("a", Kind::Height, 0).count()
        };
        assert_eq!([0, 1].map(drawn), [1, 2]);
        let error = Style::from_json(&serde_json::to_string(&all).unwrap()).unwrap_err();
        assert!(error.to_string().contains("272 stops together"), "{error}");
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

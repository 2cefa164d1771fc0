//! Composition: one value from the values of several datasets.
//!
//! ```text
//!   front  ── priority 2 ──  mean of its datasets by q·c·u ─┐
//!          ── priority 1 ──  mean of its datasets by q·c·u ─┤ "over", α from c·u
//!   back   ── priority 0 ──  mean of its datasets by q·c·u ─┘
//! ```
//!
//! q is the projection quality ([`Grid::quality`](crate::grid::Grid::quality)), c the feathered
//! coverage, u the user's weight. What a height query answers and what the viewer draws is this
//! function, in f64 here and in f32 in the viewer's shader.
//!
//! # References
//!
//! Kooima 2008, §4.1: composition as image processing. The 'over' operator: T. Porter and
//! T. Duff, "Compositing Digital Images", SIGGRAPH 1984.

/// What one dataset has to say about a place.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Layer {
    /// Higher covers lower.
    pub priority: i32,
    /// Projection quality q, positive.
    pub quality: f64,
    /// Reconstructed coverage c in (0, 1].
    pub coverage: f64,
    /// The user's weight u in [0, 1].
    pub weight: f64,
    /// Layers of one priority and one series are states of one thing, such as two dates of it: their
    /// α add up to 1 at most. 0 stands alone.
    pub series: u32,
    /// Meters in the first number, or color codes.
    pub value: [f64; 3],
    /// How far `value` may be from the dataset's finest level.
    pub bound: f64,
    /// How far `coverage` may be from the finest level's.
    pub coverage_bound: f64,
}

/// A composed value.
#[derive(Clone, Debug, PartialEq)]
pub struct Composed {
    /// Meters in the first number, or color codes.
    pub value: [f64; 3],
    /// How far `value` may be from the composition of the finest levels.
    pub bound: f64,
    /// The share of each layer, in the order given; they sum to 1.
    pub shares: Vec<f64>,
    /// How far the weights let the layers cover what is behind all of them: 1 where each is 1.
    pub opacity: f64,
}

/// Composes `layers`, given in any order; `None` if none of them counts.
///
/// Within a priority the value is the mean by q·c·u; the priorities are laid over one another,
/// front to back, each with the α by which its datasets together cover the place,
/// 1 − Π(1 − c·u); of a series Σ c·u counts as one dataset's. What shows through behind the last is
/// nobody's, so the shares are scaled to sum to 1: a lone dataset answers however small its coverage.
/// What its weight takes from it is told apart, in [`Composed::opacity`]: the α of all, over the α that
/// they had if every weight were 1.
///
/// # Precision
///
/// A layer wholly covering the place hides all lower priorities exactly. The bound is
/// Σ wᵢ·boundᵢ + Σ (bound on cᵢ)·spread, where the spread is that of the values composed.
#[must_use]
pub fn compose(layers: &[Layer]) -> Option<Composed> {
    let counts = |layer: &Layer| layer.coverage * layer.weight > 0.0 && layer.quality > 0.0;
    let mut order: Vec<usize> = (0..layers.len()).filter(|&i| counts(&layers[i])).collect();
    order.sort_by_key(|&i| std::cmp::Reverse(layers[i].priority));

    let mut shares = vec![0.0; layers.len()];
    let (mut transparency, mut unweighted) = (1.0, 1.0);
    for group in order.chunk_by(|&i, &j| layers[i].priority == layers[j].priority) {
        let weight = |i: usize| layers[i].quality * layers[i].coverage * layers[i].weight;
        let total: f64 = group.iter().map(|&i| weight(i)).sum();
        let see_through = see_through(layers, group, |layer| layer.coverage * layer.weight);
        unweighted *= self::see_through(layers, group, |layer| layer.coverage);
        for &i in group {
            shares[i] = transparency * (1.0 - see_through) * weight(i) / total;
        }
        transparency *= see_through;
    }
    let sum: f64 = shares.iter().sum();
    if sum.is_nan() || sum <= 0.0 {
        return None;
    }
    shares.iter_mut().for_each(|share| *share /= sum);

    let shown = || layers.iter().zip(&shares).filter(|&(_, &share)| share > 0.0);
    let mut value = [0.0; 3];
    let (mut bound, mut uncertainty) = (0.0, 0.0);
    let (mut low, mut high) = ([f64::INFINITY; 3], [f64::NEG_INFINITY; 3]);
    for (layer, share) in shown() {
        bound += share * layer.bound;
        uncertainty += layer.coverage_bound;
        for channel in 0..3 {
            value[channel] += share * layer.value[channel];
            low[channel] = low[channel].min(layer.value[channel] - layer.bound);
            high[channel] = high[channel].max(layer.value[channel] + layer.bound);
        }
    }
    let spread = (0..3).map(|channel| high[channel] - low[channel]).fold(0.0, f64::max);
    if shown().count() > 1 {
        bound += uncertainty.min(1.0) * spread;
    }
    let opacity = ((1.0 - transparency) / (1.0 - unweighted)).min(1.0);
    Some(Composed { value, bound, shares, opacity })
}

/// What layers of one priority leave clear of what is behind them.
fn see_through(layers: &[Layer], group: &[usize], alpha: impl Fn(&Layer) -> f64) -> f64 {
    let is_first = |place: usize| {
        let series = layers[group[place]].series;
        series == 0 || group[..place].iter().all(|&i| layers[i].series != series)
    };
    let of_series = |place: usize| {
        let series = layers[group[place]].series;
        let alike = group[place..].iter().map(|&i| &layers[i]);
        let states = alike.take(if series == 0 { 1 } else { usize::MAX });
        let sum: f64 = states.filter(|layer| layer.series == series).map(&alpha).sum();
        1.0 - sum.min(1.0)
    };
    (0..group.len()).filter(|&place| is_first(place)).map(of_series).product()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn layer(priority: i32, coverage: f64, value: f64) -> Layer {
        let value = [value, 0.0, 0.0];
        let (quality, weight, bound, coverage_bound) = (1.0, 1.0, 0.0, 0.0);
        Layer { priority, quality, coverage, weight, series: 0, value, bound, coverage_bound }
    }

    #[test]
    fn a_lone_layer_answers_however_little_it_covers() {
        let composed = compose(&[layer(0, 0.01, 42.0)]).unwrap();
        assert_eq!((composed.value[0], composed.shares), (42.0, vec![1.0]));
        assert_eq!(compose(&[]), None);
        assert_eq!(compose(&[Layer { weight: 0.0, ..layer(0, 1.0, 1.0) }]), None);
    }

    #[test]
    fn a_higher_priority_that_covers_wholly_shows_untouched() {
        let composed = compose(&[layer(0, 1.0, 5.0), layer(3, 1.0, 7.0)]).unwrap();
        assert_eq!((composed.value[0], composed.shares), (7.0, vec![0.0, 1.0]));
        let half = compose(&[layer(0, 1.0, 5.0), layer(3, 0.5, 7.0)]).unwrap();
        assert_eq!(half.value[0], 6.0);
    }

    #[test]
    fn two_states_blend_and_show_nothing_beneath() {
        let state = |weight, value| Layer { weight, series: 7, ..layer(1, 1.0, value) };
        let composed = compose(&[layer(0, 1.0, 1e6), state(0.25, 8.0), state(0.75, 4.0)]).unwrap();
        assert_eq!((composed.value[0], composed.opacity), (5.0, 1.0));
        // Apart, each would let a share of what is beneath through the other.
        let apart = [state(0.25, 8.0), state(0.75, 4.0)].map(|layer| Layer { series: 0, ..layer });
        let composed = compose(&[layer(0, 1.0, 1e6), apart[0], apart[1]]).unwrap();
        assert!(composed.value[0] > 1e5);
    }

    #[test]
    fn opacity_is_what_the_weights_leave() {
        let faint = |coverage| Layer { weight: 0.25, ..layer(0, coverage, 3.0) };
        assert_eq!(compose(&[faint(1.0)]).unwrap().opacity, 0.25);
        assert_eq!(compose(&[faint(0.5)]).unwrap().opacity, 0.25);
        assert_eq!(compose(&[faint(1.0), layer(-1, 1.0, 0.0)]).unwrap().opacity, 1.0);
        assert_eq!(compose(&[layer(0, 0.125, 3.0)]).unwrap().opacity, 1.0);
    }

    #[test]
    fn one_priority_blends_by_quality_and_coverage() {
        let better = Layer { quality: 3.0, ..layer(0, 1.0, 8.0) };
        let composed = compose(&[layer(0, 1.0, 4.0), better]).unwrap();
        assert_eq!(composed.value[0], 7.0);
    }

    proptest! {
        #[test]
        fn a_composition_stays_between_its_layers(
            layers in prop::collection::vec((-2..3_i32, 0.004..1.0_f64, -1e4..1e4_f64), 1..6),
        ) {
            let layers: Vec<Layer> = layers.into_iter().map(|(p, c, v)| layer(p, c, v)).collect();
            let composed = compose(&layers).unwrap();
            let values = layers.iter().map(|layer| layer.value[0]);
            let low = values.clone().fold(f64::INFINITY, f64::min);
            let high = values.fold(f64::NEG_INFINITY, f64::max);
            prop_assert!((low - 1e-9..=high + 1e-9).contains(&composed.value[0]));
            prop_assert!((composed.shares.iter().sum::<f64>() - 1.0).abs() < 1e-12);
        }
    }
}

//! Laws 1 to 4 on small rasters, drawn by the hundred, and on every kind of edge by name.

use proptest::prelude::*;

use crate::support::lawful::assert_lawful;
use crate::support::levels::Edge;
use crate::support::raster::{Place, Random, Raster};

/// How heights vary.
#[derive(Clone, Copy, Debug)]
enum Relief {
    Noise,
    Smooth,
    TwoValues,
    Spikes,
}

/// Where there are none.
#[derive(Clone, Copy, Debug)]
enum Holes {
    None,
    /// Single texels, this share of them.
    Scattered(f64),
    /// Blocks of texels.
    Blocks,
}

fn made_up(
    place: Place,
    size: (usize, usize),
    step: Option<(f64, f64)>,
    relief: Relief,
    holes: Holes,
    seed: u64,
) -> Raster {
    let mut random = Random(seed);
    let blocks: Vec<(usize, usize, usize)> = (0..5)
        .map(|_| {
            let place = |length: usize, random: &mut Random| (random.unit() * length as f64) as usize;
            (place(size.0, &mut random), place(size.1, &mut random), place(9, &mut random))
        })
        .collect();
    let fraction = if step.is_none() { 1.0 / 7.0 } else { 1.0 };
    Raster::new(place, size, step, |row, col| {
        let hole = match holes {
            Holes::None => false,
            Holes::Scattered(share) => random.unit() < share,
            Holes::Blocks => blocks
                .iter()
                .any(|&(top, left, side)| row.wrapping_sub(top) < side && col.wrapping_sub(left) < side),
        };
        if hole {
            return f32::NAN;
        }
        let noise = (random.unit() * 2000.0).round() - 1000.0;
        let whole = match relief {
            Relief::Noise => noise,
            Relief::Smooth => (40.0 * (row as f64 / 5.0).sin() * col as f64 + noise / 100.0).round(),
            Relief::TwoValues => if noise > 0.0 { 1.0 } else { 0.0 },
            Relief::Spikes => if noise > 950.0 { 30_000.0 } else { -7.0 },
        };
        (whole * fraction) as f32
    })
}

fn any_edge() -> impl Strategy<Value = Edge> {
    prop::sample::select(vec![Edge::Repeat, Edge::PoleOnOutline, Edge::PoleOnPosts])
}

fn any_place() -> impl Strategy<Value = Place> {
    prop_oneof![
        Just(Place::Region),
        Just(Place::Belt),
        (any_edge(), any_edge()).prop_map(|(north, south)| match (north, south) {
            (Edge::Repeat, Edge::Repeat) => Place::Belt,
            _ => Place::Globe(north, south),
        }),
    ]
}

fn any_relief() -> impl Strategy<Value = Relief> {
    use Relief::{Noise, Smooth, Spikes, TwoValues};
    prop::sample::select(vec![Noise, Smooth, TwoValues, Spikes])
}

fn any_holes() -> impl Strategy<Value = Holes> {
    let share = prop::sample::select(vec![0.02, 0.3, 0.8, 0.97]).prop_map(Holes::Scattered);
    prop_oneof![Just(Holes::None), share, Just(Holes::Blocks)]
}

/// A raster that has a pyramid in pages of the side beside it.
fn any_raster() -> impl Strategy<Value = (Raster, u32)> {
    let step = prop::sample::select(vec![
        None,
        Some((1.0, 0.0)),
        Some((10.0, 0.0)),
        Some((0.5, 100.25)),
    ]);
    let side = prop::sample::select(vec![8, 10, 12, 18]);
    // Widths around the body halve often enough, others need not.
    let size = (1..70_usize, 1..60_usize);
    (any_place(), size, step, side, any_relief(), any_holes(), any::<u64>()).prop_filter_map(
        "no pyramid",
        |(place, (cols, rows), step, side, relief, holes, seed)| {
            let (cols, rows) = match place {
                Place::Region => (cols, rows),
                Place::Belt => (cols.next_multiple_of(16), rows),
                Place::Globe(_, Edge::PoleOnOutline) => {
                    (cols.next_multiple_of(16), rows.next_multiple_of(8))
                }
                Place::Globe(..) => (cols.next_multiple_of(16), rows.max(3)),
            };
            let raster = made_up(place, (rows, cols), step, relief, holes, seed);
            let any = raster.planes[0].iter().any(|height| !height.is_nan());
            (any && raster.grid(side).is_ok()).then_some((raster, side))
        },
    )
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 400, failure_persistence: None, ..Default::default() })]

    #[test]
    fn pages_of_any_raster_are_lawful((raster, side) in any_raster()) {
        assert_lawful(&raster.archive(side), &raster);
    }
}

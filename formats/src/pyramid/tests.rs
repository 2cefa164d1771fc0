//! Sizes, extensions and sources, by name and by chance.

use super::*;
use proptest::prelude::*;

fn globe(width: u32, height: u32, contact: PoleContact) -> Extent {
    Extent { width, height, wraps: true, north: contact, south: contact }
}

fn region(width: u32, height: u32) -> Extent {
    let none = PoleContact::None;
    Extent { width, height, wraps: false, north: none, south: none }
}

#[test]
fn a_page_beyond_what_a_key_can_name_is_refused() {
    let most = 6 * PageAddress::MAX_PAGES_PER_SIDE;
    let pyramid = Pyramid::new(region(most, 1), 8).unwrap();
    let (_, cols) = pyramid.pages(pyramid.finest()).unwrap();
    assert_eq!(cols, PageAddress::MAX_PAGES_PER_SIDE);
    for extent in [region(most + 1, 1), region(1, u32::MAX)] {
        let refused = Pyramid::new(extent, 8);
        assert!(matches!(refused, Err(PyramidError::TooManyPages { .. })), "{refused:?}");
    }
}

fn roots(extent: Extent) -> (u32, u32, u8) {
    let pyramid = Pyramid::new(extent, 512).unwrap();
    let root = pyramid.size(Level(0)).unwrap();
    (root.width, root.height, pyramid.finest().0)
}

#[test]
fn sizes_halve_down_to_the_root_the_design_names() {
    assert_eq!(roots(globe(43200, 21600, PoleContact::Outline)), (1350, 675, 5));
    assert_eq!(roots(globe(2880, 1440, PoleContact::Outline)), (360, 180, 3));
    assert_eq!(roots(globe(4320, 2161, PoleContact::Posts)), (270, 136, 4));
    assert_eq!(roots(region(1007, 633)), (504, 317, 1));
    assert_eq!(roots(region(1, 1)), (1, 1, 0));
    assert_eq!(roots(region(510, 511)), (255, 256, 1));
}

#[test]
fn a_width_that_does_not_halve_is_refused_with_the_next_that_does() {
    let error = Pyramid::new(globe(106_694, 53_347, PoleContact::Outline), 512).unwrap_err();
    let PyramidError::Uneven { next_width, .. } = error else { panic!("{error}") };
    assert_eq!(next_width, 106_752);
    assert!(Pyramid::new(globe(675, 300, PoleContact::Outline), 512).is_err());
    assert!(Pyramid::new(globe(0, 300, PoleContact::None), 512).is_err());
}

#[test]
fn rows_turn_over_an_outline_on_the_pole() {
    let pyramid = Pyramid::new(globe(1024, 512, PoleContact::Outline), 66).unwrap();
    for level in pyramid.levels() {
        let height = i64::from(pyramid.size(level).unwrap().height);
        for past in 0..height {
            let north = pyramid.extended_row(level, -1 - past);
            let south = pyramid.extended_row(level, height + past);
            assert_eq!((i64::from(north.row), north.weight, north.turned), (past, 0.0, true));
            let mirrored = (height - 1 - past, 0.0, true);
            assert_eq!((i64::from(south.row), south.weight, south.turned), mirrored);
        }
    }
}

/// At the leaf the row before the pole's is the row after it; k halvings up, it lies 2^-k
/// between rows.
#[test]
fn rows_turn_over_posts_on_the_pole() {
    let pyramid = Pyramid::new(globe(4320, 2161, PoleContact::Posts), 512).unwrap();
    for level in pyramid.levels() {
        let halvings = pyramid.halvings(level);
        for past in 0..5_u32 {
            let north = pyramid.extended_row(level, -1 - i64::from(past));
            let coordinate = f64::from(north.row) + north.weight;
            assert_eq!(coordinate, f64::from(past) + 0.5_f64.powi(halvings as i32));
            assert!(north.turned);
        }
    }
    let south = pyramid.extended_row(pyramid.finest(), 2161);
    assert_eq!((south.row, south.weight, south.turned), (2159, 0.0, true));
    let south = pyramid.extended_row(Level(3), 1081);
    assert_eq!((south.row, south.next, south.weight), (1078, 1079, 0.5));
}

#[test]
fn columns_wrap_repeat_and_turn() {
    let globe = Pyramid::new(globe(1024, 512, PoleContact::Outline), 512).unwrap();
    let finest = globe.finest();
    assert_eq!(globe.extended_col(finest, -1, false), 1023);
    assert_eq!(globe.extended_col(finest, 1024, false), 0);
    assert_eq!(globe.extended_col(finest, 0, true), 512);
    assert_eq!(globe.extended_col(finest, -1, true), 511);
    let region = Pyramid::new(region(700, 700), 512).unwrap();
    assert_eq!(region.extended_col(region.finest(), -1, false), 0);
    assert_eq!(region.extended_col(region.finest(), 700, false), 699);
    assert_eq!(region.extended_row(region.finest(), 900).row, 699);
}

#[test]
fn a_page_draws_on_its_neighbors_and_over_the_pole() {
    let pyramid = Pyramid::new(globe(4080, 2040, PoleContact::Outline), 512).unwrap();
    let finest = pyramid.finest();
    let page = |row, col| PageAddress::new(finest, row, col);
    let inner = pyramid.sources(page(1, 1), 1);
    assert_eq!(inner.len(), 9);
    let corner = pyramid.sources(page(0, 0), 1);
    for (row, col) in [(0, 0), (0, 1), (1, 0), (1, 1), (0, 7), (1, 7), (0, 4), (0, 3), (0, 5)] {
        assert!(corner.contains(&page(row, col)), "{row},{col}");
    }
    assert_eq!(corner.len(), 9);
}

/// A page whose surroundings reach across a level from edge to edge: what lies between two rows
/// past an edge counts too.
#[test]
fn a_wide_halo_over_a_pole_passes_over_no_row() {
    let extent = Extent { south: PoleContact::Posts, ..globe(2688, 344, PoleContact::None) };
    let pyramid = Pyramid::new(extent, 38).unwrap();
    let sources = pyramid.sources(PageAddress::new(Level(4), 2, 0), 29);
    for col in 8..=11 {
        assert!(sources.contains(&PageAddress::new(Level(4), 1, col)), "{sources:?}");
    }
}

fn any_extent() -> impl Strategy<Value = Extent> {
    let contact =
        prop_oneof![Just(PoleContact::None), Just(PoleContact::Outline), Just(PoleContact::Posts)];
    (1..400_u32, 1..300_u32, any::<bool>(), contact.clone(), contact).prop_map(
        |(width, height, wraps, north, south)| match wraps {
            true => Extent { width: 8 * width, height: 4 * height, wraps, north, south },
            false => region(width, height),
        },
    )
}

proptest! {
    #[test]
    fn every_row_and_column_of_every_window_comes_from_its_level(
        extent in any_extent(), side in 5..40_u32,
    ) {
        let Ok(pyramid) = Pyramid::new(extent, 2 * side) else { return Ok(()) };
        for level in pyramid.levels() {
            let size = pyramid.size(level).unwrap();
            let (rows, _) = pyramid.pages(level).unwrap();
            prop_assert!(rows * pyramid.interior() >= size.height);
            for row in -1..i64::from(rows * pyramid.interior()) + 1 {
                let extended = pyramid.extended_row(level, row);
                prop_assert!(extended.row < size.height && extended.next < size.height);
                prop_assert!((0.0..1.0).contains(&extended.weight));
                prop_assert!(!extended.turned || extent.wraps);
            }
        }
    }

    /// Texel by texel, as the words have it.
    #[test]
    fn the_sources_of_a_page_hold_what_shows_around_it(
        extent in any_extent(), side in 5..40_u32, halo in 0..50_u32, place: [u16; 3],
    ) {
        let Ok(pyramid) = Pyramid::new(extent, 2 * side) else { return Ok(()) };
        let level = Level(u8::try_from(u32::from(place[0]) % (u32::from(pyramid.finest().0) + 1)).unwrap());
        let (rows, cols) = pyramid.pages(level).unwrap();
        let page = PageAddress::new(level, u32::from(place[1]) % rows, u32::from(place[2]) % cols);
        let interior = pyramid.interior();
        let around = |index: u32| {
            let start = i64::from(index * interior);
            start - i64::from(halo)..start + i64::from(interior + halo)
        };
        let mut expected = Vec::new();
        for row in around(page.row) {
            let from = pyramid.extended_row(level, row);
            for col in around(page.col) {
                let col = pyramid.extended_col(level, col, from.turned) / interior;
                expected.extend([from.row, from.next].map(|row| PageAddress::new(level, row / interior, col)));
            }
            expected.sort_unstable();
            expected.dedup();
        }
        prop_assert_eq!(pyramid.sources(page, halo), expected);
    }
}

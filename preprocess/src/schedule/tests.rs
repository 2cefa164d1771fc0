//! Every page once, from what is there, and nothing longer than it is needed.

use super::*;
use areoid_formats::pyramid::Extent;
use std::collections::HashSet;

fn pyramids() -> Vec<Pyramid> {
    let none = PoleContact::None;
    let region = |width, height| Extent { width, height, wraps: false, north: none, south: none };
    let globe = |width, height, contact| Extent {
        width,
        height,
        wraps: true,
        north: contact,
        south: contact,
    };
    let extents = [
        region(1, 1),
        region(100, 3),
        region(57, 83),
        region(129, 40),
        globe(64, 32, PoleContact::Outline),
        globe(64, 33, PoleContact::Posts),
        globe(128, 64, PoleContact::Outline),
        globe(192, 97, PoleContact::Posts),
        globe(40, 30, none),
        Extent { south: none, ..globe(96, 41, PoleContact::Outline) },
    ];
    extents
        .into_iter()
        .flat_map(|extent| [10, 18].map(|side| Pyramid::new(extent, side)))
        .filter_map(Result::ok)
        .collect()
}

fn all_pages(pyramid: &Pyramid, level: Level) -> Vec<PageAddress> {
    let (rows, cols) = pyramid.pages(level).unwrap();
    (0..rows).flat_map(|r| (0..cols).map(move |c| PageAddress::new(level, r, c))).collect()
}

#[test]
fn users_are_the_inverse_of_sources() {
    for pyramid in pyramids() {
        for level in pyramid.levels() {
            for halo in [1, 5, 12, 33] {
                for page in all_pages(&pyramid, level) {
                    let expected: Vec<PageAddress> = all_pages(&pyramid, level)
                        .into_iter()
                        .filter(|&user| pyramid.sources(user, halo).contains(&page))
                        .collect();
                    assert_eq!(users(&pyramid, page, halo), expected, "{page} {pyramid:?}");
                }
            }
        }
    }
}

#[test]
fn parents_are_fed_by_their_feeders() {
    for pyramid in pyramids() {
        for reach in [0, 1, 5, 12] {
            let pages = || pyramid.levels().flat_map(|level| all_pages(&pyramid, level));
            let mut expected: HashMap<PageAddress, Vec<PageAddress>> = HashMap::new();
            for parent in pages() {
                let around = |child| match reach {
                    0 => vec![child],
                    _ => pyramid.sources(child, reach),
                };
                let around: HashSet<_> = pyramid.children(parent).flat_map(around).collect();
                let found = feeders(&pyramid, parent, reach);
                assert_eq!(found.len(), around.len(), "{parent} {pyramid:?}");
                assert!(found.iter().all(|page| around.contains(page)), "{parent}");
                around.iter().for_each(|&page| expected.entry(page).or_default().push(parent));
            }
            for page in pages() {
                let expected = expected.remove(&page).unwrap_or_default();
                assert_eq!(fed(&pyramid, page, reach), expected, "{page} {pyramid:?}");
            }
        }
    }
}

/// Plays a schedule and checks that nothing is used before it is there or after it is gone,
/// that everything comes once, and that nothing is kept.
#[test]
fn every_page_is_made_once_from_what_is_there() {
    for pyramid in pyramids() {
        for (unit, halo, reach) in [(8, 5, 0), (2, 1, 5), (1, 12, 0), (1, 1, 12), (8, 5, 5)] {
            let (mut read, mut settled, mut whole) =
                (HashSet::new(), HashSet::new(), HashSet::new());
            let mut made = 0;
            for step in Schedule::new(&pyramid, unit, halo, reach) {
                read.extend(step.read);
                for page in step.settled {
                    if page.level == pyramid.finest() {
                        for source in pyramid.sources(page, halo) {
                            assert!(read.contains(&source), "{source} for {page}");
                        }
                    } else {
                        let feeders = feeders(&pyramid, page, reach);
                        assert!(feeders.iter().all(|feeder| settled.contains(feeder)));
                    }
                    assert!(settled.insert(page));
                }
                for page in step.whole {
                    for source in pyramid.sources(page, 1) {
                        assert!(settled.contains(&source), "{source} for {page}");
                    }
                    assert!(pyramid.children(page).all(|child| whole.contains(&child)));
                    assert!(whole.insert(page));
                    made += 1;
                }
                step.forget_read.iter().for_each(|page| assert!(read.remove(page)));
                step.forget_settled.iter().for_each(|page| assert!(settled.remove(page)));
                step.forget_whole.iter().for_each(|page| assert!(whole.remove(page)));
            }
            let pages: usize = pyramid.levels().map(|level| all_pages(&pyramid, level).len()).sum();
            assert_eq!(made, pages);
            assert_eq!((read.len(), settled.len(), whole.len()), (0, 0, 0), "{pyramid:?}");
        }
    }
}

/// `FORMAT.md`, "The order of records", taken at its word.
#[test]
fn the_order_is_the_one_the_format_describes() {
    for pyramid in pyramids() {
        for (unit, halo, reach) in [(8, 33, 0), (2, 5, 0), (2, 1, 5), (1, 1, 0), (1, 9, 5)] {
            let leaves = all_pages(&pyramid, pyramid.finest());
            let unit_of = |page: &PageAddress| {
                PageKey::from(PageAddress::new(Level(0), page.row / unit, page.col / unit))
            };
            let mut units: Vec<PageKey> = leaves.iter().map(unit_of).collect();
            units.sort_unstable();
            units.dedup();

            let mut schedule = Schedule::new(&pyramid, unit, halo, reach);
            let (mut read, mut settled, mut whole) =
                (HashSet::new(), HashSet::new(), HashSet::new());
            for unit in units {
                let mut expected_read: Vec<PageAddress> =
                    leaves.iter().copied().filter(|page| unit_of(page) == unit).collect();
                sort(&mut expected_read);
                read.extend(expected_read.iter().copied());
                let mut written = Vec::new();
                for level in pyramid.levels().rev() {
                    for page in all_pages(&pyramid, level) {
                        let ready = if level == pyramid.finest() {
                            pyramid.sources(page, halo).iter().all(|leaf| read.contains(leaf))
                        } else {
                            pyramid.children(page).all(|child| {
                                let around = pyramid.sources(child, reach);
                                settled.contains(&child)
                                    && (reach == 0
                                        || around.iter().all(|page| settled.contains(page)))
                            })
                        };
                        if ready {
                            settled.insert(page);
                        }
                    }
                    let mut pages = all_pages(&pyramid, level);
                    sort(&mut pages);
                    for page in pages {
                        let bordered = pyramid.sources(page, Pyramid::BORDER);
                        if bordered.iter().all(|source| settled.contains(source))
                            && pyramid.children(page).all(|child| whole.contains(&child))
                            && whole.insert(page)
                        {
                            written.push(page);
                        }
                    }
                }
                let step = schedule.next().expect("a step for each unit");
                assert_eq!(step.read, expected_read);
                assert_eq!(step.whole, written, "{pyramid:?}");
            }
            assert_eq!(schedule.next(), None);
        }
    }
}

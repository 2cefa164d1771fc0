use super::interval::Number;
use super::*;
use proptest::prelude::*;

const SIDE: usize = 12;
const INTERIOR: usize = SIDE - 2;

/// A parent and its four children, texels drawn anew for each.
#[derive(Clone, Debug)]
struct Texels<S> {
    parent: Vec<S>,
    children: Vec<Vec<S>>,
    /// Rows and columns of the lower right child; the others are whole.
    cut: (usize, usize),
}

impl<S: Texel> Texels<S> {
    fn parent(&self) -> Window<'_, S> {
        Window { side: SIDE, texels: &self.parent, coverage: None, span: None }
    }

    fn child(&self, row: usize, col: usize) -> Child<'_, S> {
        let size = |place, cut| if place == 0 { INTERIOR } else { cut };
        Child {
            row,
            col,
            window: Window { texels: &self.children[2 * row + col], ..self.parent() },
            size: (size(row, self.cut.0), size(col, self.cut.1)),
            finest: true,
            cells: None,
        }
    }

    fn children(&self) -> Vec<Child<'_, S>> {
        [(0, 0), (0, 1), (1, 0), (1, 1)].map(|(row, col)| self.child(row, col)).to_vec()
    }

    /// The range of all texels.
    fn range(&self) -> (S, S) {
        let texels = self.children.iter().flatten().chain(&self.parent);
        let start = (self.parent[0], self.parent[0]);
        texels.fold(start, |(low, high), &texel| {
            (if texel < low { texel } else { low }, if texel > high { texel } else { high })
        })
    }

    fn cells(&self) -> Cells<S::Cell> {
        let family = Family { parent: self.parent(), children: self.children() };
        parent_cells(&[family], self.size(), self.range())
    }

    fn size(&self) -> (usize, usize) {
        ((INTERIOR + self.cut.0).div_ceil(2), (INTERIOR + self.cut.1).div_ceil(2))
    }
}

fn family<S: Texel + Arbitrary>(
    texel: impl Strategy<Value = S> + Clone,
) -> impl Strategy<Value = Texels<S>> {
    let window = || prop::collection::vec(texel.clone(), SIDE * SIDE);
    let cut = 1..=INTERIOR;
    (window(), prop::collection::vec(window(), 4), (cut.clone(), cut))
        .prop_map(|(parent, children, cut)| Texels { parent, children, cut })
}

/// Whether a parent and four children in `texels`, the last cut to even parts of their interiors, have the
/// same intervals with children that are exact and with such that are known to be.
fn is_same_at_once<S: Texel<Cell = i16>>(texels: &[S], side: usize, cut: (usize, usize)) -> bool {
    let interior = side - 2;
    let window = |which: usize| {
        let texels = &texels[which * side * side..][..side * side];
        Window { side, texels, coverage: None, span: None }
    };
    let part = |place: usize, cut: usize| {
        if place == 0 { interior } else { interior - 2 * (cut % (interior / 2)) }
    };
    let mut zero = Cells::empty::<S>(interior, interior, 0);
    zero.low.fill(0);
    zero.high.fill(0);
    let of = |known: bool| {
        let child = |which: usize| {
            let (row, col) = (which / 2, which % 2);
            let size = (part(row, cut.0), part(col, cut.1));
            let cells = known.then_some(&zero);
            Child { row, col, window: window(which), size, finest: true, cells }
        };
        let children = (0..4).map(child).collect();
        let size = [cut.0, cut.1].map(|cut| (interior + part(1, cut)) / 2);
        let range = texels.iter().fold((texels[0], texels[0]), |(low, high), &texel| {
            (if texel < low { texel } else { low }, if texel > high { texel } else { high })
        });
        parent_cells(&[Family { parent: window(4), children }], (size[0], size[1]), range)
    };
    of(true) == of(false)
}

/// The reconstruction of a window at a point in its own texels, the first one's center at (½, ½).
fn reconstruct<S: Texel>(window: Window<'_, S>, row: f64, col: f64) -> f64 {
    let tap = |at: f64| ((at - 0.5).floor(), (at - 0.5).rem_euclid(1.0));
    let ((top, below), (left, beside)) = (tap(row), tap(col));
    let mut sum = 0.0;
    for (down, across, weight) in [
        (0.0, 0.0, (1.0 - below) * (1.0 - beside)),
        (0.0, 1.0, (1.0 - below) * beside),
        (1.0, 0.0, below * (1.0 - beside)),
        (1.0, 1.0, below * beside),
    ] {
        if weight > 0.0 {
            #[expect(clippy::cast_sign_loss, clippy::cast_possible_truncation, reason = "a row")]
            let at = |start: f64, step: f64| (start + step) as usize;
            sum += weight * window.at(at(top, down), at(left, across));
        }
    }
    sum
}

/// Every cell's interval by reconstructing both levels at nine points of each child cell.
fn by_the_book<S: Texel>(family: &Texels<S>) -> Vec<Vec<(f64, f64)>> {
    let (rows, cols) = family.size();
    let mut cells = vec![vec![(f64::INFINITY, f64::NEG_INFINITY); cols]; rows];
    for child in family.children() {
        for row in 0..child.size.0 {
            for col in 0..child.size.1 {
                for (down, across) in LATTICE {
                    let (y, x) = (row as f64 + down as f64 / 2.0, col as f64 + across as f64 / 2.0);
                    let fine = reconstruct(child.window, y + 1.0, x + 1.0);
                    let place =
                        |place: usize, at: f64| ((place * INTERIOR) as f64 + at) / 2.0 + 1.0;
                    let (y, x) = (place(child.row, y), place(child.col, x));
                    let difference = reconstruct(family.parent(), y, x) - fine;
                    let cell = &mut cells[(child.row * INTERIOR + row) / 2]
                        [(child.col * INTERIOR + col) / 2];
                    *cell = (cell.0.min(difference), cell.1.max(difference));
                }
            }
        }
    }
    cells
}

fn ends<S: Texel>(cells: &Cells<S::Cell>) -> Vec<Vec<(f64, f64)>> {
    let end = |cell| S::end(cell, cells.unit_log2);
    let pairs = cells.low.iter().zip(&cells.high).map(|(&l, &h)| (end(l), end(h)));
    pairs.collect::<Vec<_>>().chunks(cells.cols).map(<[_]>::to_vec).collect()
}

/// The same, in the arithmetic of `T`, whatever the texels.
fn in_arithmetic<S: Texel, T: Number<S>>(family: &Texels<S>, base: S) -> Cells<S::Cell> {
    let (rows, cols) = family.size();
    let mut cells = Cells::empty::<S>(rows, cols, 0);
    for child in family.children() {
        Widening::<S, T>::new(&mut cells, family.parent(), &child, Terms::exact(base)).run();
    }
    cells
}

/// Whole heights that span at most 2000 m, anywhere.
fn close_heights() -> impl Strategy<Value = Texels<i16>> {
    (family(0_i16..=2000), i16::MIN..=i16::MAX - 2000).prop_map(|(mut family, from)| {
        let texels = family.children.iter_mut().flatten().chain(&mut family.parent);
        texels.for_each(|texel| *texel += from);
        family
    })
}

/// Whether intervals contain what they should, and how far they are out at most.
fn slack(found: &[(f64, f64)], exact: &[(f64, f64)]) -> Option<f64> {
    found.iter().zip(exact).try_fold(0.0_f64, |most, (found, exact)| {
        let (low, high) = (exact.0 - found.0, found.1 - exact.1);
        (low >= 0.0 && high >= 0.0).then(|| most.max(low).max(high))
    })
}

proptest! {
    #[test]
    fn whole_heights_have_the_intervals_of_the_book(family in close_heights()) {
        let cells = family.cells();
        prop_assert_eq!(ends::<i16>(&cells), by_the_book(&family));
        prop_assert_eq!(&cells, &in_arithmetic::<i16, i32>(&family, 0));
    }

    #[test]
    fn whole_heights_far_apart_are_out_by_a_unit_at_most(family in family(any::<i16>())) {
        let cells = family.cells();
        let slack = slack(&ends::<i16>(&cells).concat(), &by_the_book(&family).concat());
        let unit = f64::from(1_u32 << cells.unit_log2) / 16.0;
        prop_assert!(slack.is_some_and(|slack| slack < unit), "{slack:?} {unit}");
        let (least, greatest) = family.range();
        let spread = f64::from(greatest) - f64::from(least);
        prop_assert!(unit <= (spread / 1000.0).max(1.0 / 16.0), "{unit} {spread}");
    }

    #[test]
    fn colors_have_the_intervals_of_the_book(family in family(any::<u8>())) {
        let cells = family.cells();
        prop_assert_eq!(ends::<u8>(&cells), by_the_book(&family));
    }

    #[test]
    fn channels_have_the_intervals_of_all_of_them(one in family(any::<u8>()), other in family(any::<u8>())) {
        let other = Texels { cut: one.cut, ..other };
        let of = |texels: &Texels<u8>| by_the_book(texels).concat();
        let joint = of(&one).into_iter().zip(of(&other));
        let joint: Vec<_> = joint.map(|(a, b)| (a.0.min(b.0), a.1.max(b.1))).collect();
        let channels = [&one, &other]
            .map(|texels| Family { parent: texels.parent(), children: texels.children() });
        let cells = parent_cells(&channels, one.size(), (0, 255));
        prop_assert_eq!(ends::<u8>(&cells).concat(), joint);
    }

    #[test]
    fn other_heights_lie_in_their_intervals(family in family(-1e4_f32..1e4)) {
        let found = ends::<f32>(&family.cells()).concat();
        let slack = slack(&found, &by_the_book(&family).concat());
        prop_assert!(slack.is_some_and(|slack| slack < 4e-3), "{slack:?}");
    }

    /// What is known of a child moves its intervals, to the bit where units are the same.
    #[test]
    fn what_is_known_is_added(
        family in close_heights(), low in -700_i16..0, high in 0_i16..700, unit_log2 in 0_u32..4,
    ) {
        let mut known = Cells::empty::<i16>(INTERIOR, INTERIOR, unit_log2);
        known.low.fill(low);
        known.high.fill(high);
        let own = family.child(0, 0);
        let cells = |child| {
            let pair = Family { parent: family.parent(), children: vec![child] };
            parent_cells(&[pair], (5, 5), family.range())
        };
        let (without, with) = (cells(own), cells(Child { cells: Some(&known), ..own }));
        let by = [low, high].map(|end| i16::end(end, unit_log2));
        let moved = |&(low, high): &(f64, f64)| (low + by[0], high + by[1]);
        let moved: Vec<_> = ends::<i16>(&without).concat().iter().map(moved).collect();
        let slack = slack(&ends::<i16>(&with).concat(), &moved);
        let unit = f64::from(1_u32 << with.unit_log2) / 16.0;
        let exact = with.unit_log2 == 0 && slack == Some(0.0);
        prop_assert!(exact || with.unit_log2 > 0 && slack.is_some_and(|slack| slack < unit));
        prop_assert!(with.unit_log2 >= unit_log2);
    }

    /// A child known to be exact has the intervals of one of which nothing is known: these are found cell
    /// by cell, those of a parent's cell at once. Windows of several lanes, and of parts of one.
    #[test]
    fn what_is_exact_is_the_same_at_once_and_cell_by_cell(
        half in 2..80_usize, cut: (usize, usize), shift in 0..16_u32, mut state: u64,
    ) {
        // Ranges of all sizes.
        let mut draw = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
            let [.., low, high] = state.to_le_bytes();
            i16::from_le_bytes([low, high]) >> shift
        };
        let side = 2 * half;
        let heights: Vec<i16> = (0..5 * side * side).map(|_| draw()).collect();
        let codes: Vec<u8> = heights.iter().map(|height| height.to_le_bytes()[0]).collect();
        prop_assert!(is_same_at_once(&codes, side, cut));
        prop_assert!(is_same_at_once(&heights, side, cut));
    }

    /// A texel that is not there is not looked at, in the child or in the parent.
    #[test]
    fn holes_hide_what_is_under_them(
        family in close_heights(),
        holes in prop::collection::vec((0..5_usize, 0..SIDE * SIDE, any::<i16>()), 1..6),
    ) {
        let range = family.range();
        let mut coverage = vec![vec![255_u8; SIDE * SIDE]; 5];
        let mut other = family.clone();
        for (which, at, texel) in holes {
            coverage[which][at] = 0;
            if which == 4 { other.parent[at] = texel } else { other.children[which][at] = texel }
        }
        let cells = |family: &Texels<i16>| {
            let cover = |window, which: usize| Window { coverage: Some(&coverage[which]), ..window };
            let children: Vec<_> = (0..4)
                .map(|which| {
                    let child = family.child(which / 2, which % 2);
                    Child { window: cover(child.window, which), ..child }
                })
                .collect();
            let parent = cover(family.parent(), 4);
            parent_cells(&[Family { parent, children }], family.size(), range)
        };
        prop_assert_eq!(cells(&family), cells(&other));
    }
}

#[test]
fn ends_round_outward() {
    assert_eq!(u8::outward(-0.01, 0.01, 0), (-1, 1));
    assert_eq!(u8::outward(1.0, -1.0, 0), u8::EMPTY);
    assert_eq!(u8::outward(-300.0, 300.0, 0), (-255 * 16, 255 * 16));
    assert_eq!(i16::outward(-0.2, 0.2, 2), (-1, 1));
    assert_eq!(i16::outward(-1000.0, 1000.0, 1), (-8000, 8000));
    let (low, high) = f32::outward(-0.1, 0.1, 0);
    assert!(f64::from(low) < -0.1 && f64::from(high) > 0.1);
}

/// The intervals of a family some of whose texels are not there; something is known of the first
/// child.
fn cells_with_holes<S: Texel>(
    family: &Texels<S>,
    coverage: &[Vec<u8>],
    finest: bool,
    known: &Cells<S::Cell>,
    range: (S, S),
) -> Vec<(f64, f64)> {
    let children = (0..4).map(|which| {
        let child = family.child(which / 2, which % 2);
        let window = Window { coverage: Some(&coverage[which]), ..child.window };
        Child { finest, cells: (which == 0).then_some(known), window, ..child }
    });
    let parent = Window { coverage: Some(&coverage[4]), ..family.parent() };
    let family_in_holes = Family { parent, children: children.collect() };
    ends::<S>(&parent_cells(&[family_in_holes], family.size(), range)).concat()
}

proptest! {
    /// Two arithmetics, NaN in the holes of one and anything in those of the other.
    #[test]
    fn floats_and_whole_heights_agree_beside_holes(
        family in family(any::<i16>()),
        holes in prop::collection::vec((0..5_usize, 0..SIDE * SIDE), 0..60),
        finest: bool,
        known in prop::collection::vec((-500_i16..500, 0_i16..500), INTERIOR * INTERIOR),
    ) {
        let mut coverage = vec![vec![255_u8; SIDE * SIDE]; 5];
        holes.into_iter().for_each(|(which, at)| coverage[which][at] = 0);
        let floats_of = |plane: &[i16], which: usize| -> Vec<f32> {
            let texels = plane.iter().zip(&coverage[which]);
            texels.map(|(&t, &code)| if code == 0 { f32::NAN } else { t.into() }).collect()
        };
        let floats = Texels {
            parent: floats_of(&family.parent, 4),
            children: (0..4).map(|which| floats_of(&family.children[which], which)).collect(),
            cut: family.cut,
        };
        let mut known_whole = Cells::empty::<i16>(INTERIOR, INTERIOR, 0);
        let mut known_float = Cells::empty::<f32>(INTERIOR, INTERIOR, 0);
        for (at, (low, length)) in known.into_iter().enumerate() {
            (known_whole.low[at], known_whole.high[at]) = (16 * low, 16 * (low + length));
            (known_float.low[at], known_float.high[at]) = (low.into(), (low + length).into());
        }
        let range = family.range();
        let whole = cells_with_holes(&family, &coverage, finest, &known_whole, range);
        let range = (range.0.into(), range.1.into());
        let float = cells_with_holes(&floats, &coverage, finest, &known_float, range);
        // A unit of the widest range, and what floats round.
        let same = |a: f64, b: f64| a == b || (a - b).abs() <= 4.0 + 0.01;
        for (whole, float) in whole.into_iter().zip(float) {
            prop_assert!(same(whole.0, float.0) && same(whole.1, float.1), "{whole:?} {float:?}");
        }
    }
}

use super::interval::Number;
use super::*;
use proptest::prelude::*;

const SIDE: usize = 12;
const INTERIOR: usize = SIDE - 2;
const MAGNITUDE: Magnitude = Magnitude { largest: 30_000.0, whole: true };

/// A parent and its four children, texels drawn anew for each.
#[derive(Clone, Debug)]
struct Family<S> {
    parent: Vec<S>,
    children: Vec<Vec<S>>,
    /// Rows and columns of the lower right child; the others are whole.
    cut: (usize, usize),
}

impl<S: Texel> Family<S> {
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

    fn size(&self) -> (usize, usize) {
        ((INTERIOR + self.cut.0).div_ceil(2), (INTERIOR + self.cut.1).div_ceil(2))
    }
}

fn family<S: Texel + Arbitrary>(
    texel: impl Strategy<Value = S> + Clone,
) -> impl Strategy<Value = Family<S>> {
    let window = || prop::collection::vec(texel.clone(), SIDE * SIDE);
    let cut = 1..=INTERIOR;
    (window(), prop::collection::vec(window(), 4), (cut.clone(), cut))
        .prop_map(|(parent, children, cut)| Family { parent, children, cut })
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
fn by_the_book<S: Texel>(family: &Family<S>) -> Vec<Vec<(f64, f64)>> {
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
    let pairs = cells.low.iter().zip(&cells.high).map(|(&l, &h)| (S::end(l), S::end(h)));
    pairs.collect::<Vec<_>>().chunks(cells.cols).map(<[_]>::to_vec).collect()
}

/// The same, in the arithmetic of `T`, whatever the texels.
fn in_arithmetic<S: Texel, T: Number<S>>(family: &Family<S>) -> Cells<S::Cell> {
    let (rows, cols) = family.size();
    let mut cells = Cells::empty::<S>(rows, cols);
    for child in family.children() {
        Widening::<S, T>::new(&mut cells, family.parent(), &child, 0.0).run();
    }
    cells
}

fn whole_height() -> impl Strategy<Value = f32> + Clone {
    (-9000_i16..30000).prop_map(f32::from)
}

proptest! {
    #[test]
    fn whole_heights_have_the_intervals_of_the_book(family in family(whole_height())) {
        let cells = parent_cells(family.parent(), family.size(), &family.children(), MAGNITUDE);
        prop_assert_eq!(ends::<f32>(&cells), by_the_book(&family));
        prop_assert_eq!(&cells, &in_arithmetic::<f32, f64>(&family));
    }

    #[test]
    fn colors_have_the_intervals_of_the_book(family in family(any::<u8>())) {
        let cells = parent_cells(family.parent(), family.size(), &family.children(), MAGNITUDE);
        prop_assert_eq!(ends::<u8>(&cells), by_the_book(&family));
    }

    #[test]
    fn other_heights_lie_in_their_intervals(family in family(-1e4_f32..1e4)) {
        let broken = Magnitude { largest: 1e4, whole: false };
        let cells = parent_cells(family.parent(), family.size(), &family.children(), broken);
        let found = ends::<f32>(&cells).concat();
        for ((low, high), (least, greatest)) in found.into_iter().zip(by_the_book(&family).concat()) {
            prop_assert!(low <= least && greatest <= high, "{low} {least} {greatest} {high}");
            prop_assert!(least - low < 4e-3 && high - greatest < 4e-3);
        }
    }

    /// What is known of a child moves its intervals, to the bit for whole sixteenths.
    #[test]
    fn what_is_known_is_added(family in family(whole_height()), low in -800_i16..0, high in 0_i16..800) {
        let ends = (f32::from(low) / 16.0, f32::from(high) / 16.0);
        let mut known = Cells::empty::<f32>(INTERIOR, INTERIOR);
        known.low.fill(ends.0);
        known.high.fill(ends.1);
        let without = parent_cells(family.parent(), (5, 5), &[family.child(0, 0)], MAGNITUDE);
        let child = Child { cells: Some(&known), ..family.child(0, 0) };
        let with = parent_cells(family.parent(), (5, 5), &[child], MAGNITUDE);
        let moved = |of: &[f32], by: f32| of.iter().map(|end| end + by).collect::<Vec<_>>();
        prop_assert_eq!(with.low, moved(&without.low, ends.0));
        prop_assert_eq!(with.high, moved(&without.high, ends.1));
    }

    /// A texel that is not there is not looked at, in the child or in the parent.
    #[test]
    fn holes_hide_what_is_under_them(
        family in family(any::<u8>()),
        holes in prop::collection::vec((0..5_usize, 0..SIDE * SIDE, any::<u8>()), 1..6),
    ) {
        let mut coverage = vec![vec![255_u8; SIDE * SIDE]; 5];
        let mut other = family.clone();
        for (which, at, texel) in holes {
            coverage[which][at] = 0;
            if which == 4 { other.parent[at] = texel } else { other.children[which][at] = texel }
        }
        let cells = |family: &Family<u8>| {
            let cover = |window, which: usize| Window { coverage: Some(&coverage[which]), ..window };
            let children: Vec<_> = (0..4)
                .map(|which| {
                    let child = family.child(which / 2, which % 2);
                    Child { window: cover(child.window, which), ..child }
                })
                .collect();
            parent_cells(cover(family.parent(), 4), family.size(), &children, MAGNITUDE)
        };
        prop_assert_eq!(cells(&family), cells(&other));
    }
}

#[test]
fn ends_round_outward() {
    assert_eq!(u8::outward(-0.01, 0.01), (-1, 1));
    assert_eq!(u8::outward(1.0, -1.0), u8::EMPTY);
    assert_eq!(u8::outward(-300.0, 300.0), (-255 * 16, 255 * 16));
    let (low, high) = f32::outward(-0.1, 0.1);
    assert!(f64::from(low) < -0.1 && f64::from(high) > 0.1);
}

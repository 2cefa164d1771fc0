use super::*;
use glam::DVec3;
use proptest::prelude::*;

fn any_box() -> impl Strategy<Value = Aabb> {
    let place = prop::array::uniform3(-100.0..100.0);
    (place, prop::array::uniform3(0.0..20.0)).prop_map(|(min, size)| {
        let min = DVec3::from_array(min);
        Aabb::new(min, min + DVec3::from_array(size))
    })
}

/// Parents point to their children and back, and fit them exactly.
fn check_shape(tree: &Bvh) {
    let mut leaves = 0;
    for (index, node) in
        tree.nodes.iter().enumerate().filter(|(index, _)| !tree.free.contains(index))
    {
        match node.content() {
            Content::Leaf(item) => {
                assert_eq!(tree.leaves.get(&item), Some(&index));
                leaves += 1;
            }
            Content::Inner([one, other]) => {
                assert_eq!(tree.parents[one], Some(index));
                assert_eq!(tree.parents[other], Some(index));
                assert_eq!(node.bounds, tree.nodes[one].bounds.union(&tree.nodes[other].bounds));
            }
        }
        assert_eq!(tree.parents[index].is_none(), tree.root == Some(index));
    }
    assert_eq!(leaves, tree.len());
    assert_eq!(tree.nodes.len() - tree.free.len(), (2 * leaves).saturating_sub(1));
}

/// Boxes like footprints of datasets: small and thin ones on a sphere, a few of them large.
fn footprints(count: u32) -> Vec<(u32, Aabb)> {
    let mut state = 0x9e37_79b9_7f4a_7c15_u64;
    let mut random = || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
        (state >> 11) as f64 / (1_u64 << 53) as f64
    };
    (0..count)
        .map(|item| {
            let (z, turn) = (2.0 * random() - 1.0, std::f64::consts::TAU * random());
            let from_axis = (1.0 - z * z).sqrt();
            let center = 3.4e6 * DVec3::new(from_axis * turn.cos(), from_axis * turn.sin(), z);
            let half = DVec3::splat(1e3 * 300.0_f64.powf(random().powi(2)));
            (item, Aabb::new(center - half, center + half))
        })
        .collect()
}

/// Renumbered, items are those they were, in the order of a walk; and can be found, moved and removed as before.
#[test]
fn numbers_follow_the_walk() {
    let items = footprints(500);
    let mut tree = Bvh::build(items.iter().map(|&(item, bounds)| (7 * item + 3, bounds)));
    for item in (0..500).step_by(3) {
        tree.remove(7 * item + 3);
    }
    tree.insert(9_999, items[0].1);
    let (before, boxes) = (tree.clone(), tree.len());
    let numbers = tree.renumber();
    check_shape(&tree);
    assert_eq!((numbers.len(), tree.cost()), (boxes, before.cost()));
    for (item, number) in (0..).zip(&numbers) {
        assert_eq!(tree.get(item), before.get(*number), "{item}");
    }
    let mut walked = Vec::new();
    tree.visit(|_| true, |item| walked.push(item));
    assert!(walked.iter().copied().eq(0..u32::try_from(boxes).unwrap()), "{walked:?}");
    assert!(tree.remove(0) && !tree.remove(9_999));
    tree.insert(5, items[1].1);
    check_shape(&tree);
    assert_eq!((tree.len(), tree.get(5)), (boxes - 1, Some(items[1].1)));
}

#[test]
fn ten_thousand_insertions_are_as_good_as_a_fresh_tree() {
    let items = footprints(10_000);
    let start = std::time::Instant::now();
    let mut grown = Bvh::default();
    for &(item, bounds) in &items {
        grown.insert(item, bounds);
    }
    let growing = start.elapsed();
    let built = Bvh::build(items);
    let building = start.elapsed() - growing;
    check_shape(&grown);
    check_shape(&built);
    let (grown, built) = (grown.cost(), built.cost());
    assert!(
        grown < 1.15 * built,
        "inserted {grown:.2} in {growing:?}, built {built:.2} in {building:?}"
    );
}

#[test]
fn an_empty_tree_finds_nothing() {
    let mut tree = Bvh::default();
    assert!(tree.bounds().is_empty() && tree.is_empty() && !tree.remove(3));
    assert_eq!((tree.cost(), tree.get(0)), (0.0, None));
    tree.insert(3, Aabb::new(DVec3::ZERO, DVec3::ONE));
    assert!(tree.remove(3) && tree.is_empty() && tree.root.is_none());
    assert_eq!(Bvh::build([]), Bvh::default());
    assert_eq!(serde_json::from_str::<Bvh>("[]").unwrap(), Bvh::default());
}

#[test]
fn nodes_that_are_no_tree_are_refused() {
    let leaf = r#"{"item":1,"bounds":{"min":[0,0,0],"max":[1,1,1]}}"#;
    let bad = leaf.replace("[1,1,1]", "[1,-1,1]");
    let stored = [
        "[null]".to_owned(),
        format!("[{leaf},{leaf}]"),
        format!("[null,{leaf}]"),
        format!("[null,{leaf},{leaf}]"),
        format!("[{leaf},null]"),
        format!("[{bad}]"),
    ];
    for stored in stored {
        assert!(serde_json::from_str::<Bvh>(&stored).is_err(), "{stored}");
    }
}

proptest! {
    #[test]
    fn a_query_finds_what_brute_force_finds(
        changes in prop::collection::vec((0..40_u32, any_box(), any::<bool>()), 0..120),
        query in any_box(),
    ) {
        let mut tree = Bvh::default();
        let mut brute = BTreeMap::new();
        for (item, bounds, remove) in changes {
            if remove {
                prop_assert_eq!(tree.remove(item), brute.remove(&item).is_some());
            } else {
                tree.insert(item, bounds);
                brute.insert(item, bounds);
            }
        }
        check_shape(&tree);
        let expected: Vec<u32> = brute
            .iter()
            .filter(|(_, bounds)| bounds.meets(&query))
            .map(|(&item, _)| item)
            .collect();
        prop_assert_eq!(tree.meeting(&query), expected.clone());
        let built = Bvh::build(brute);
        check_shape(&built);
        prop_assert_eq!(built.meeting(&query), expected);
        prop_assert_eq!(&built, &tree);

        let text = serde_json::to_string(&tree).unwrap();
        let read: Bvh = serde_json::from_str(&text).unwrap();
        check_shape(&read);
        prop_assert_eq!(&read, &tree);
        // Rotations may have left the order of children to memory, not to the shape.
        prop_assert!((read.cost() - tree.cost()).abs() < 1e-9);
    }
}

/// Every branch knows the largest of its items, through all changes and when it is read back.
#[test]
fn branches_know_their_largest_item() {
    // Of every third it is said how large they are.
    let extent = |item: u32| f64::from(item * 17 % 29);
    let say =
        |tree: &mut Bvh| (0..400).step_by(3).for_each(|item| tree.set_extent(item, extent(item)));
    fn check(tree: &Bvh, index: usize, extent: impl Fn(u32) -> f64 + Copy) -> f64 {
        let Branch { bounds, largest_m, parts } = tree.branch(index);
        let largest = match parts {
            Parts::Item(item) => {
                assert_eq!(tree.get(item), Some(bounds));
                if item % 3 == 0 { extent(item) } else { bounds.diagonal() }
            }
            Parts::Branches(children) => children
                .map(|child| {
                    assert!(bounds.contains(&tree.branch(child).bounds));
                    check(tree, child, extent)
                })
                .into_iter()
                .fold(0.0, f64::max),
        };
        assert_eq!(largest_m, largest);
        largest
    }
    let made = |number: u32| {
        let place = DVec3::new(
            f64::from(number * 7919 % 1000),
            f64::from(number * 104_729 % 1000),
            f64::from(number % 10),
        );
        Aabb::new(place, place + DVec3::splat(f64::from(number * 31 % 17)))
    };
    let mut tree = Bvh::build((0..100).map(|number| (number, made(number))));
    for number in 0..300 {
        tree.insert(100 + number, made(100 + number));
        tree.remove(number * 13 % (100 + number));
        // What is inserted anew is as large as its box.
        say(&mut tree);
        check(&tree, tree.trunk().unwrap(), extent);
    }
    let json = serde_json::to_string(&tree).unwrap();
    let mut again: Bvh = serde_json::from_str(&json).unwrap();
    say(&mut again);
    check(&again, again.trunk().unwrap(), extent);
}

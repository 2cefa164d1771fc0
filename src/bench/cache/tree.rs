//! The tree over the datasets: as many boxes as there may be, and as many changes.

use std::time::Instant;

use areoid_formats::bounds::Aabb;
use areoid_formats::bvh::Bvh;
use glam::DVec3;
use serde_json::json;

use super::Setting;
use super::planet::body;
use crate::bench::report::{Chapter, Relation, Table, Target};

const BOXES: [u32; 3] = [10_000, 100_000, 1_000_000];

/// Insertions and removals, in turn.
const CHANGES: u32 = 10_000;

/// The cost of a query over that of a tree built anew.
const MOST_COST: f64 = 1.5;

/// Queries whose nodes are counted.
const QUERIES: u32 = 200;

pub(super) fn measure(setting: Setting) -> Chapter {
    let (mut rows, mut data, mut targets) = (Vec::new(), Vec::new(), Vec::new());
    for full in BOXES {
        let count = setting.count(full);
        let start = Instant::now();
        let mut tree = Bvh::build((0..count).map(|number| (number, patch(number))));
        let built_s = start.elapsed().as_secs_f64();
        let changes = setting.count(CHANGES);
        let start = Instant::now();
        for change in 0..changes {
            // Away with one, and another to somewhere else.
            tree.remove(chosen(change, count));
            tree.insert(count + change, patch(count + change));
        }
        let change_us = start.elapsed().as_secs_f64() * 1e6 / f64::from(2 * changes);
        let left: Vec<_> =
            (0..count + changes).filter_map(|item| Some((item, tree.get(item)?))).collect();
        let fresh = Bvh::build(left);
        let cost = tree.cost() / fresh.cost();
        let (nodes, found) = (queries(&tree), queries(&fresh));
        // An inner node less than there are leaves is the least that any tree opens.
        let least = found.1.max(1) as f64;
        rows.push(vec![
            count.to_string(),
            format!("{built_s:.2}"),
            format!("{change_us:.1}"),
            format!("{cost:.3}"),
            format!("{:.3}", nodes.0 as f64 / found.0 as f64),
            format!("{:.2}", nodes.0 as f64 / least),
        ]);
        targets.push(Target::new(
            format!("cost after changes over a fresh tree's, {count} boxes"),
            Relation::AtMost,
            MOST_COST,
            Some(cost),
        ));
        data.push(json!({
            "boxes": count, "changes": 2 * changes, "built_s": built_s, "change_us": change_us,
            "cost_over_fresh": cost, "nodes_over_fresh": nodes.0 as f64 / found.0 as f64,
            "nodes_over_found": nodes.0 as f64 / least,
        }));
    }
    let head = vec!["boxes", "built s", "µs a change", "cost", "nodes", "nodes over found"];
    Chapter {
        name: "tree",
        title: "The tree over the datasets",
        notes: vec![
            "Boxes of small patches all over a planet; then as many are removed as others come. \
             *Cost* is the surface area heuristic's over that of a tree built anew of the same boxes, \
             *nodes* the nodes that queries for small regions open over that tree's, and over the \
             boxes that they find."
                .to_owned(),
        ],
        tables: vec![Table { title: "Boxes, and changes of them".to_owned(), head, rows }],
        targets,
        data: json!(data),
    }
}

/// One of the first `count`, each once for as long as there are.
fn chosen(change: u32, count: u32) -> u32 {
    // Coprime to all counts that are no multiple of it.
    u32::try_from(u64::from(change) * 7919 % u64::from(count)).unwrap_or(0)
}

/// A box of some kilometers on the sphere.
fn patch(number: u32) -> Aabb {
    let spread = |salt: u64| {
        let page = areoid_formats::address::PageAddress::new(
            areoid_formats::address::Level(u8::try_from(salt).unwrap_or(0)),
            number,
            17,
        );
        super::planet::chance(page)
    };
    let (turn, sine) = (std::f64::consts::TAU * spread(1), 2.0 * spread(2) - 1.0);
    let cosine = (1.0 - sine * sine).max(0.0).sqrt();
    let center =
        body().ellipsoid.a().0 * DVec3::new(cosine * turn.cos(), cosine * turn.sin(), sine);
    let half = DVec3::splat(1e3 * 30.0_f64.powf(spread(3)));
    Aabb::new(center - half, center + half)
}

/// Nodes that small queries all over the planet open, and boxes that they find.
fn queries(tree: &Bvh) -> (u64, u64) {
    let (mut opened, mut found) = (0, 0);
    for number in 0..QUERIES {
        let region = patch(3_000_000_000 + number);
        let center = region.center();
        let region = Aabb::new(center - DVec3::splat(2e5), center + DVec3::splat(2e5));
        tree.visit(
            |bounds| {
                opened += 1;
                bounds.meets(&region)
            },
            |_| found += 1,
        );
    }
    (opened, found)
}

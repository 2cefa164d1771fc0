//! Pages and heights that are asked for by name and place, beside those that views want.

use super::*;

/// Pages by name, one after another and beside a session that flies on.
#[test]
fn single_pages_are_loaded_for_whoever_asks() {
    let globe = Gated::globe();
    let cache = globe.cache(PLENTY, 2);
    let mut session = cache.session();
    for (step, entry) in globe.entries.iter().enumerate().take(60) {
        session.update(&view(6.0 * step as f64, 20.0, 3e5, 30.0));
        let page = cache.wait_for(cache.page(0, entry.page)).unwrap().unwrap();
        assert_eq!((page.dataset, page.entry.page), (0, entry.page));
        let truth = globe.archive.page(entry).unwrap();
        assert_eq!(page.page.texels(), truth.texels());
        assert!(Arc::ptr_eq(&page, &cache.resident(0, entry.page).unwrap()));
    }
    let nowhere = PageAddress::new(Level(0), 9, 9);
    assert!(cache.wait_for(cache.page(0, nowhere)).unwrap().is_none());
    let error = cache.wait_for(cache.page(7, nowhere)).unwrap_err();
    assert!(matches!(error, crate::PageError::NoSuchDataset(7)), "{error}");
    drop(session);
    let held = globe.cache(PAGE / 2, 1);
    let error = held.wait_for(held.page(0, globe.entries[0].page)).unwrap_err();
    assert!(matches!(error, crate::PageError::NoRoom { .. }), "{error}");
}

/// The height of what is drawn is within both bounds of that of the finest data, which is what a query
/// of the archives answers.
#[test]
fn a_selection_knows_heights_as_well_as_it_says() {
    use areoid_formats::query::HeightQuery;
    let (globe, cap) = (Gated::globe(), Gated::new("cap", cap(), Kind::Height));
    let cache = globe.cache(PLENTY, 2);
    cache.insert(cap.info.clone(), Arc::clone(&cap.archive) as _).unwrap();
    let mut session = cache.session();
    let archives = [&*globe.archive, &*cap.archive];
    let mut query = HeightQuery::new(archives, None);
    let (mut found, mut coarse) = (0, 0);
    for step in 0..60 {
        let (longitude, latitude) = (6.1 * f64::from(step), 60.0 + 0.49 * f64::from(step));
        let position = Geographic::from_degrees(Degrees(longitude), Degrees(latitude));
        let selection = session.settle(&view(longitude, latitude, 8e5, 0.0));
        let drawn = selection.height(position);
        let exact = cache.wait_for(cache.exact_height(position)).unwrap();
        let truth = query.height(position).unwrap();
        match (&exact, truth) {
            (Some(exact), Some(truth)) => {
                assert!((exact.height_m - truth.height_m).abs() < 1e-9);
                assert_eq!((exact.bound_m, &exact.datasets), (truth.bound_m, &truth.datasets));
            }
            (None, None) => {}
            other => panic!("{other:?}"),
        }
        if let (Some(drawn), Some(exact)) = (drawn, exact) {
            // These planets' texels are not those that their bounds are of: the figures are all there is
            // to compare.
            assert!(drawn.bound_m >= exact.bound_m);
            coarse += u32::from(drawn.bound_m > 0.0);
            found += 1;
        }
    }
    assert!(found > 20 && coarse > 0, "{found} {coarse}");
}

/// Of pages over one another the finest answers.
#[test]
fn a_height_is_that_of_the_finest_page() {
    let globe = Gated::globe();
    let cache = globe.cache(PLENTY, 2);
    let settled = cache.session().settle(&view(0.0, 0.0, 1e7, 0.0));
    let grid = &globe.info.grid;
    let finest = grid.pyramid().finest();
    let mut found = 0;
    for entry in globe.entries.iter().filter(|entry| entry.page.level == finest).take(40) {
        let mut lineage: Vec<_> =
            std::iter::successors(Some(entry.page), |page| page.parent()).collect();
        lineage.reverse();
        let load = |page: PageAddress| cache.wait_for(cache.page(0, page)).unwrap().unwrap();
        let select = |pages: &[PageAddress]| Selection {
            generation: 0,
            scene: 0,
            datasets: settled.datasets.clone(),
            pages: pages.iter().map(|page| load(*page)).collect(),
            missing: 0,
            roots: Vec::new(),
            beneath: Vec::new(),
            failed: Vec::new(),
            tolerance_px: 1.0,
            error_px: 1.0,
            visited: 0,
            wanted: 0,
            culled: 0,
        };
        let interior = f64::from(grid.pyramid().interior());
        let [x, y] = [entry.page.col, entry.page.row].map(|at| (f64::from(at) + 0.5) * interior);
        let place = areoid_formats::grid::TexelPoint { x, y };
        let position = grid.geographic_from_texel(finest, place).unwrap();
        let all = select(&lineage).height(position).unwrap();
        let alone = select(&[entry.page]).height(position).unwrap();
        let above = select(&lineage[..lineage.len() - 1]).height(position).unwrap();
        assert_eq!((all.height_m, all.bound_m), (alone.height_m, alone.bound_m));
        assert!(above.bound_m > alone.bound_m);
        found += 1;
    }
    assert_eq!(found, 40);
}

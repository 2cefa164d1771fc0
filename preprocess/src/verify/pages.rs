//! Laws 2, 3 and 4: a page held against its children, its neighbors and its own texels.

use std::collections::HashMap;

use areoid_formats::address::PageAddress;
use areoid_formats::archive::{ArchiveError, PageEntry};
use areoid_formats::page::{Kind, Page, Texels};
use areoid_formats::pyramid::Pyramid;

use super::reader::Reader;
use crate::border::Border;
use crate::texel::{Planes, Texel};
use crate::tile::Tile;

/// Laws 2, 3 and 4 for one page.
pub(super) fn check_page(
    reader: &Reader<'_>,
    entry: &PageEntry,
) -> Result<Vec<String>, ArchiveError> {
    let pyramid = reader.pyramid();
    let name = reader.name(entry.page);
    let mut problems = Vec::new();
    let Some(page) = reader.page(entry.page)? else { return Ok(problems) };

    let within = |outer: (f32, f32), inner: (f32, f32)| {
        inner.0.is_nan() || outer.0 <= inner.0 && inner.1 <= outer.1
    };
    for child in pyramid.children(entry.page).filter_map(|child| reader.entries.get(&child)) {
        if entry.bound.is_nan() || entry.bound < child.bound {
            let (bound, below) = (entry.bound, child.bound);
            problems.push(format!("law 2: bound {bound} of {name} is below a child's, {below}"));
        }
        let nested = within((entry.min, entry.max), (child.min, child.max))
            && within((entry.lowest, entry.highest), (child.lowest, child.highest));
        if !nested {
            problems.push(format!("law 2: the range of {name} does not contain a child's"));
        }
    }

    if entry.page.level == pyramid.finest() {
        let (min, max) = range(&page, pyramid.interior_size(entry.page));
        let same = |one: f32, other: f32| one.to_bits() == other.to_bits() || one == other;
        if !(min.is_nan() && entry.min.is_nan() || same(min, entry.min) && same(max, entry.max)) {
            let (least, greatest) = (entry.min, entry.max);
            problems.push(format!(
                "law 4: {name} says {least} to {greatest}, its valid texels are {min} to {max}"
            ));
        }
    }
    if reader.archive.description().kind == Kind::Normal && !all_say_something(&page) {
        problems.push(format!("law 4: {name} has the code of no data in a valid normal"));
    }
    if !matches_extension(reader, entry.page, &page)? {
        problems.push(format!("law 3: {name} is not its window of the extended level"));
    }
    Ok(problems)
}

/// Least and greatest valid texel of the interior, over channels.
fn range(page: &Page, (rows, cols): (u32, u32)) -> (f32, f32) {
    let mut range = (f32::NAN, f32::NAN);
    for row in 1..=rows as usize {
        for col in 1..=cols as usize {
            if page.coverage_at(row, col) != 0 {
                for channel in texel(page, row * page.side() + col) {
                    range = (range.0.min(channel), range.1.max(channel));
                }
            }
        }
    }
    range
}

/// Whether no valid texel has the code that normals keep for where there is none.
fn all_say_something(page: &Page) -> bool {
    let is_valid = |at: usize| page.coverage().is_none_or(|coverage| coverage[at] != 0);
    let mut valid = (0..page.side() * page.side()).filter(|&at| is_valid(at));
    valid.all(|at| texel(page, at).iter().all(|&code| code != 0.0))
}

/// The channels of a texel.
fn texel(page: &Page, at: usize) -> Vec<f32> {
    match page.texels() {
        Texels::Height(heights) => vec![heights[at]],
        Texels::Color(colors) => colors[at].map(f32::from).to_vec(),
    }
}

/// Whether a page equals, bit for bit, what is cut from the interiors of the pages it draws on.
fn matches_extension(
    reader: &Reader<'_>,
    address: PageAddress,
    page: &Page,
) -> Result<bool, ArchiveError> {
    match page.texels() {
        Texels::Height(_) => matches_extension_of::<f32>(reader, address, page),
        Texels::Color(_) => matches_extension_of::<u8>(reader, address, page),
    }
}

fn matches_extension_of<S: Texel>(
    reader: &Reader<'_>,
    address: PageAddress,
    page: &Page,
) -> Result<bool, ArchiveError> {
    let pyramid = reader.pyramid();
    let mut tiles: HashMap<PageAddress, Tile<S>> = HashMap::new();
    for source in pyramid.sources(address, Pyramid::BORDER) {
        match reader.page(source)? {
            Some(page) => {
                drop(tiles.insert(source, interior(&page, pyramid.interior_size(source))))
            }
            // Nothing can be said of a page beside a damaged one.
            None if reader.entries.contains_key(&source) => return Ok(true),
            None => {}
        }
    }
    let quantum = reader.archive.description().quantum;
    let border = Border::around(pyramid, address, |source| tiles.get(&source), quantum);
    let mut cut = interior::<S>(page, pyramid.interior_size(address));
    cut.close(&border);
    let all =
        |code: u8| cut.coverage.as_ref().is_some_and(|codes| codes.iter().all(|&c| c == code));
    if all(0) {
        return Ok(false);
    }
    let coverage = if all(u8::MAX) { None } else { cut.coverage.as_deref() };
    if coverage != page.coverage() {
        return Ok(false);
    }
    Ok((0..page.side() * page.side()).all(|at| {
        if page.coverage().is_some_and(|coverage| coverage[at] == 0) {
            return true;
        }
        let stored = texel(page, at);
        stored.iter().zip(&cut.planes).all(|(&t, plane)| f64::from(t) == plane[at].into())
    }))
}

/// The interior of a page inside the outline, the border left blank.
fn interior<S: Texel>(page: &Page, (rows, cols): (u32, u32)) -> Tile<S> {
    let planes = match page.texels() {
        Texels::Height(heights) => Planes::Height(heights.clone()),
        Texels::Color(colors) => {
            Planes::Color([0, 1, 2].map(|channel| colors.iter().map(|c| c[channel]).collect()))
        }
    };
    let planes = S::channels(planes, page.coverage());
    let blank = Tile::<S>::blank(page.side(), (rows as usize, cols as usize));
    let mut tile = Tile { planes: blank.planes.clone(), ..blank };
    let mut codes = vec![0; page.side() * page.side()];
    for row in 0..tile.rows {
        let row = tile.row(row);
        for (to, from) in tile.planes.iter_mut().zip(&planes) {
            to[row.clone()].copy_from_slice(&from[row.clone()]);
        }
        match page.coverage() {
            Some(coverage) => codes[row.clone()].copy_from_slice(&coverage[row]),
            None => codes[row].fill(u8::MAX),
        }
    }
    tile.coverage = Some(codes);
    tile
}

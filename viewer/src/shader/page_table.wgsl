// page_table.wgsl - which texels of the atlas show a place of a dataset.
//
// The table is a list of integers. Each dataset has a window for every level: a rectangle of pages
// about those that are in memory, as wide as it must be. (A dense table of a planet at 0.25 m a
// texel would have 5·10^10 entries.)
//
//   window   row, column, rows, columns, where its entries start
//   entry    31      30      29    24 23   16  15     14     0
//            +-------+-------+-------+-------+------+---------+
//            | holds | whole | shown | level | gray |  slot   |
//            +-------+-------+-------+-------+------+---------+
//
// An entry names the finest page in memory that covers its place and is not finer than its level:
// the page itself, or an ancestor. Outside a level's window the coarser levels are asked, and where
// none of them has a page, the finer ones: a view may need fine pages for their error alone, and
// show them from so far that coarser ones would do. Where there is none at all, the coarsest level's
// pages show, which have a list of their own.
//
// gray: the slot is one of the atlas of grays, in which fully covered colors lie whose channels are equal.
//
// shown: 63 where the page shows wholly; less, where the coarser one before it still does.
//
// Mirrored   atlas/table.rs, which writes it; its test reads it back through this file

@group(0) @binding(4) var<storage, read> table: array<i32>;

const HOLDS: u32 = 0x80000000u;
const WHOLE: u32 = 0x40000000u;
const GRAY: u32 = 0x8000u;

// A page in the atlas and a place in it.
struct Found {
    entry: u32,
    // The upper left of the four texels about the place, in the page's window.
    tap: vec2i,
    // The place between their centers: whole and fraction stay apart, for a texel may be thousands of
    // pixels wide.
    t: vec2f,
}

fn entry_slot(entry: u32) -> i32 {
    return i32(entry & (GRAY - 1u));
}

fn entry_level(entry: u32) -> i32 {
    return i32((entry >> 16u) & 0xffu);
}

fn entry_presence(entry: u32) -> f32 {
    return f32((entry >> 24u) & 0x3fu) / 63.0;
}

// The size of a level of `halvings` above the finest, rounded up.
fn level_size(size: i32, halvings: u32) -> i32 {
    return i32((u32(size) + (1u << halvings) - 1u) >> halvings);
}

// The page of `level` that holds a place.
fn page_of(dataset: Dataset, point: MapPoint, level: i32) -> vec2i {
    let halvings = u32(dataset.levels - 1 - level);
    let pages = (vec2i(level_size(dataset.size.x, halvings), level_size(dataset.size.y, halvings)) + dataset.interior - 1) / dataset.interior;
    let cell = vec2i(point.texel.x >> halvings, point.texel.y >> halvings);
    return min(cell / dataset.interior, pages - 1);
}

// Where the entry of a place at a level stands in the table, or below 0 outside the level's window.
fn entry_place(dataset: Dataset, point: MapPoint, level: i32) -> i32 {
    let header = dataset.first_window + 5 * level;
    let page = page_of(dataset, point, level);
    let row = page.y - table[header];
    var column = page.x - table[header + 1];
    if column < 0 && dataset.wraps != 0 {
        let halvings = u32(dataset.levels - 1 - level);
        column += (level_size(dataset.size.x, halvings) + dataset.interior - 1) / dataset.interior;
    }
    let columns = table[header + 3];
    if row >= 0 && row < table[header + 2] && column >= 0 && column < columns {
        return table[header + 4] + row * columns + column;
    }
    return -1;
}

// The finest page in memory at most as fine as `level`, or else the coarsest that is finer, or else the
// root; its entry is 0 if there is none.
fn find_page(dataset: Dataset, point: MapPoint, level: i32) -> Found {
    var entry = 0u;
    for (var asked = min(level, dataset.deepest); asked >= 0; asked--) {
        let place = entry_place(dataset, point, asked);
        if place >= 0 {
            entry = u32(table[place]);
            break;
        }
    }
    for (var asked = level + 1; asked <= dataset.deepest && (entry & HOLDS) == 0u; asked++) {
        let place = entry_place(dataset, point, asked);
        if place >= 0 {
            entry = u32(table[place]);
        }
    }
    if (entry & HOLDS) == 0u && dataset.roots >= 0 {
        let width = level_size(dataset.size.x, u32(dataset.levels - 1));
        let page = page_of(dataset, point, 0);
        entry = u32(table[dataset.roots + page.y * ((width + dataset.interior - 1) / dataset.interior) + page.x]);
    }
    if (entry & HOLDS) == 0u {
        return Found(0u, vec2i(0), vec2f(0.0));
    }
    let found = entry_level(entry);
    let halvings = u32(dataset.levels - 1 - found);
    let page = page_of(dataset, point, found);
    let cell = vec2i(point.texel.x >> halvings, point.texel.y >> halvings) - page * dataset.interior;
    let below = point.texel & vec2i((1 << halvings) - 1);
    let rest = (vec2f(below) + point.fraction) / f32(1u << halvings);
    // The border puts cell (0, 0) at texel (1, 1).
    let past_center = rest >= vec2f(0.5);
    let tap = clamp(cell + vec2i(past_center), vec2i(0), vec2i(dataset.interior));
    return Found(entry, tap, select(rest + 0.5, rest - 0.5, past_center));
}

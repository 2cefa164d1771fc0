// map.wgsl - texels of a dataset from a frame and an offset, by exact differences.
//
// With r the distance from the axis and z the height over the equator of a unit normal, n0 = (r0,
// z0) the frame's and n = n0 + d:
//
//   X = r0 + dX, Y = d.east    horizontally, along the frame's meridian and across it
//   longitude - longitude0     = atan2(Y, X)
//   sin(latitude - latitude0)  = q (dz r0 - z0 dr), cos(..) = r r0 + q² z z0, to a common factor
//   T = (X, Y) / (m + q z)     tan of half the colatitude, as a vector; m = |(r, q z)|
//
// q is 1, or (b / a)² where the map's latitudes are planetocentric. Each difference is written so
// that no two large numbers are subtracted; at a pole, where r0 = 0, they still hold.
//
// Units      texels of the finest level, whole and fraction apart: f32 alone has too few digits
// Precision  the offset's relative rounding, 1e-6, times the offset in texels; plus 2^-24 texels
// Mirrored   struct Dataset, struct Anchor <-> viewer/src/mirror.rs, made by map.rs
// After      J. P. Snyder, Map Projections: A Working Manual, sections 12 and 21

struct Dataset {
    // Texels of the finest level.
    size: vec2i,
    // Side of a page without its border.
    interior: i32,
    levels: i32,
    // Where its windows start in the page table.
    first_window: i32,
    // Equal for datasets that are blended; higher covers lower.
    priority: i32,
    // Whether polar stereographic; else equirectangular.
    polar: i32,
    // Whether rows close around the body.
    wraps: i32,
    // Texels to a turn, or 0.
    period: f32,
    // q, above.
    latitude_ratio: f32,
    // 1 for a map of the north pole, -1 for one of the south.
    hemisphere: f32,
    // First eccentricity of the map's ellipsoid.
    eccentricity: f32,
    // a and a (1 - e²) of the body over the texels of a unit of the map: ground meters.
    ground: vec2f,
    // The user's, above 0 and at most 1.
    weight: f32,
    // Equal for states of one thing, or 0.
    series: u32,
    // Where the page table has the entries of the coarsest level, for places of which it knows no other;
    // or below 0.
    roots: i32,
    // The finest level that the page table knows pages of.
    deepest: i32,
    // 1 where the top edge is the north pole, and 2 where the bottom edge is the south pole.
    poles: u32,
    // Whose it is; told by a color.
    number: u32,
    // Of heights in the list of colors: the first of their ramp's stops, and how many there are.
    stops: vec2u,
}

struct Anchor {
    // The frame in the finest level: whole texels, and the rest in [0, 1).
    texel: vec2i,
    fraction: vec2f,
    // Texels from differences, row by row.
    matrix: vec4f,
    // Whose texels they are.
    dataset: u32,
    pad0: u32,
    pad1: u32,
    pad2: u32,
}

// A place in the finest level.
struct MapPoint {
    texel: vec2i,
    fraction: vec2f,
    inside: bool,
}

@group(0) @binding(2) var<storage, read> dataset_list: array<Dataset>;
@group(0) @binding(3) var<storage, read> anchors: array<Anchor>;

fn series_atanh(v: f32) -> f32 {
    if abs(v) > 0.1 {
        return 0.5 * log((1.0 + v) / (1.0 - v));
    }
    let v2 = v * v;
    return v * (1.0 + v2 * (1.0 / 3.0 + v2 * (0.2 + v2 / 7.0)));
}

fn series_expm1(v: f32) -> f32 {
    if abs(v) > 0.1 {
        return exp(v) - 1.0;
    }
    return v * (1.0 + v * (0.5 + v * (1.0 / 6.0 + v * (1.0 / 24.0 + v / 120.0))));
}

// The differences of the map: radians of longitude and latitude, or of T E along the frame's
// meridian and across, in units of the frame's E.
fn map_offset(dataset: Dataset, r0: f32, z0: f32, d: vec3f) -> vec2f {
    let q = dataset.latitude_ratio;
    let dx = d.z * r0 - d.y * z0;
    let dz = d.y * r0 + d.z * z0;
    let x = r0 + dx;
    let y = d.x;
    let r = sqrt(x * x + y * y);
    let z = z0 + dz;

    if dataset.polar == 0 {
        let sum = r + r0;
        let dr = select((dx * (2.0 * r0 + dx) + y * y) / sum, 0.0, sum == 0.0);
        return vec2f(angle_of(y, x), angle_of(q * (dz * r0 - z0 * dr), r * r0 + q * q * z * z0));
    }

    let flat = 1.0 - q * q;
    let m0 = sqrt(1.0 - flat * z0 * z0);
    let m = sqrt(1.0 - flat * z * z);
    let dm = -flat * dz * (2.0 * z0 + dz) / (m + m0);
    let pole = dataset.hemisphere * q;
    let below0 = m0 + pole * z0;
    let dbelow = dm + pole * dz;
    let below = below0 + dbelow;
    let t0 = r0 / below0;
    let dt = vec2f((dx * below0 - r0 * dbelow) / (below * below0), y / below);

    let s0 = pole * z0 / m0;
    let s = pole * z / m;
    let ds = pole * (dz * m0 - z0 * dm) / (m * m0);
    let e = dataset.eccentricity;
    let stretch = series_expm1(e * series_atanh(e * ds / (1.0 - e * e * s * s0)));
    return dt + (dt + vec2f(t0, 0.0)) * stretch;
}

fn map_point(dataset: Dataset, anchor: Anchor, r0: f32, z0: f32, d: vec3f) -> MapPoint {
    let difference = map_offset(dataset, r0, z0, d);
    let row_x = dot(anchor.matrix.xy, difference);
    let row_y = dot(anchor.matrix.zw, difference);
    var point = clamp(anchor.fraction + vec2f(row_x, row_y), vec2f(-1e9), vec2f(1e9));
    if dataset.period > 0.0 && dataset.wraps == 0 {
        // The turn in which the point is nearest to the outline's middle.
        let middle = f32(anchor.texel.x) + point.x - 0.5 * f32(dataset.size.x);
        if abs(middle) > 0.5 * dataset.period {
            point.x -= sign(middle) * dataset.period;
        }
    }
    let whole = floor(point);
    var texel = anchor.texel + vec2i(whole);
    var fraction = point - whole;
    if dataset.wraps != 0 {
        texel.x -= dataset.size.x * i32(floor(f32(texel.x) / f32(dataset.size.x)));
        if texel.x < 0 {
            texel.x += dataset.size.x;
        }
        if texel.x >= dataset.size.x {
            texel.x -= dataset.size.x;
        }
    }
    let last = dataset.size;
    let below = texel.x < last.x || (texel.x == last.x && fraction.x == 0.0);
    let above = texel.y < last.y || (texel.y == last.y && fraction.y == 0.0);
    var inside = below && above && texel.x >= 0 && texel.y >= 0;
    // Rounding leaves a map by less than this at a pole.
    let is_beyond_top = (dataset.poles & 1u) != 0u && texel.y == -1;
    let is_beyond_bottom = (dataset.poles & 2u) != 0u && texel.y == last.y;
    if dataset.wraps != 0 && !inside && (is_beyond_top || is_beyond_bottom) {
        inside = true;
        fraction.y = select(0.0, fraction.y, texel.y >= 0 && texel.y < last.y);
        texel.y = clamp(texel.y, 0, last.y);
    }
    return MapPoint(texel, fraction, inside);
}

// Ground meters to a texel of the finest level along the two principal directions, larger first.
// Polar maps with unequal pixel sizes are taken as aligned with the meridian.
fn principal_scales(dataset: Dataset, r: f32, z: f32) -> vec2f {
    let q = dataset.latitude_ratio;
    let w = sqrt(1.0 - scene.eccentricity2 * z * z);
    // dφ of the body to the map's.
    let graphic = r * r / q + q * z * z;
    var scales = dataset.ground * vec2f(1.0, graphic) / vec2f(w, w * w * w);
    if dataset.polar == 0 {
        scales.x *= r;
    } else {
        let m = sqrt(r * r + q * q * z * z);
        let s = dataset.hemisphere * q * z / m;
        let e = dataset.eccentricity;
        let stretch = exp(e * (series_atanh(e * s) - series_atanh(e)));
        let curvatures = (1.0 - e * e) / (1.0 - e * e * s * s);
        scales *= vec2f(m, 1.0 / curvatures) * ((1.0 + s) / stretch);
    }
    return vec2f(max(scales.x, scales.y), min(scales.x, scales.y));
}

// The weight q of a dataset in a composition: `Grid::quality`.
fn quality_of(scales: vec2f) -> f32 {
    let evenness = max(scales.y / scales.x, 9.5367431640625e-7);
    return evenness / (scales.x * scales.x);
}

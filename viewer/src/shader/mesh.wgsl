// mesh.wgsl - vertices of the patches, and what the deferred buffer keeps of them.
//
//   start        middle        end
//     +---+---+---+---+---+---+---+       own numbers 0 .. SEGMENTS
//     first .............. last           a side runs over all of the edge, or one half of it, in
//                                         either direction; on a half, odd vertices fall on even
//
// A vertex of an odd number is one that the coarser mesh lacks. It comes from between its two even
// neighbors, as those are shown, to its own point: on a side as far as the edge's have come, which
// both neighbors agree on. When a patch splits, its children's vertices have come by 0: nothing moves.

@group(3) @binding(0) var<storage, read> points: array<vec4f>;

struct Vertex {
    @builtin(position) clip: vec4f,
    // Weights of the corners b and c.
    @location(0) weights: vec2f,
    // Ground meters to a texel of the level used.
    @location(1) texel_m: f32,
    @location(2) @interpolate(flat) patch_index: u32,
}

// Where a vertex lies on a side: the side's number or below 0, and the steps along it.
fn side_of(steps: vec2i) -> vec2i {
    if steps.y == 0 {
        return vec2i(0, steps.x);
    }
    if steps.x + steps.y == SEGMENTS {
        return vec2i(1, steps.y);
    }
    return select(vec2i(-1, 0), vec2i(2, SEGMENTS - steps.y), steps.x == 0);
}

// A point of an edge, as it is shown.
fn shown_on_edge(edge: u32, own: i32) -> vec4f {
    let at = edge_point(edge, own);
    let come = edges[edge].come;
    if (own & 1) == 0 || come >= 1.0 {
        return points[at];
    }
    let between = 0.5 * (points[at - 1u] + points[at + 1u]);
    return between + (points[at] - between) * come;
}

// The number on its edge of a vertex on a side; where a side is half an edge, odd steps fall on the
// one before them.
fn number_on_edge(part: Patch, side: i32, step: i32) -> i32 {
    let ends = (part.sides >> u32(4 * side)) & 0xfu;
    let first = i32(ends & 3u);
    let last = i32(ends >> 2u);
    let whole = select(step, step & ~1, abs(last - first) == 1);
    return (first * SEGMENTS + (last - first) * whole) / 2;
}

// Where a vertex of an edge stands on the chord of the half that it is on, 0 at the middle and 1 at the
// end: u of the whole chord's half is u tan α at the angle's tangent, with α the angle of the half, and
// the half's own chord is one of tangents about α / 2, whose own tangent is h.
fn share_of_half(edge: Edge, own: i32) -> f32 {
    let u = f32(abs(2 * own - SEGMENTS)) / f32(SEGMENTS);
    let h = edge.half_chord / (1.0 + edge.distance);
    return u * (1.0 + h * h) / (1.0 - h * h + 2.0 * u * h * h);
}

// A vertex of even steps, as it is shown.
fn shown_even(patch_index: u32, steps: vec2i) -> vec4f {
    let on_side = side_of(steps);
    if on_side.x < 0 {
        return points[patch_point(patch_index, steps)];
    }
    let part = patches[patch_index];
    return shown_on_edge(part.edges[on_side.x], number_on_edge(part, on_side.x, on_side.y));
}

// steps: segments from corner a toward b and toward c.
fn vertex_of(patch_index: u32, steps: vec2i) -> Vertex {
    let part = patches[patch_index];
    let on_side = side_of(steps);
    let side = on_side.x;
    var weights = vec2f(steps) / f32(SEGMENTS);
    var shown: vec4f;
    if side < 0 {
        shown = points[patch_point(patch_index, steps)];
        let odd = steps & vec2i(1);
        if any(odd == vec2i(1)) && part.come < 1.0 {
            // Toward b, toward c, or from one to the other.
            let way = select(odd, vec2i(1, -1), all(odd == vec2i(1)));
            let between = 0.5 * (shown_even(patch_index, steps - way) + shown_even(patch_index, steps + way));
            shown = between + (shown - between) * part.come;
        }
    } else {
        let ends = (part.sides >> u32(4 * side)) & 0xfu;
        let first = i32(ends & 3u);
        let own = number_on_edge(part, side, on_side.y);
        if abs(first - i32(ends >> 2u)) == 1 {
            let from_middle = share_of_half(edges[part.edges[side]], own);
            let share = select(1.0 - from_middle, from_middle, first == 1);
            weights = select(
                select(vec2f(0.0, 1.0 - share), vec2f(1.0 - share, share), side == 1),
                vec2f(share, 0.0),
                side == 0,
            );
        }
        shown = shown_on_edge(part.edges[side], own);
    }
    return Vertex(clip_from_eye(shown.xyz), weights, shown.w, patch_index);
}

@vertex
fn vertex(@location(0) steps: vec2i, @builtin(instance_index) patch_index: u32) -> Vertex {
    return vertex_of(patch_index, steps);
}

// Patch number plus 1, and bits of the weights and the texel: no place on the planet is rounded.
@fragment
fn fragment(in: Vertex) -> @location(0) vec4u {
    return vec4u(in.patch_index + 1u, bitcast<u32>(in.weights.x), bitcast<u32>(in.weights.y), bitcast<u32>(in.texel_m));
}

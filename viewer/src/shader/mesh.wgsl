// mesh.wgsl - vertices of the patches, and what the deferred buffer keeps of them.
//
// A vertex inside a patch is computed from the patch's frame. A vertex on a side is computed from
// the edge, of which both neighbors have the same one: a frame at its middle, the chord's direction
// there, and a whole number along it. At its ends and its middle the corners' own frames count, so
// that a finer neighbor's corner is this edge's middle to the bit.
//
//   start        middle        end
//     +---+---+---+---+---+---+---+       own numbers 0 .. SEGMENTS
//     first .............. last           a side runs over all of the edge, or one half of it, in
//                                         either direction; on a half, odd vertices fall on even
//
// A vertex of an odd number is one that the coarser mesh lacks. It comes from between its two even
// neighbors, as those are shown, to its own place: on a side as far as the edge's have come, which
// both neighbors agree on. When a patch splits, its children's vertices have come by 0: nothing moves.
//
// Mirrored   struct Edge, struct Patch <-> viewer/src/mirror.rs, made by mesh/patches.rs
// After      P-BDAM §4.2: what belongs to an edge depends on its corners and the eye alone

struct Edge {
    // Frames of its start, middle and end.
    frames: vec3u,
    // Half the length of the chord, on the unit sphere.
    half_chord: f32,
    // East and north of the middle's frame, from start to end.
    direction: vec2f,
    // From the center to the chord.
    distance: f32,
    // How far its odd vertices have come, 0 to 1.
    come: f32,
}

struct Patch {
    // The corners relative to the plane's point under the frame, in the frame's axes.
    corner_a: vec3f,
    frame: u32,
    corner_b: vec3f,
    // Four bits a side: first + 4 last, in halves of the edge.
    sides: u32,
    corner_c: vec3f,
    // From the center to the corners' plane, along the frame's normal.
    distance: f32,
    edges: vec3u,
    // How far its odd vertices inside have come, 0 to 1.
    come: f32,
}

@group(0) @binding(5) var<storage, read> edges: array<Edge>;
@group(0) @binding(6) var<storage, read> patches: array<Patch>;

override SEGMENTS: i32 = 16;

// A place: an offset from a frame.
struct Place {
    frame: u32,
    d: vec3f,
}

fn place_on_edge(edge: Edge, own: i32) -> Place {
    if own == 0 {
        return Place(edge.frames.x, vec3f(0.0));
    }
    if own == SEGMENTS {
        return Place(edge.frames.z, vec3f(0.0));
    }
    if 2 * own == SEGMENTS {
        return Place(edge.frames.y, vec3f(0.0));
    }
    let along = edge.half_chord * (f32(2 * own - SEGMENTS) / f32(SEGMENTS));
    return Place(edge.frames.y, offset_from_chord(edge.distance, vec3f(edge.direction * along, 0.0)));
}

fn place_in_patch(part: Patch, weights: vec2f) -> Place {
    let s = part.corner_a + weights.x * (part.corner_b - part.corner_a) + weights.y * (part.corner_c - part.corner_a);
    return Place(part.frame, offset_from_chord(part.distance, s));
}

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

// The places between which a vertex is shown: each of two even neighbors may lie between two itself.
struct Blend {
    places: array<Place, 7>,
    shares: array<f32, 7>,
    count: i32,
}

fn add_place(blend: ptr<function, Blend>, place: Place, share: f32) {
    if share > 0.0 {
        (*blend).places[(*blend).count] = place;
        (*blend).shares[(*blend).count] = share;
        (*blend).count += 1;
    }
}

fn add_on_edge(blend: ptr<function, Blend>, edge: Edge, own: i32, share: f32) {
    let come = select(1.0, edge.come, (own & 1) == 1);
    let between = 0.5 * (share - share * come);
    if between > 0.0 {
        add_place(blend, place_on_edge(edge, own - 1), between);
        add_place(blend, place_on_edge(edge, own + 1), between);
    }
    add_place(blend, place_on_edge(edge, own), share * come);
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
fn add_even(blend: ptr<function, Blend>, part: Patch, steps: vec2i, share: f32) {
    let on_side = side_of(steps);
    if on_side.x < 0 {
        add_place(blend, place_in_patch(part, vec2f(steps) / f32(SEGMENTS)), share);
    } else {
        let own = number_on_edge(part, on_side.x, on_side.y);
        add_on_edge(blend, edges[part.edges[on_side.x]], own, share);
    }
}

// steps: segments from corner a toward b and toward c.
fn vertex_of(patch_index: u32, steps: vec2i) -> Vertex {
    let part = patches[patch_index];
    let on_side = side_of(steps);
    let side = on_side.x;
    var weights = vec2f(steps) / f32(SEGMENTS);
    var blend: Blend;
    if side < 0 {
        let odd = steps & vec2i(1);
        let come = select(1.0, part.come, any(odd == vec2i(1)));
        if come < 1.0 {
            // Toward b, toward c, or from one to the other.
            let way = select(odd, vec2i(1, -1), all(odd == vec2i(1)));
            add_even(&blend, part, steps - way, 0.5 * (1.0 - come));
            add_even(&blend, part, steps + way, 0.5 * (1.0 - come));
        }
        add_place(&blend, place_in_patch(part, weights), come);
    } else {
        let ends = (part.sides >> u32(4 * side)) & 0xfu;
        let first = i32(ends & 3u);
        let edge = edges[part.edges[side]];
        let own = number_on_edge(part, side, on_side.y);
        if abs(first - i32(ends >> 2u)) == 1 {
            let from_middle = share_of_half(edge, own);
            let share = select(1.0 - from_middle, from_middle, first == 1);
            weights = select(
                select(vec2f(0.0, 1.0 - share), vec2f(1.0 - share, share), side == 1),
                vec2f(share, 0.0),
                side == 0,
            );
        }
        add_on_edge(&blend, edge, own, 1.0);
    }

    var position = vec3f(0.0);
    var texel_m = 0.0;
    for (var i = 0; i < blend.count; i++) {
        let place = blend.places[i];
        let frame = frames[place.frame];
        let footprint_m = length(position_at(frame, place.d, 0.0)) * scene.pixel_angle;
        let composed = compose(place.frame, place.d, footprint_m, HEIGHTS);
        let shown = position_at(frame, place.d, scene.exaggeration * composed.value.x);
        position += blend.shares[i] * shown;
        texel_m += blend.shares[i] * composed.texel_m;
    }
    return Vertex(clip_from_eye(position), weights, texel_m, patch_index);
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

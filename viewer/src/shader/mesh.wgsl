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
    pad: u32,
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
    pad: u32,
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

// steps: segments from corner a toward b and toward c.
fn vertex_of(patch_index: u32, steps: vec2i) -> Vertex {
    let part = patches[patch_index];
    let on_side = side_of(steps);
    let side = on_side.x;
    var weights = vec2f(steps) / f32(SEGMENTS);
    var place = Place(0u, vec3f(0.0));
    if side < 0 {
        place = place_in_patch(part, weights);
    } else {
        let ends = (part.sides >> u32(4 * side)) & 0xfu;
        let first = i32(ends & 3u);
        let last = i32(ends >> 2u);
        var step = on_side.y;
        if abs(last - first) == 1 {
            // Odd vertices fall on the one before them.
            step -= step & 1;
            let share = f32(step) / f32(SEGMENTS);
            weights = select(
                select(vec2f(0.0, 1.0 - share), vec2f(1.0 - share, share), side == 1),
                vec2f(share, 0.0),
                side == 0,
            );
        }
        let own = (first * SEGMENTS + (last - first) * step) / 2;
        place = place_on_edge(edges[part.edges[side]], own);
    }

    let frame = frames[place.frame];
    let footprint_m = length(position_at(frame, place.d, 0.0)) * scene.pixel_angle;
    let composed = compose(place.frame, place.d, footprint_m, HEIGHTS);
    let position = position_at(frame, place.d, scene.exaggeration * composed.value.x);
    return Vertex(clip_from_eye(position), weights, composed.texel_m, patch_index);
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

// patch.wgsl - patches of the sphere, their sides, and the places of their points.
//
// A point inside a patch is computed from the patch's frame. A point on a side is computed from the
// edge, of which both neighbors have the same one: a frame at its middle, the chord's direction
// there, and a whole number along it. At its ends and its middle the corners' own frames count, so
// that a finer neighbor's corner is this edge's middle to the bit.
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

// Points are kept edge by edge, SEGMENTS + 1 of each, and then patch by patch, row by row from corner a
// toward c; those on a patch's sides stay empty.
fn edge_point(edge: u32, own: i32) -> u32 {
    return edge * u32(SEGMENTS + 1) + u32(own);
}

fn points_of_patch() -> u32 {
    return u32((SEGMENTS + 1) * (SEGMENTS + 2) / 2);
}

fn patch_point(patch_index: u32, steps: vec2i) -> u32 {
    let row = steps.y * (2 * SEGMENTS + 3 - steps.y) / 2;
    return scene.edges * u32(SEGMENTS + 1) + patch_index * points_of_patch() + u32(row + steps.x);
}

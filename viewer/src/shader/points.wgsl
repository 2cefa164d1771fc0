// points.wgsl - the composed surface at the points of all edges and patches, each once.
//
// Exact      a place is computed by one text from the same numbers, so that what patches share is the
//            same to the bit

// Eye-relative position, and ground meters to a texel of the level used.
@group(3) @binding(0) var<storage, read_write> points: array<vec4f>;

fn point_at(place: Place) -> vec4f {
    let frame = frames[place.frame];
    let footprint_m = length(position_at(frame, place.d, 0.0)) * scene.pixel_angle;
    let composed = compose(place.frame, place.d, footprint_m, HEIGHTS);
    return vec4f(position_at(frame, place.d, scene.exaggeration * composed.value.x), composed.texel_m);
}

@compute @workgroup_size(64)
fn compose_points(@builtin(global_invocation_id) id: vec3u, @builtin(num_workgroups) groups: vec3u) {
    let index = id.y * groups.x * 64u + id.x;
    let on_edges = edge_point(scene.edges, 0);
    var place: Place;
    if index < on_edges {
        let edge = index / u32(SEGMENTS + 1);
        place = place_on_edge(edges[edge], i32(index % u32(SEGMENTS + 1)));
    } else {
        let patch_index = (index - on_edges) / points_of_patch();
        if patch_index >= scene.patches {
            return;
        }
        // The row that a number falls in, of rows that get shorter by one.
        var left = i32((index - on_edges) % points_of_patch());
        var row = 0;
        while left > SEGMENTS - row {
            left -= SEGMENTS + 1 - row;
            row += 1;
        }
        if left == 0 || row == 0 || left + row == SEGMENTS {
            return;
        }
        place = place_in_patch(patches[patch_index], vec2f(vec2i(left, row)) / f32(SEGMENTS));
    }
    points[index] = point_at(place);
}

// measure.wgsl - the composed heights of all pixels and the levels they come from, for reading
// back.
//
// Twin       render/aovs.rs turns them into places, in f64

struct Measure {
    // Meters above the frame of the patch, not exaggerated.
    height: f32,
    // Below 0 where there is none.
    level: f32,
}

@group(2) @binding(1) var<storage, read_write> measures: array<Measure>;

@compute @workgroup_size(8, 8)
fn measure(@builtin(global_invocation_id) id: vec3u) {
    if any(id.xy >= scene.viewport) {
        return;
    }
    let pixel = read_pixel(vec2i(id.xy));
    var found = Measure(0.0, -1.0);
    if pixel.patch_index >= 0 {
        let height = compose(pixel.place.frame, pixel.place.d, pixel.footprint_m, HEIGHTS);
        found = Measure(height.value.x, height.level);
    }
    measures[id.y * scene.viewport.x + id.x] = found;
}

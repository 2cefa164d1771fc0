// deferred.wgsl - reading the deferred buffer, for the passes over the screen.

@group(2) @binding(0) var deferred: texture_2d<u32>;

// What a pixel shows; patch_index is below 0 where no planet is.
struct Pixel {
    patch_index: i32,
    place: Place,
    // Eye-relative, at the frame's height.
    position: vec3f,
    footprint_m: f32,
    // Ground meters to a texel of the level used, smooth across the mesh.
    texel_m: f32,
}

fn read_pixel(at: vec2i) -> Pixel {
    let stored = textureLoad(deferred, at, 0);
    if stored.x == 0u {
        return Pixel(-1, Place(0u, vec3f(0.0)), vec3f(0.0), 0.0, 0.0);
    }
    let part = patches[stored.x - 1u];
    let place = place_in_patch(part, vec2f(bitcast<f32>(stored.y), bitcast<f32>(stored.z)));
    let frame = frames[place.frame];
    let position = position_at(frame, place.d, 0.0);
    let footprint_m = length(position) * scene.pixel_angle;
    return Pixel(i32(stored.x) - 1, place, position, footprint_m, bitcast<f32>(stored.w));
}

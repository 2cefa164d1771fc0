// shade.wgsl - the composed colors of the pixels, lit by the composed surface's slope.
//
// The slope is taken from composed heights about the pixel, not from the mesh: no patch shows. Its
// step is a texel of the level used, or a pixel if that is larger, so that the corners of the
// bilinear surface do not show either.
//
// Units      colors sRGB 0 to 1; light is added up linearly
// After      Lambert's law

const BASE_COLOR: vec3f = vec3f(0.62, 0.55, 0.5);

fn linear_from_srgb(c: vec3f) -> vec3f {
    return select(pow((c + 0.055) / 1.055, vec3f(2.4)), c / 12.92, c <= vec3f(0.04045));
}

fn srgb_from_linear(c: vec3f) -> vec3f {
    return select(1.055 * pow(c, vec3f(1.0 / 2.4)) - 0.055, 12.92 * c, c <= vec3f(0.0031308));
}

// The offset of the normal that lies `step` of the unit sphere from d along an axis of the frame.
fn stepped(d: vec3f, step: vec2f) -> vec3f {
    return offset_from_chord(1.0, d + vec3f(step, 0.0));
}

fn surface_at(frame: Frame, frame_index: u32, d: vec3f, footprint_m: f32) -> vec3f {
    return position_at(frame, d, height_at(frame_index, d, footprint_m));
}

@vertex
fn whole_screen(@builtin(vertex_index) index: u32) -> @builtin(position) vec4f {
    return vec4f(f32(index & 1u) * 4.0 - 1.0, f32(index >> 1u) * 4.0 - 1.0, 0.0, 1.0);
}

@fragment
fn shade(@builtin(position) position: vec4f) -> @location(0) vec4f {
    let pixel = read_pixel(vec2i(position.xy));
    if pixel.patch_index < 0 {
        return vec4f(scene.background, 1.0);
    }
    let index = pixel.place.frame;
    let frame = frames[index];
    let d = pixel.place.d;

    // Three points around the pixel, as far apart as a texel: the plane through them leans nowhere
    // that the surface does not.
    let step = max(pixel.texel_m, pixel.footprint_m) / scene.equatorial_radius;
    let a = surface_at(frame, index, stepped(d, step * vec2f(0.0, 0.57735)), pixel.footprint_m);
    let b = surface_at(frame, index, stepped(d, step * vec2f(-0.5, -0.288675)), pixel.footprint_m);
    let c = surface_at(frame, index, stepped(d, step * vec2f(0.5, -0.288675)), pixel.footprint_m);
    let normal = normalize(cross(b - a, c - a));

    var color = BASE_COLOR;
    let composed = compose(index, d, pixel.footprint_m, true);
    if composed.level >= 0.0 {
        color = composed.value;
    }
    let light = scene.ambient + (1.0 - scene.ambient) * max(dot(normal, scene.sun), 0.0);
    return vec4f(srgb_from_linear(linear_from_srgb(color) * light), 1.0);
}

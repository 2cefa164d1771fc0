// shade.wgsl - the colors of the pixels, lit by the composed normals or the composed surface's slope.
//
// The slope is taken from composed heights about the pixel, not from the mesh: no patch shows. Its
// step is a texel of the level used, or a pixel if that is larger, so that the corners of the
// bilinear surface do not show either. Where datasets of normals cover the ground no slope is taken.
//
// Units      colors sRGB 0 to 1; light is added up linearly
// After      Lambert's law

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

// The normal of the composed heights: that of a plane through three points around the pixel, as far
// apart as a texel, which leans nowhere that the surface does not.
fn slope_at(frame: Frame, index: u32, d: vec3f, pixel: Pixel) -> vec3f {
    let step = max(pixel.texel_m, pixel.footprint_m) / scene.equatorial_radius;
    let a = surface_at(frame, index, stepped(d, step * vec2f(0.0, 0.57735)), pixel.footprint_m);
    let b = surface_at(frame, index, stepped(d, step * vec2f(-0.5, -0.288675)), pixel.footprint_m);
    let c = surface_at(frame, index, stepped(d, step * vec2f(0.5, -0.288675)), pixel.footprint_m);
    return normalize(cross(b - a, c - a));
}

// The normal that codes say where the reference surface has `up`; exaggerated heights are steeper.
fn normal_from_codes(codes: vec3f, up: vec3f) -> vec3f {
    let normal = up + (255.0 * codes - 128.0) / 127.0;
    let along = dot(normal, up);
    return normalize(along * up + scene.exaggeration * (normal - along * up));
}

fn normal_at(frame: Frame, index: u32, d: vec3f, pixel: Pixel) -> vec3f {
    let composed = compose(index, d, pixel.footprint_m, NORMALS);
    if composed.opacity == 0.0 {
        return slope_at(frame, index, d, pixel);
    }
    let up = frame.up + frame.east * d.x + frame.north * d.y + frame.up * d.z;
    let normal = normal_from_codes(composed.value, up);
    if composed.opacity >= 1.0 {
        return normal;
    }
    let slope = slope_at(frame, index, d, pixel);
    return normalize(slope + (normal - slope) * composed.opacity);
}

// Farther than anything.
const FAR: f32 = 1e30;

// The direction that a place of the picture looks in, a unit.
fn ray_at(pixel: vec2f) -> vec3f {
    let across = vec2f(2.0, -2.0) * pixel / vec2f(scene.viewport) + vec2f(-1.0, 1.0);
    return normalize(scene.right * (across.x / scene.focal_x) + scene.up * (across.y / scene.focal_y) - scene.backward);
}

fn finished(light: vec3f) -> vec4f {
    return vec4f(srgb_from_linear(min(light, vec3f(1.0))), 1.0);
}

@vertex
fn whole_screen(@builtin(vertex_index) index: u32) -> @builtin(position) vec4f {
    return vec4f(f32(index & 1u) * 4.0 - 1.0, f32(index >> 1u) * 4.0 - 1.0, 0.0, 1.0);
}

@fragment
fn shade(@builtin(position) position: vec4f) -> @location(0) vec4f {
    let pixel = read_pixel(vec2i(position.xy));
    if pixel.patch_index < 0 {
        let sky = scattered_along(ray_at(position.xy), FAR, scene.sun);
        let behind = linear_from_srgb(scene.background);
        return finished(behind * sky.transmittance + sky.light * scene.exposure);
    }
    let index = pixel.place.frame;
    let frame = frames[index];
    let d = pixel.place.d;

    let normal = normal_at(frame, index, d, pixel);
    let ground = ground_color(index, d, pixel.footprint_m);
    let color = linear_from_srgb(debug_color(ground, index, d, pixel.footprint_m));
    let up = frame.up + frame.east * d.x + frame.north * d.y + frame.up * d.z;
    let distance = length(pixel.position);
    let direction = pixel.position / distance;

    var sunlight = vec3f(max(dot(normal, scene.sun), 0.0));
    if any(scene.relief != vec3f(0.0)) {
        let toward = frame.east * scene.relief.x + frame.north * scene.relief.y + frame.up * scene.relief.z;
        sunlight = vec3f(max(dot(normal, toward), 0.0));
    } else if air.top > 0.0 {
        let height = height_along(dot(direction, air.eye_up), distance);
        sunlight *= sunlight_at(max(height, 0.0), dot(up, scene.sun));
    }
    let seen = color * (scene.ambient + (1.0 - scene.ambient) * sunlight);
    let haze = scattered_along(direction, distance, scene.sun);
    return finished((seen * haze.transmittance + haze.light) * scene.exposure);
}

// shade.wgsl - the colors of the pixels, lit by the composed normals or the composed surface's slope.
//
// The slope is taken from composed heights about the pixel, not from the mesh: no patch shows. Its
// step is a texel of the level used, or a pixel if that is larger, so that the corners of the
// bilinear surface do not show either. Where datasets of normals cover the ground no slope is taken.
// Colors are means over the pixel's footprint (footprint.wgsl).
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

// The normal that codes say where the reference surface has `up`; exaggerated heights are steeper.
fn normal_from_codes(codes: vec3f, up: vec3f) -> vec3f {
    let normal = up + (255.0 * codes - 128.0) / 127.0;
    let along = dot(normal, up);
    return normalize(along * up + scene.exaggeration * (normal - along * up));
}

// What a pixel shows, before light.
struct Ground {
    normal: vec3f,
    // Away from the reference surface.
    up: vec3f,
    color: vec3f,
    // Eye-relative.
    position: vec3f,
}

// Three points around the pixel, as far apart as a texel: the plane through them leans nowhere that
// the surface does not.
const AROUND: array<vec2f, 3> = array(vec2f(0.0, 0.57735), vec2f(-0.5, -0.288675), vec2f(0.5, -0.288675));

// Values count by their opacity.
fn sum_of(sum: Composed, found: Composed) -> Composed {
    var more = sum;
    more.value += found.opacity * found.value;
    more.opacity += found.opacity;
    return more;
}

fn mean_of(sum: Composed, count: i32) -> Composed {
    var mean = sum;
    if sum.opacity > 0.0 {
        mean.value = sum.value / sum.opacity;
    }
    mean.opacity = sum.opacity / f32(count);
    return mean;
}

fn ground_at(pixel: Pixel, direction: vec3f) -> Ground {
    let index = pixel.place.frame;
    let frame = frames[index];
    let d = pixel.place.d;
    let up = frame.up + frame.east * d.x + frame.north * d.y + frame.up * d.z;
    let step = max(pixel.texel_m, pixel.footprint_m) / scene.equatorial_radius;

    let nothing = Composed(vec3f(0.0), -1.0, 0.0, 0.0);
    var normals = nothing;
    var heights = nothing;
    var colors = nothing;
    var luminances = nothing;
    var corners = array(vec3f(0.0), vec3f(0.0), vec3f(0.0));
    var normal = up;
    var footprint = Footprint(vec3f(0.0), 1, pixel.footprint_m);
    // A loop, not calls: drivers put the whole of a function wherever it is called.
    for (var asked = 0; asked < 5 + 2 * footprint.samples; asked++) {
        if asked == 4 {
            if normals.opacity < 1.0 {
                normal = normalize(cross(corners[1] - corners[0], corners[2] - corners[0]));
            }
            if normals.opacity > 0.0 {
                let told = normal_from_codes(normals.value, up);
                normal = normalize(normal + (told - normal) * normals.opacity);
            }
            footprint = footprint_of(frame, direction, normal, up, pixel.footprint_m);
        }
        var plane = HEIGHTS;
        var at = d;
        var sample_m = pixel.footprint_m;
        var is_wanted = true;
        if asked == 0 {
            plane = NORMALS;
        } else if asked <= 3 {
            var around = AROUND;
            at = stepped(d, step * around[asked - 1]);
            is_wanted = normals.opacity < 1.0;
        } else if asked == 4 {
            is_wanted = scene.ramp_stops > 0u || air.top > 0.0;
        } else {
            plane = select(LUMINANCES, COLORS, (asked & 1) == 1);
            at = sample_place(footprint, d, (asked - 5) >> 1u);
            sample_m = footprint.sample_m;
        }
        if !is_wanted || (plane != HEIGHTS && frame.lists[plane] == frame.lists[plane + 1u]) {
            continue;
        }
        let found = compose(index, at, sample_m, plane);
        if asked == 0 {
            normals = found;
        } else if asked <= 3 {
            corners[asked - 1] = position_at(frame, at, scene.exaggeration * found.value.x);
        } else if asked == 4 {
            heights = found;
        } else if plane == COLORS {
            colors = sum_of(colors, found);
        } else {
            luminances = sum_of(luminances, found);
        }
    }
    colors = mean_of(colors, footprint.samples);
    luminances = mean_of(luminances, footprint.samples);
    let color = ground_color(colors, luminances, heights, frame.height + heights.value.x);
    return Ground(normal, up, color, position_at(frame, d, scene.exaggeration * heights.value.x));
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
    let ground = ground_at(pixel, ray_at(position.xy));
    let place = pixel.place;
    let color = linear_from_srgb(debug_color(ground.color, place.frame, place.d, pixel.footprint_m));
    let distance = length(ground.position);
    let direction = ground.position / distance;

    var sunlight = vec3f(max(dot(ground.normal, scene.sun), 0.0));
    if any(scene.relief != vec3f(0.0)) {
        // By the place's own axes: the frames of two patches that meet differ. At a pole they are those of
        // longitude 0, as in mesh/frame.rs.
        let from_axis = length(ground.up.xy);
        var east = vec3f(0.0, 1.0, 0.0);
        if from_axis > 0.0 {
            east = vec3f(-ground.up.y, ground.up.x, 0.0) / from_axis;
        }
        let toward = east * scene.relief.x + cross(ground.up, east) * scene.relief.y + ground.up * scene.relief.z;
        sunlight = vec3f(max(dot(ground.normal, toward), 0.0));
    } else if air.top > 0.0 {
        let ray = air_ray(direction);
        let height = air_height(ray, ray.eye + distance);
        sunlight *= sunlight_at(max(height, 0.0), dot(ground.up, scene.sun));
    }
    let seen = color * (scene.ambient + (1.0 - scene.ambient) * sunlight);
    let haze = scattered_along(direction, distance, scene.sun);
    return finished((seen * haze.transmittance + haze.light) * scene.exposure);
}

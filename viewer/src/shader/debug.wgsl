// debug.wgsl - how a picture was made: levels, datasets, pages, what stands in and how far it may be
// off, over the ground.
//
// It tells of the front color dataset at a place, or of the front one of heights; of errors, of
// heights alone. Of datasets of one priority, the one with the largest share is told.
//
// Mirrored   scene.debug <-> viewer/src/render/options.rs: Debug

const SHOW_LEVEL: u32 = 1u;
const SHOW_DATASET: u32 = 2u;
const SHOW_BORDERS: u32 = 3u;
const SHOW_RESIDENCY: u32 = 4u;
const SHOW_ERROR: u32 = 5u;

// An error over what it may be: green, yellow from a half on, red above 1.
fn color_of_excess(excess: f32) -> vec3f {
    if excess > 1.0 {
        return vec3f(1.0, 0.1, 0.05);
    }
    return mix(vec3f(0.1, 0.6, 0.2), vec3f(1.0, 0.9, 0.1), min(2.0 * excess, 1.0));
}

// Colors that neighboring numbers do not share.
fn color_of_number(number: u32) -> vec3f {
    let hue = fract(f32(number) * 0.61803399) * 6.0;
    let light = vec3f(abs(hue - 3.0) - 1.0, 2.0 - abs(hue - 2.0), 2.0 - abs(hue - 4.0));
    return clamp(light, vec3f(0.0), vec3f(1.0));
}

fn debug_color(ground: vec3f, frame_index: u32, d: vec3f, footprint_m: f32) -> vec3f {
    if scene.debug == 0u {
        return ground;
    }
    let r0 = frames[frame_index].north.z;
    let z0 = frames[frame_index].up.z;
    let x = r0 + d.z * r0 - d.y * z0;
    let r = sqrt(x * x + d.x * d.x);
    let z = z0 + d.y * r0 + d.z * z0;
    var front = -1;
    var largest_share = 0.0;
    for (var step = select(0u, 1u, scene.debug == SHOW_ERROR); step < 2u && front < 0; step++) {
        let plane = select(HEIGHTS, COLORS, step == 0u);
        for (var i = frames[frame_index].lists[plane]; i < frames[frame_index].lists[plane + 1u]; i++) {
            let dataset = dataset_list[anchors[i].dataset];
            let point = map_point(dataset, anchors[i], r0, z0, d);
            if front >= 0 && dataset.priority != dataset_list[front].priority {
                break;
            }
            if !point.inside {
                continue;
            }
            let scales = principal_scales(dataset, r, z);
            let halvings = max(log2(footprint_m * max(scene.tolerance_px, 1.0) / scales.x), 0.0);
            let wanted = i32(ceil(max(f32(dataset.levels - 1) - halvings, 0.0)));
            let is_of_heights = plane == HEIGHTS || dataset.stops.y > 0u;
            let found = find_page(dataset, point, select(wanted, dataset.levels - 1, is_of_heights));
            if found.entry == 0u {
                continue;
            }
            let level = entry_level(found.entry);
            if scene.debug == SHOW_LEVEL {
                return mix(ground, color_of_number(u32(level)), 0.5);
            }
            if scene.debug == SHOW_DATASET {
                var covers = 0.0;
                if is_of_heights {
                    covers = read_height(found, 0.0).coverage;
                } else {
                    covers = read_codes(found, false).coverage;
                }
                let share = quality_of(scales) * dataset.weight * covers;
                if share > largest_share {
                    largest_share = share;
                    front = i32(anchors[i].dataset);
                }
                continue;
            }
            if scene.debug == SHOW_BORDERS {
                // Lines two pixels wide, about the page's outline.
                let at = vec2f(found.tap) + found.t - 0.5;
                let from_edge = min(at, f32(dataset.interior) - at);
                let texel_m = scales.x * exp2(f32(dataset.levels - 1 - level));
                let is_edge = min(from_edge.x, from_edge.y) * texel_m < 2.0 * footprint_m;
                return select(ground, vec3f(1.0, 0.9, 0.1), is_edge);
            }
            if scene.debug == SHOW_ERROR {
                let slot = entry_slot(found.entry);
                let bound_m = scene.exaggeration * bitcast<f32>(table[scene.slot_bounds + slot]);
                let excess = bound_m / (footprint_m * scene.tolerance_px);
                return mix(ground, color_of_excess(excess), 0.6);
            }
            let lag = f32(wanted - level);
            let color = select(vec3f(0.2, 0.3, 1.0), vec3f(1.0, 0.1, 0.05), lag > 0.0);
            return mix(ground, color, min(abs(lag) * 0.25, 0.8));
        }
    }
    if front >= 0 {
        return mix(ground, color_of_number(dataset_list[front].number), 0.5);
    }
    return ground;
}

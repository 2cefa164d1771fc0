// compose.wgsl - one value from the values of several datasets.
//
// Datasets stand in order, highest priority first. Those of one priority are averaged by q·c, and
// the priorities laid over one another, front to back, each with the opacity by which its datasets
// together cover the place, 1 - Π (1 - c).
//
// Units      footprint in ground meters to a sample: it chooses the levels, between two of which
//            values are blended
// Twin       surface.rs, areoid_formats::compose

struct Composed {
    value: vec3f,
    // Level of the dataset with the largest share, or below 0 where nothing answers.
    level: f32,
    // Ground meters to a texel of that level.
    texel_m: f32,
}

// A dataset's answer.
struct Answer {
    texel: Texel,
    level: f32,
}

fn read_page(dataset: Dataset, point: MapPoint, level: i32, base: f32, color: bool) -> Answer {
    let found = find_page(dataset, point, level);
    if found.entry == 0u {
        return Answer(Texel(vec3f(0.0), 0.0), 0.0);
    }
    if color {
        return Answer(read_color(found), f32(entry_level(found.entry)));
    }
    return Answer(read_height(found, base), f32(entry_level(found.entry)));
}

fn read_levels(dataset: Dataset, point: MapPoint, wanted: f32, base: f32, color: bool) -> Answer {
    let upper = i32(ceil(wanted));
    let toward_coarse = f32(upper) - wanted;
    var fine = read_page(dataset, point, upper, base, color);
    // A page of another level than asked stands in for both.
    let both = fine.texel.coverage > 0.0 && i32(fine.level) != upper;
    if toward_coarse > 0.0 && !both {
        let coarse = read_page(dataset, point, upper - 1, base, color);
        if fine.texel.coverage == 0.0 {
            fine = coarse;
        } else if coarse.texel.coverage > 0.0 {
            fine.texel.value += (coarse.texel.value - fine.texel.value) * toward_coarse;
            fine.texel.coverage += (coarse.texel.coverage - fine.texel.coverage) * toward_coarse;
        }
    }
    fine.level = min(fine.level, wanted);
    return fine;
}

// Heights are told above the frame's own, and are those of the reference surface where there are none.
fn compose(frame_index: u32, d: vec3f, footprint_m: f32, color: bool) -> Composed {
    let base = frames[frame_index].height;
    let r0 = frames[frame_index].north.z;
    let z0 = frames[frame_index].up.z;
    let x = r0 + d.z * r0 - d.y * z0;
    let r = sqrt(x * x + d.x * d.x);
    let z = z0 + d.y * r0 + d.z * z0;

    var composed = Composed(vec3f(0.0), -1.0, 0.0);
    var largest_share = 0.0;
    var shares = 0.0;
    var clear = 1.0;
    // The priority at work: its weight, its weighted sum, its best, what it leaves clear.
    var weight = 0.0;
    var sum = vec3f(0.0);
    var see_through = 1.0;
    var best = vec3f(0.0);

    let first = select(0u, scene.heights, color);
    let last = select(scene.heights, scene.datasets, color);
    for (var i = first; i < last; i++) {
        let dataset = dataset_list[i];
        let anchor = anchors[frame_index * scene.datasets + i];
        if anchor.texel.x != ABSENT {
            let point = map_point(dataset, anchor, r0, z0, d);
            if point.inside {
                let scales = principal_scales(dataset, r, z);
                let halvings = max(log2(footprint_m / scales.x) - scene.lod_bias, 0.0);
                let wanted = max(f32(dataset.levels - 1) - halvings, 0.0);
                let answer = read_levels(dataset, point, wanted, base, color);
                if answer.texel.coverage > 0.0 {
                    let share = quality_of(scales) * answer.texel.coverage;
                    weight += share;
                    sum += share * answer.texel.value;
                    see_through *= 1.0 - answer.texel.coverage;
                    if share > best.x {
                        let texel_m = scales.x * exp2(f32(dataset.levels - 1) - answer.level);
                        best = vec3f(share, answer.level, texel_m);
                    }
                }
            }
        }
        if weight > 0.0 && (i + 1u == last || dataset_list[i + 1u].priority != dataset.priority) {
            let opacity = clear * (1.0 - see_through);
            composed.value += opacity * (sum / weight);
            shares += opacity;
            if opacity * best.x / weight > largest_share {
                largest_share = opacity * best.x / weight;
                composed.level = best.y;
                composed.texel_m = best.z;
            }
            clear *= see_through;
            weight = 0.0;
            sum = vec3f(0.0);
            see_through = 1.0;
            best = vec3f(0.0);
            if clear <= 0.0 {
                break;
            }
        }
    }
    if shares > 0.0 {
        composed.value /= shares;
    } else if !color {
        composed.value.x = -base;
    }
    return composed;
}

// The composed height above the frame's own, in exaggerated meters.
fn height_at(frame_index: u32, d: vec3f, footprint_m: f32) -> f32 {
    return scene.exaggeration * compose(frame_index, d, footprint_m, false).value.x;
}

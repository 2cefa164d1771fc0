// compose.wgsl - one value from the values of several datasets.
//
// Heights, colors, luminances and normals are composed each for itself. Datasets stand in order,
// highest priority first. Those of one priority are averaged by q·c·u, and the priorities laid over
// one another, front to back, each with the opacity by which its datasets together cover the place,
// 1 - Π (1 - c·u); the members of a series count as one dataset, of Σ c·u.
//
// Units      footprint in ground meters to a sample: it chooses the levels, between two of which
//            values are blended; colors sRGB 0 to 1; normals as codes, 0 to 1. Heights are chosen by
//            their error (blend.wgsl), not by their texels.
// Twin       surface.rs, areoid_formats::compose

const HEIGHTS: u32 = 0u;
const COLORS: u32 = 1u;
const LUMINANCES: u32 = 2u;
const NORMALS: u32 = 3u;

struct Composed {
    value: vec3f,
    // Level of the dataset with the largest share, or below 0 where nothing answers.
    level: f32,
    // Ground meters to a texel of that level.
    texel_m: f32,
    // How far the user's weights let it cover what there is without it.
    opacity: f32,
}

// A dataset's answer.
struct Answer {
    texel: Texel,
    level: f32,
    // Of the finest page that has to do with it.
    finest: i32,
}

fn blend_texels(a: Texel, b: Texel, t: f32) -> Texel {
    return Texel(a.value + (b.value - a.value) * t, a.coverage + (b.coverage - a.coverage) * t);
}

// Heights: those of the finest page, over those of the coarser ones whose error would do.
fn read_heights(dataset: Dataset, point: MapPoint, frame_index: u32, d: vec3f) -> Answer {
    let frame = frames[frame_index];
    var found = find_page(dataset, point, dataset.levels - 1);
    if found.entry == 0u {
        return Answer(Texel(vec3f(0.0), 0.0), 0.0, -1);
    }
    var texel = read_height(found, frame.height);
    let tolerance_m = tolerance_m_at(position_at(frame, d, scene.exaggeration * texel.value.x));
    var error = bound_of(found.entry) / tolerance_m;
    let finest = entry_level(found.entry);
    var level = f32(finest);
    for (var own = finest; own > 0; own = entry_level(found.entry)) {
        let beneath = find_page(dataset, point, own - 1);
        if beneath.entry == 0u || entry_level(beneath.entry) >= own {
            break;
        }
        let coarser = bound_of(beneath.entry) / tolerance_m;
        let share = share_of_finer(coarser, error) * entry_presence(found.entry);
        if share >= 1.0 {
            break;
        }
        let below = read_height(beneath, frame.height);
        // Either counts as far as it covers the place.
        let coverage = below.coverage + (texel.coverage - below.coverage) * share;
        if coverage > 0.0 {
            let part = share * texel.coverage / coverage;
            texel = Texel(below.value + (texel.value - below.value) * part, coverage);
        }
        error = coarser + (error - coarser) * share;
        level = f32(entry_level(beneath.entry)) + (level - f32(entry_level(beneath.entry))) * share;
        found = beneath;
    }
    return Answer(texel, level, finest);
}

// The value of a level, and the level it comes from. A page that has just come shows in part; what
// stood in for it, and for that, shows for the rest.
fn read_page(dataset: Dataset, point: MapPoint, level: i32, plane: u32) -> Answer {
    var sum = Answer(Texel(vec3f(0.0), 0.0), 0.0, -1);
    var last = sum;
    var rest = 1.0;
    var before = dataset.levels;
    for (var asked = level; asked >= 0; asked = before - 1) {
        let found = find_page(dataset, point, asked);
        let own = entry_level(found.entry);
        if found.entry == 0u || own >= before {
            break;
        }
        sum.finest = max(sum.finest, own);
        let presence = entry_presence(found.entry);
        let texel = read_codes(found, plane == NORMALS);
        if texel.coverage > 0.0 {
            last = Answer(texel, f32(own), own);
            let share = rest * presence;
            sum.texel.value += share * texel.value;
            sum.texel.coverage += share * texel.coverage;
            sum.level += share * f32(own);
            rest -= share;
        }
        if presence >= 1.0 {
            break;
        }
        before = own;
    }
    // Where nothing stood in for the last of them, it shows for all that is left.
    sum.texel.value += rest * last.texel.value;
    sum.texel.coverage += rest * last.texel.coverage;
    sum.level += rest * last.level;
    return sum;
}

fn read_levels(dataset: Dataset, point: MapPoint, wanted: f32, plane: u32) -> Answer {
    let upper = i32(ceil(wanted));
    let toward_coarse = f32(upper) - wanted;
    var fine = Answer(Texel(vec3f(0.0), 0.0), 0.0, -1);
    // A loop, not two calls: drivers put the whole of a function wherever it is called.
    for (var step = 0; step < 2; step++) {
        let answer = read_page(dataset, point, upper - step, plane);
        if step == 0 || fine.texel.coverage == 0.0 {
            fine = answer;
        } else if answer.texel.coverage > 0.0 {
            fine.texel = blend_texels(fine.texel, answer.texel, toward_coarse);
        }
        // A page of another level than asked stands in for both.
        if toward_coarse == 0.0 || (fine.texel.coverage > 0.0 && fine.finest != upper) {
            break;
        }
    }
    fine.level = min(fine.level, wanted);
    return fine;
}

// Heights are told above the frame's own, and are those of the reference surface where there are none.
fn compose(frame_index: u32, d: vec3f, footprint_m: f32, plane: u32) -> Composed {
    // Colors are as sharp as the view asks for.
    let sample_m = footprint_m * max(scene.tolerance_px, 1.0);
    let r0 = frames[frame_index].north.z;
    let z0 = frames[frame_index].up.z;
    let x = r0 + d.z * r0 - d.y * z0;
    let r = sqrt(x * x + d.x * d.x);
    let z = z0 + d.y * r0 + d.z * z0;

    var composed = Composed(vec3f(0.0), -1.0, 0.0, 0.0);
    var largest_share = 0.0;
    var shares = 0.0;
    // What the priorities so far leave clear; and would, if all weights were 1.
    var clear = vec2f(1.0);
    // The priority at work: its weight, its weighted sum, its best, what it leaves clear.
    var weight = 0.0;
    var sum = vec3f(0.0);
    var see_through = vec2f(1.0);
    var best = vec3f(0.0);
    // The series at work: Σ c·u and Σ c.
    var alpha = vec2f(0.0);

    let last = frames[frame_index].lists[plane + 1u];
    for (var i = frames[frame_index].lists[plane]; i < last; i++) {
        let dataset = dataset_list[anchors[i].dataset];
        let point = map_point(dataset, anchors[i], r0, z0, d);
        if point.inside {
            let scales = principal_scales(dataset, r, z);
            var answer: Answer;
            if plane == HEIGHTS || dataset.stops.y > 0u {
                answer = read_heights(dataset, point, frame_index, d);
                if plane == COLORS {
                    let height = frames[frame_index].height + answer.texel.value.x;
                    answer.texel.value = ramp_at(dataset.stops, height);
                }
            } else {
                let halvings = max(log2(sample_m / scales.x), 0.0);
                answer = read_levels(dataset, point, max(f32(dataset.levels - 1) - halvings, 0.0), plane);
            }
            if answer.texel.coverage > 0.0 {
                let cover = answer.texel.coverage * dataset.weight;
                let share = quality_of(scales) * cover;
                weight += share;
                sum += share * answer.texel.value;
                alpha += vec2f(cover, answer.texel.coverage);
                if share > best.x {
                    let texel_m = scales.x * exp2(f32(dataset.levels - 1) - answer.level);
                    best = vec3f(share, answer.level, texel_m);
                }
            }
        }
        var next_priority = dataset.priority + 1;
        var next_series = 0u;
        if i + 1u < last {
            let next = anchors[i + 1u].dataset;
            next_priority = dataset_list[next].priority;
            next_series = dataset_list[next].series;
        }
        let is_last = next_priority != dataset.priority;
        if is_last || dataset.series == 0u || next_series != dataset.series {
            see_through *= 1.0 - min(alpha, vec2f(1.0));
            alpha = vec2f(0.0);
        }
        if is_last {
            if weight > 0.0 {
                let opacity = clear.x * (1.0 - see_through.x);
                composed.value += opacity * (sum / weight);
                shares += opacity;
                if opacity * best.x / weight > largest_share {
                    largest_share = opacity * best.x / weight;
                    composed.level = best.y;
                    composed.texel_m = best.z;
                }
                clear *= see_through;
            }
            weight = 0.0;
            sum = vec3f(0.0);
            see_through = vec2f(1.0);
            best = vec3f(0.0);
            if clear.x <= 0.0 {
                break;
            }
        }
    }
    if shares > 0.0 {
        composed.value /= shares;
        composed.opacity = min((1.0 - clear.x) / (1.0 - clear.y), 1.0);
    } else if plane == HEIGHTS {
        composed.value.x = -frames[frame_index].height;
    }
    return composed;
}

// texels.wgsl - reading a page: the bilinear reconstruction R, with holes.
//
// A tap without data drops out and the others are weighed anew; where the valid taps weigh less
// than 1/512 there is no value. A page of full coverage needs no look at it.
//
// Heights are told above a base near them: 21 km in an f32 has steps of 2 mm, a pixel from a meter
// away; the difference of two of them has none.
//
// Units      heights in meters, colors and normals in codes from 0 to 1
// Twin       areoid_formats::page::Page::reconstruct
// Exact      a + (b - a) t, not mix(): drivers expand mix() differently

@group(1) @binding(0) var height_atlas: texture_2d_array<f32>;
@group(1) @binding(1) var height_coverage: texture_2d_array<u32>;
@group(1) @binding(2) var color_atlas: texture_2d_array<f32>;
@group(1) @binding(3) var normal_atlas: texture_2d_array<f32>;
@group(1) @binding(4) var gray_atlas: texture_2d_array<f32>;

const LEAST_VALID_WEIGHT: f32 = 0.001953125;

// A value read from a page, 0 coverage where there is none.
struct Texel {
    value: vec3f,
    coverage: f32,
}

fn tap_weights(t: vec2f) -> vec4f {
    return vec4f((1.0 - t.x) * (1.0 - t.y), t.x * (1.0 - t.y), (1.0 - t.x) * t.y, t.x * t.y);
}

fn blend_taps(a: vec4f, b: vec4f, c: vec4f, d: vec4f, weights: vec4f) -> Texel {
    let valid = select(vec4f(0.0), weights, vec4f(a.w, b.w, c.w, d.w) > vec4f(0.0));
    let sum = valid.x + valid.y + valid.z + valid.w;
    if sum < LEAST_VALID_WEIGHT {
        return Texel(vec3f(0.0), 0.0);
    }
    let value = a.xyz * valid.x + b.xyz * valid.y + c.xyz * valid.z + d.xyz * valid.w;
    let coverage = a.w * valid.x + b.w * valid.y + c.w * valid.z + d.w * valid.w;
    return Texel(value / sum, coverage);
}

fn height_tap(at: vec2i, slot: i32, base: f32) -> vec4f {
    let coverage = f32(textureLoad(height_coverage, at, slot, 0).r) / 255.0;
    return vec4f(textureLoad(height_atlas, at, slot, 0).r - base, 0.0, 0.0, coverage);
}

fn read_height(found: Found, base: f32) -> Texel {
    let slot = entry_slot(found.entry);
    let t = found.t;
    let at = found.tap;
    if (found.entry & WHOLE) != 0u {
        let a = textureLoad(height_atlas, at, slot, 0).r - base;
        let b = textureLoad(height_atlas, at + vec2i(1, 0), slot, 0).r - base;
        let c = textureLoad(height_atlas, at + vec2i(0, 1), slot, 0).r - base;
        let d = textureLoad(height_atlas, at + vec2i(1, 1), slot, 0).r - base;
        let above = a + (b - a) * t.x;
        let below = c + (d - c) * t.x;
        return Texel(vec3f(above + (below - above) * t.y, 0.0, 0.0), 1.0);
    }
    return blend_taps(
        height_tap(at, slot, base),
        height_tap(at + vec2i(1, 0), slot, base),
        height_tap(at + vec2i(0, 1), slot, base),
        height_tap(at + vec2i(1, 1), slot, base),
        tap_weights(t),
    );
}

fn code_tap(entry: u32, is_normal: bool, at: vec2i) -> vec4f {
    let slot = entry_slot(entry);
    if is_normal {
        return textureLoad(normal_atlas, at, slot, 0);
    }
    if (entry & GRAY) != 0u {
        return vec4f(vec3f(textureLoad(gray_atlas, at, slot, 0).r), 1.0);
    }
    return textureLoad(color_atlas, at, slot, 0);
}

// Codes, 0 to 1: sRGB, or what areoid_formats::normal says.
fn read_codes(found: Found, is_normal: bool) -> Texel {
    let at = found.tap;
    return blend_taps(
        code_tap(found.entry, is_normal, at),
        code_tap(found.entry, is_normal, at + vec2i(1, 0)),
        code_tap(found.entry, is_normal, at + vec2i(0, 1)),
        code_tap(found.entry, is_normal, at + vec2i(1, 1)),
        tap_weights(found.t),
    );
}

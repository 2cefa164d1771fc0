// atmosphere.wgsl - light that air scatters once along a ray, and how much of what is behind it
// gets through.
//
// Heights count from a sphere that touches the reference surface under the eye; nothing here is as
// large as the planet and then subtracted.
//
// Units      meters, and per meter; white ground square to the sun sends 1
// Precision  2 % of the twin's numbers
// Twin       atmosphere.rs, which says what the model is and whose

struct Atmosphere {
    // Scattering by molecules at the ground.
    rayleigh: vec3f,
    // Over which molecules thin out by e.
    rayleigh_height: f32,
    // Scattering by dust at the ground.
    mie: vec3f,
    mie_height: f32,
    // What dust takes from a ray.
    mie_extinction: vec3f,
    asymmetry: f32,
    // From the sphere's center to the eye.
    eye_up: vec3f,
    // Of the eye above the sphere.
    eye_height: f32,
    radius: f32,
    // Where nothing is left above the sphere; 0 for no air at all.
    top: f32,
    pad0: u32,
    pad1: u32,
}

@group(0) @binding(7) var<storage, read> air: Atmosphere;

const STEPS: i32 = 24;
const PI: f32 = 3.14159265359;

struct Scattered {
    light: vec3f,
    transmittance: vec3f,
}

// √(a² + 2 a t cosine + t²) − R with a = R + h.
fn height_along(cosine: f32, t: f32) -> f32 {
    let above = air.eye_height * (2.0 * air.radius + air.eye_height) + t * (2.0 * (air.radius + air.eye_height) * cosine + t);
    return above / (sqrt(max(air.radius * air.radius + above, 0.0)) + air.radius);
}

// Where a ray is in the air: nowhere if the second is not larger.
fn air_span(cosine: f32) -> vec2f {
    let rest = (air.eye_height - air.top) * (2.0 * air.radius + air.eye_height + air.top);
    let half = (air.radius + air.eye_height) * cosine;
    let inside = half * half - rest;
    if inside <= 0.0 {
        return vec2f(0.0);
    }
    let root = sqrt(inside);
    return vec2f(max(-half - root, 0.0), root - half);
}

// Chapman's function for a cosine of 0 or more: the air along a ray from x scale heights out, over
// that straight up.
fn chapman(x: f32, cosine: f32) -> f32 {
    let y = sqrt(0.5 * x) * cosine;
    let near = (1.0606963 + 0.55643831 * y) / (1.0619896 + (1.7245609 + y) * y);
    return sqrt(0.5 * PI * x) * select(near, 0.56498823 / (0.06651874 + y), y > 8.0);
}

// Meters of air of the ground's density toward the sun; below 0 where the ground is in the way.
fn sunward(height: f32, cosine: f32, scale: f32) -> f32 {
    let x = air.radius / scale;
    let h = height / scale;
    let upward = scale * chapman(x + h, abs(cosine)) * exp(-h);
    if cosine >= 0.0 {
        return upward;
    }
    // The ray's lowest point above the ground: (x + h) sine - x, in a form that does not cancel.
    let sine = sqrt(max(1.0 - cosine * cosine, 0.0));
    let lowest = h * sine - x * cosine * cosine / (1.0 + sine);
    if lowest < 0.0 {
        return -1.0;
    }
    return 2.0 * scale * chapman(x + lowest, 0.0) * exp(-lowest) - upward;
}

// The share of sunlight that reaches a height where the sun has `cosine` with up.
fn sunlight_at(height: f32, cosine: f32) -> vec3f {
    let molecules = sunward(height, cosine, air.rayleigh_height);
    let dust = sunward(height, cosine, air.mie_height);
    if molecules < 0.0 || dust < 0.0 {
        return vec3f(0.0);
    }
    return exp(-(air.rayleigh * molecules + air.mie_extinction * dust));
}

fn rayleigh_phase(cosine: f32) -> f32 {
    return 3.0 / (16.0 * PI) * (1.0 + cosine * cosine);
}

fn mie_phase(cosine: f32, asymmetry: f32) -> f32 {
    let g2 = asymmetry * asymmetry;
    return 3.0 / (8.0 * PI) * (1.0 - g2) * (1.0 + cosine * cosine) / ((2.0 + g2) * pow(1.0 + g2 - 2.0 * asymmetry * cosine, 1.5));
}

// What comes along a ray of unit direction from as far as `end`, or from outside.
fn scattered_along(direction: vec3f, end: f32, sun: vec3f) -> Scattered {
    var scattered = Scattered(vec3f(0.0), vec3f(1.0));
    let cosine = dot(direction, air.eye_up);
    let span = air_span(cosine);
    let last = min(span.y, end);
    if air.top <= 0.0 || last <= span.x {
        return scattered;
    }
    let angle = dot(direction, sun);
    let by_molecules = air.rayleigh * rayleigh_phase(angle);
    let by_dust = air.mie * mie_phase(angle, air.asymmetry);
    // Samples crowd about the ray's lowest point, where the air is.
    let lowest = clamp(-(air.radius + air.eye_height) * cosine, span.x, last);
    let first = -sqrt(lowest - span.x);
    let each = (sqrt(last - lowest) - first) / f32(STEPS);
    for (var i = 0; i < STEPS; i++) {
        let root = first + (f32(i) + 0.5) * each;
        let t = lowest + root * abs(root);
        let stride = 2.0 * abs(root) * each;
        let height = height_along(cosine, t);
        let molecules = exp(-height / air.rayleigh_height);
        let dust = exp(-height / air.mie_height);
        let up = (air.eye_up * (air.radius + air.eye_height) + direction * t) / (air.radius + height);
        let sunlight = sunlight_at(max(height, 0.0), dot(up, sun));
        let through = exp(-(air.rayleigh * molecules + air.mie_extinction * dust) * (0.5 * stride));
        scattered.transmittance *= through;
        scattered.light += scattered.transmittance * sunlight * (by_molecules * molecules + by_dust * dust) * stride;
        scattered.transmittance *= through;
    }
    scattered.light *= PI;
    return scattered;
}

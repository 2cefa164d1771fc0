// atmosphere.wgsl - light that air scatters once along a ray, and how much of what is behind it
// gets through.
//
// Heights count from a sphere that touches the reference surface under the eye. Places along a ray
// are told from its lowest point, so that an eye may be far away: the rounding of directions alone
// moves that by the eye's distance times 2^-24, 60 m at 10^9 m.
//
// Units      meters, and per meter; white ground square to the sun sends 1
// Precision  2 % of the twin's numbers up to 10^9 m, where a scale height of 1 km is told to 6 %
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

// A ray by its point nearest to the center, which may be behind the eye.
struct AirRay {
    // From the center.
    nearest: vec3f,
    // Of that point above the sphere.
    lowest: f32,
    // The eye from there along the ray.
    eye: f32,
}

fn air_ray(direction: vec3f) -> AirRay {
    let distance = air.radius + air.eye_height;
    let cosine = dot(direction, air.eye_up);
    let sine = length(cross(direction, air.eye_up));
    // (R + h) sine - R, in a form that does not cancel near the ground.
    let lowest = air.eye_height * sine - air.radius * cosine * cosine / (1.0 + sine);
    return AirRay(distance * (air.eye_up - direction * cosine), lowest, distance * cosine);
}

// Above the sphere at s meters from a ray's nearest point: √((R + l)² + s²) − R.
fn air_height(ray: AirRay, s: f32) -> f32 {
    let above = ray.lowest * (2.0 * air.radius + ray.lowest) + s * s;
    return above / (sqrt(max(air.radius * air.radius + above, 0.0)) + air.radius);
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
    let ray = air_ray(direction);
    let inside = (air.top - ray.lowest) * (2.0 * air.radius + air.top + ray.lowest);
    if air.top <= 0.0 || inside <= 0.0 {
        return scattered;
    }
    let start = max(-sqrt(inside), ray.eye);
    let last = min(sqrt(inside), ray.eye + end);
    if last <= start {
        return scattered;
    }
    let angle = dot(direction, sun);
    let by_molecules = air.rayleigh * rayleigh_phase(angle);
    let by_dust = air.mie * mie_phase(angle, air.asymmetry);
    // Samples crowd about the ray's lowest point, where the air is.
    let middle = clamp(0.0, start, last);
    let first = -sqrt(middle - start);
    let each = (sqrt(last - middle) - first) / f32(STEPS);
    for (var i = 0; i < STEPS; i++) {
        let root = first + (f32(i) + 0.5) * each;
        let s = middle + root * abs(root);
        let stride = 2.0 * abs(root) * each;
        let height = air_height(ray, s);
        let molecules = exp(-height / air.rayleigh_height);
        let dust = exp(-height / air.mie_height);
        let up = (ray.nearest + direction * s) / (air.radius + height);
        let sunlight = sunlight_at(max(height, 0.0), dot(up, sun));
        let through = exp(-(air.rayleigh * molecules + air.mie_extinction * dust) * (0.5 * stride));
        scattered.transmittance *= through;
        scattered.light += scattered.transmittance * sunlight * (by_molecules * molecules + by_dust * dust) * stride;
        scattered.transmittance *= through;
    }
    scattered.light *= PI;
    return scattered;
}

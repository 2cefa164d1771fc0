//! The unit sphere of surface normals: twelve seeds, midpoints, and distances, in f64.
//!
//! # References
//!
//! Kooima 2008, §3.3.5: the midpoint of an arc lies `y = x tan(θ/4)` above that of its chord, with
//! x half the chord and θ the angle between the ends. Since x = sin(θ/2), the tangent of the half
//! of θ/2 is x / (1 + √(1 - x²)): no angle is taken, and nothing is lost as θ goes to 0.

use glam::DVec3;

/// Corners of the twenty faces, counterclockwise from outside.
pub(crate) const FACES: [[u32; 3]; 20] = [
    [0, 1, 2],
    [0, 2, 3],
    [0, 3, 4],
    [0, 4, 5],
    [0, 5, 1],
    [1, 6, 2],
    [2, 6, 7],
    [2, 7, 3],
    [3, 7, 8],
    [3, 8, 4],
    [4, 8, 9],
    [4, 9, 5],
    [5, 9, 10],
    [5, 10, 1],
    [1, 10, 6],
    [11, 7, 6],
    [11, 8, 7],
    [11, 9, 8],
    [11, 10, 9],
    [11, 6, 10],
];

/// The corners of an icosahedron with a corner on each pole.
pub(crate) fn icosahedron() -> [DVec3; 12] {
    let ring_z = 0.2_f64.sqrt();
    let ring_radius = 2.0 * ring_z;
    let mut corners = [DVec3::Z; 12];
    for (i, step) in (0..5).map(|i| (i, std::f64::consts::TAU / 5.0 * i as f64)) {
        let (sine, cosine) = step.sin_cos();
        let (lower_sine, lower_cosine) = (step + std::f64::consts::TAU / 10.0).sin_cos();
        corners[1 + i] = DVec3::new(ring_radius * cosine, ring_radius * sine, ring_z);
        corners[6 + i] = DVec3::new(ring_radius * lower_cosine, ring_radius * lower_sine, -ring_z);
    }
    corners[11] = DVec3::NEG_Z;
    corners
}

/// The middle of the shorter arc between two unit vectors.
///
/// # Precision
///
/// Rounding alone, for arcs of any length below a half turn; the same for both orders.
pub(crate) fn midpoint(a: DVec3, b: DVec3) -> DVec3 {
    let chord_middle = 0.5 * (a + b);
    let half_chord2 = 0.25 * (b - a).length_squared();
    let distance = (1.0 - half_chord2).sqrt();
    // y = x tan(θ/4) with tan(θ/4) = x / (1 + √(1 - x²)), along the middle's own direction.
    let rise = half_chord2 / (1.0 + distance);
    (chord_middle * (1.0 + rise / distance)).normalize()
}

/// The least distance from `point` to a flat triangle.
///
/// # References
///
/// C. Ericson, *Real-Time Collision Detection*, 2005, §5.1.5.
pub(crate) fn distance_to_triangle(point: DVec3, [a, b, c]: [DVec3; 3]) -> f64 {
    let (ab, ac, ap) = (b - a, c - a, point - a);
    let (d1, d2) = (ab.dot(ap), ac.dot(ap));
    let bp = point - b;
    let (d3, d4) = (ab.dot(bp), ac.dot(bp));
    let cp = point - c;
    let (d5, d6) = (ab.dot(cp), ac.dot(cp));
    let (va, vb, vc) = (d3 * d6 - d5 * d4, d5 * d2 - d1 * d6, d1 * d4 - d3 * d2);
    let closest = if d1 <= 0.0 && d2 <= 0.0 {
        a
    } else if d3 >= 0.0 && d4 <= d3 {
        b
    } else if d6 >= 0.0 && d5 <= d6 {
        c
    } else if vc <= 0.0 && d1 >= 0.0 && d3 <= 0.0 {
        a + ab * (d1 / (d1 - d3))
    } else if vb <= 0.0 && d2 >= 0.0 && d6 <= 0.0 {
        a + ac * (d2 / (d2 - d6))
    } else if va <= 0.0 && d4 - d3 >= 0.0 && d5 - d6 >= 0.0 {
        b + (c - b) * ((d4 - d3) / ((d4 - d3) + (d5 - d6)))
    } else {
        let scale = 1.0 / (va + vb + vc);
        a + ab * (vb * scale) + ac * (vc * scale)
    };
    point.distance(closest)
}

/// cos(θ - α) of an angle θ with this cosine and the arc α over a chord, sin(α / 2) = chord / 2; 1 where
/// the arc is the longer.
///
/// # Precision
///
/// Rounding of `cosine`, which tells angles near 0 and π to 1e-8.
pub(crate) fn nearer_cosine(cosine: f64, chord: f64) -> f64 {
    let cosine = cosine.clamp(-1.0, 1.0);
    let half = (0.5 * chord).min(1.0);
    let cosine_of_arc = 1.0 - 2.0 * half * half;
    if cosine >= cosine_of_arc {
        return 1.0;
    }
    let sine_of_arc = 2.0 * half * ((1.0 - half) * (1.0 + half)).sqrt();
    cosine * cosine_of_arc + ((1.0 - cosine) * (1.0 + cosine)).sqrt() * sine_of_arc
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn faces_tile_the_sphere_and_look_outward() {
        let corners = icosahedron();
        let mut solid_angle = 0.0;
        for face in FACES {
            let [a, b, c] = face.map(|i| corners[i as usize]);
            let triple = a.dot(b.cross(c));
            assert!(triple > 0.0, "{face:?}");
            let edges = 1.0 + a.dot(b) + b.dot(c) + c.dot(a);
            solid_angle += 2.0 * triple.atan2(edges);
        }
        assert!((solid_angle - 4.0 * std::f64::consts::PI).abs() < 1e-12);
    }

    fn direction() -> impl Strategy<Value = DVec3> {
        (-1.0..1.0_f64, 0.0..std::f64::consts::TAU).prop_map(|(z, turn)| {
            let r = (1.0 - z * z).sqrt();
            DVec3::new(r * turn.cos(), r * turn.sin(), z)
        })
    }

    #[test]
    fn an_arc_takes_from_an_angle() {
        let third = std::f64::consts::FRAC_PI_3;
        let cases = [(0.0, 0.0, 0.0), (third, 0.0, third), (2.0 * third, 1.0, third)];
        let ends = [(3.0 * third, 2.0, 0.0), (3.0 * third, 1.0, 2.0 * third), (third, 1.1, 0.0)];
        for (angle, chord, left) in cases.into_iter().chain(ends) {
            let found = nearer_cosine(f64::cos(angle), chord);
            assert!((found - f64::cos(left)).abs() < 1e-7, "{angle} {chord}: {found}");
        }
        // What is no number hides nothing.
        assert!(nearer_cosine(f64::NAN, 1.0).is_nan());
        assert!(nearer_cosine(0.5, f64::NAN) == 1.0);
    }

    proptest! {
        #[test]
        fn an_arc_takes_from_any_angle(
            angle in 0.0..std::f64::consts::PI, chord in 0.0..2.5_f64,
        ) {
            let arc = 2.0 * (chord / 2.0).min(1.0).asin();
            let expected = (angle - arc).max(0.0).cos();
            let found = nearer_cosine(angle.cos(), chord);
            prop_assert!((found - expected).abs() < 1e-7, "{} {}", found, expected);
        }

        #[test]
        fn midpoints_are_halfway_at_every_scale(
            a in direction(), other in direction(), scale in -8.0..0.0_f64,
        ) {
            let b = (a + other * 10.0_f64.powf(scale)).normalize();
            let middle = midpoint(a, b);
            prop_assert!((middle.length() - 1.0).abs() < 1e-15);
            prop_assert_eq!(middle, midpoint(b, a));
            let (left, right) = (middle.distance(a), middle.distance(b));
            prop_assert!((left - right).abs() <= 1e-15 + 1e-8 * left * left);
        }

        #[test]
        fn a_triangle_is_as_near_as_its_nearest_sample(
            point in direction(), a in direction(), b in direction(), c in direction(),
        ) {
            let exact = distance_to_triangle(2.0 * point, [a, b, c]);
            let mut sampled = f64::INFINITY;
            for i in 0..=40 {
                for j in 0..=40 - i {
                    let (u, v) = (f64::from(i) / 40.0, f64::from(j) / 40.0);
                    let place = a + (b - a) * u + (c - a) * v;
                    sampled = sampled.min(place.distance(2.0 * point));
                }
            }
            prop_assert!(exact <= sampled + 1e-12 && exact >= sampled - 0.1);
        }
    }
}

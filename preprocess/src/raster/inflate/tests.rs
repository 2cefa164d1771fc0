//! Streams of an encoder of its own come back; cut and damaged ones are errors.

use std::io::Write;

use flate2::Compression;
use flate2::write::ZlibEncoder;
use proptest::prelude::*;

use super::*;

fn deflated(bytes: &[u8], level: u32) -> Vec<u8> {
    let mut encoder = ZlibEncoder::new(Vec::new(), Compression::new(level));
    encoder.write_all(bytes).unwrap();
    encoder.finish().unwrap()
}

fn inflated(stream: &[u8], len: usize) -> Result<Vec<u8>, InflateError> {
    let mut out = vec![0xaa; len];
    Inflater::default().zlib(stream, &mut out).map(|()| out)
}

/// Numbers without a pattern.
fn noise(seed: u64) -> impl Iterator<Item = u64> {
    std::iter::successors(Some(seed), |state| {
        Some(state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407))
    })
    .map(|state| state >> 33)
}

/// Bytes of every kind that a tile may be made of.
fn kinds(len: usize) -> Vec<Vec<u8>> {
    let low = |value: u64| u8::try_from(value & 0xff).unwrap();
    let mut kinds = vec![
        vec![7; len],
        noise(1).map(low).take(len).collect(),
        // Small differences of 16 bits.
        noise(2).flat_map(|value| ((value % 23) as i16 - 11).to_le_bytes()).take(len).collect(),
        // Rare symbols have codes of 15 bits.
        noise(3)
            .map(|value| low(u64::from(value.trailing_zeros()) * 9 + value % 3))
            .take(len)
            .collect(),
    ];
    // Matches of every short distance, which overlap themselves.
    for period in 2..20 {
        let pattern: Vec<u8> =
            noise(period).map(low).take(usize::try_from(period).unwrap()).collect();
        let mut bytes: Vec<u8> = pattern.iter().copied().cycle().take(len / 2).collect();
        bytes.extend(noise(period + 99).map(low).take(5));
        bytes.extend(pattern.iter().copied().cycle().take(len.saturating_sub(bytes.len())));
        bytes.truncate(len);
        kinds.push(bytes);
    }
    kinds
}

#[test]
fn every_kind_of_bytes_comes_back_at_every_level() {
    let mut inflater = Inflater::default();
    for len in [0, 1, 2, 3, 7, 40, 300, 301, 5000, 70_000] {
        for (kind, bytes) in kinds(len).iter().enumerate() {
            for level in [0, 1, 2, 6, 9] {
                let mut out = vec![0xaa; len];
                inflater.zlib(&deflated(bytes, level), &mut out).unwrap();
                assert!(out == *bytes, "{len} bytes of kind {kind} at level {level}");
            }
        }
    }
}

#[test]
fn fixed_codes_are_read() {
    let plain = b"abababab";
    let encoded = deflated(plain, 9);
    assert_eq!(encoded[2] >> 1 & 3, 1, "the encoder chose the fixed code");
    assert_eq!(inflated(&encoded, 8).unwrap(), plain);
}

#[test]
fn a_stream_longer_than_the_output_fills_it() {
    for bytes in kinds(3000) {
        for level in [0, 6] {
            let stream = deflated(&bytes, level);
            for len in (0..3000).step_by(7).chain(2980..3000) {
                assert_eq!(inflated(&stream, len).as_deref(), Ok(&bytes[..len]));
            }
        }
    }
}

#[test]
fn a_stream_shorter_than_the_output_is_an_error() {
    for bytes in kinds(500) {
        for level in [0, 6] {
            let stream = deflated(&bytes, level);
            let expected = InflateError::TooShort { found: 500, expected: 501 };
            assert_eq!(inflated(&stream, 501), Err(expected));
            // All but the checksum, and the marker of the end before it, is needed.
            for len in 0..stream.len() - 4 {
                match inflated(&stream[..len], 500) {
                    Ok(out) => assert!(len + 2 >= stream.len() - 4 && out == bytes, "{len}"),
                    Err(error) => assert!(
                        matches!(error, InflateError::Truncated | InflateError::Code),
                        "{error}"
                    ),
                }
            }
        }
    }
}

#[test]
fn no_damaged_byte_goes_unnoticed() {
    for bytes in kinds(150) {
        for level in [0, 6] {
            let stream = deflated(&bytes, level);
            for at in 0..stream.len() {
                for bit in 0..8 {
                    let mut wrong = stream.clone();
                    wrong[at] ^= 1 << bit;
                    // A flipped bit may be one that pads a byte or make the stream a longer one;
                    // and the checksum is a weak one: some triples of bytes change it by nothing.
                    let Ok(out) = inflated(&wrong, 150) else { continue };
                    let mut bits = Bits::new(&wrong[2..]);
                    let filled = Inflater::default().blocks(&mut bits, &mut [0; 150]);
                    let unchecked = filled == Ok(Filled::StreamGoesOn) || bits.rest().len() < 4;
                    let same = adler32(&out) == adler32(&bytes);
                    assert!(same || unchecked, "bit {bit} of byte {at}");
                }
            }
        }
    }
}

#[test]
fn what_is_no_zlib_stream_says_so() {
    assert_eq!(inflated(b"", 1), Err(InflateError::Truncated));
    assert_eq!(inflated(b"II*\0", 1), Err(InflateError::Header(*b"II")));
    // A preset dictionary.
    assert_eq!(inflated(&[0x78, 0xbb, 0, 0], 1), Err(InflateError::Header([0x78, 0xbb])));
    assert_eq!(inflated(&[0x78, 0x9c, 0x07], 1), Err(InflateError::BlockType));
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(512))]

    #[test]
    fn whatever_is_encoded_comes_back(
        bytes in prop::collection::vec(prop_oneof![8 => 0..4_u8, 1 => any::<u8>()], 0..4000),
        level in 0..10_u32,
    ) {
        prop_assert_eq!(inflated(&deflated(&bytes, level), bytes.len()), Ok(bytes));
    }

    #[test]
    fn no_stream_panics(
        mut stream in prop::collection::vec(any::<u8>(), 0..400),
        len in 0..2000_usize,
    ) {
        stream.splice(..0, [0x78, 0x9c]);
        let _ = inflated(&stream, len);
    }

    #[test]
    fn damaged_streams_do_not_panic(
        kind in 0..22_usize,
        wrong in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..6),
    ) {
        let bytes = kinds(2000).swap_remove(kind);
        let mut stream = deflated(&bytes, 6);
        for (at, value) in wrong {
            let at = at.index(stream.len());
            stream[at] = value;
        }
        let _ = inflated(&stream, 2000);
    }
}

//! Reading `NumPy`'s array files.

use std::path::Path;

/// An array of floats, row-major.
pub(crate) struct Array {
    pub(crate) shape: Vec<usize>,
    pub(crate) values: Vec<f64>,
}

impl Array {
    pub(crate) fn read(path: &Path) -> Self {
        let bytes = std::fs::read(path).unwrap();
        assert!(bytes.starts_with(b"\x93NUMPY\x01\x00"), "{}", path.display());
        let data = 10 + usize::from(u16::from_le_bytes([bytes[8], bytes[9]]));
        let header = std::str::from_utf8(&bytes[10..data]).unwrap();
        let (_, shape) = header.split_once("'shape': (").unwrap();
        let (shape, _) = shape.split_once(')').unwrap();
        let shape: Vec<usize> =
            shape.split(',').filter_map(|length| length.trim().parse().ok()).collect();
        let values: Vec<f64> = if header.contains("'<f4'") {
            bytes[data..].as_chunks().0.iter().map(|b| f64::from(f32::from_le_bytes(*b))).collect()
        } else {
            assert!(header.contains("'<f8'"), "{header}");
            bytes[data..].as_chunks().0.iter().map(|b| f64::from_le_bytes(*b)).collect()
        };
        assert_eq!(shape.iter().product::<usize>(), values.len());
        Self { shape, values }
    }
}

//! `NumPy`'s array files, version 1.0.

/// A number that `NumPy` knows by name.
pub(crate) trait Element: Copy {
    /// Its `NumPy` type.
    const DESCRIPTION: &'static str;

    /// Appends its bytes.
    fn put(self, bytes: &mut Vec<u8>);
}

macro_rules! element {
    ($($type:ty: $name:literal),*) => {$(
        impl Element for $type {
            const DESCRIPTION: &'static str = $name;

            fn put(self, bytes: &mut Vec<u8>) {
                bytes.extend_from_slice(&self.to_le_bytes());
            }
        }
    )*};
}
element!(u8: "|u1", f32: "<f4", f64: "<f8");

/// The bytes of a `.npy` file with an array of `shape`, row-major.
///
/// # Panics
///
/// If `shape` does not hold as many elements as there are.
pub(crate) fn to_bytes<T: Element>(shape: &[usize], elements: &[T]) -> Vec<u8> {
    assert_eq!(
        shape.iter().product::<usize>(),
        elements.len(),
        "the shape is that of the elements"
    );
    let shape: Vec<String> = shape.iter().map(|length| format!("{length},")).collect();
    let mut header = format!(
        "{{'descr': '{}', 'fortran_order': False, 'shape': ({}), }}",
        T::DESCRIPTION,
        shape.join(" ")
    );
    // Magic, version and length take ten bytes; data start at a multiple of 64.
    let end = (10 + header.len() + 1).next_multiple_of(64);
    header.extend(std::iter::repeat_n(' ', end - 11 - header.len()));
    header.push('\n');
    let length = u16::try_from(header.len()).expect("a header of a few dozen bytes");
    let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
    bytes.extend_from_slice(&length.to_le_bytes());
    bytes.extend_from_slice(header.as_bytes());
    bytes.reserve(size_of_val(elements));
    elements.iter().for_each(|element| element.put(&mut bytes));
    bytes
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn data_start_at_a_multiple_of_64() {
        let bytes = to_bytes(&[2, 3], &[1.0_f32; 6]);
        assert_eq!(bytes.len() % 64, 24);
        assert!(bytes.starts_with(b"\x93NUMPY\x01\x00\x76\x00{'descr': '<f4'"));
        assert_eq!(bytes[127], b'\n');
    }
}

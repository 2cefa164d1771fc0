//! Samples as a file stores them: the types, and arrays of them.

/// The type of every sample of a raster.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[expect(missing_docs, reason = "each type is named after the Rust type that holds it")]
pub enum SampleType {
    U8,
    I8,
    U16,
    I16,
    U32,
    I32,
    F32,
    F64,
}

impl SampleType {
    /// Bytes a sample takes.
    #[must_use]
    pub const fn bytes(self) -> usize {
        match self {
            Self::U8 | Self::I8 => 1,
            Self::U16 | Self::I16 => 2,
            Self::U32 | Self::I32 | Self::F32 => 4,
            Self::F64 => 8,
        }
    }

    /// True of `F32` and `F64`.
    #[must_use]
    pub const fn is_float(self) -> bool {
        matches!(self, Self::F32 | Self::F64)
    }
}

/// An array of samples: row-major, the bands of a pixel side by side.
#[derive(Clone, Debug, PartialEq)]
#[expect(missing_docs, reason = "each array is named after its sample type")]
pub enum Samples {
    U8(Vec<u8>),
    I8(Vec<i8>),
    U16(Vec<u16>),
    I16(Vec<i16>),
    U32(Vec<u32>),
    I32(Vec<i32>),
    F32(Vec<f32>),
    F64(Vec<f64>),
}

/// Evaluates `$body` with `$values` bound to the vector inside, whatever its type.
macro_rules! with_samples {
    ($samples:expr, $values:ident => $body:expr) => {
        match $samples {
            $crate::raster::samples::Samples::U8($values) => $body,
            $crate::raster::samples::Samples::I8($values) => $body,
            $crate::raster::samples::Samples::U16($values) => $body,
            $crate::raster::samples::Samples::I16($values) => $body,
            $crate::raster::samples::Samples::U32($values) => $body,
            $crate::raster::samples::Samples::I32($values) => $body,
            $crate::raster::samples::Samples::F32($values) => $body,
            $crate::raster::samples::Samples::F64($values) => $body,
        }
    };
}
pub(crate) use with_samples;

impl Samples {
    /// `len` samples of `value`, brought into the type.
    #[must_use]
    pub fn filled(sample: SampleType, len: usize, value: f64) -> Self {
        fn fill<T: Sample>(len: usize, value: f64) -> Vec<T> {
            vec![T::exactly(value).unwrap_or_default(); len]
        }
        match sample {
            SampleType::U8 => Self::U8(fill(len, value)),
            SampleType::I8 => Self::I8(fill(len, value)),
            SampleType::U16 => Self::U16(fill(len, value)),
            SampleType::I16 => Self::I16(fill(len, value)),
            SampleType::U32 => Self::U32(fill(len, value)),
            SampleType::I32 => Self::I32(fill(len, value)),
            SampleType::F32 => Self::F32(fill(len, value)),
            SampleType::F64 => Self::F64(fill(len, value)),
        }
    }

    /// The samples as the host has them in memory.
    #[must_use]
    pub fn as_bytes(&self) -> &[u8] {
        with_samples!(self, values => bytemuck::cast_slice(values))
    }

    /// See [`Self::as_bytes`].
    #[must_use]
    pub fn as_bytes_mut(&mut self) -> &mut [u8] {
        with_samples!(self, values => bytemuck::cast_slice_mut(values))
    }

    /// How many samples there are, over all bands.
    #[must_use]
    pub fn len(&self) -> usize {
        with_samples!(self, values => values.len())
    }

    /// True if there is none.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The type of the samples.
    #[must_use]
    pub const fn sample_type(&self) -> SampleType {
        match self {
            Self::U8(_) => SampleType::U8,
            Self::I8(_) => SampleType::I8,
            Self::U16(_) => SampleType::U16,
            Self::I16(_) => SampleType::I16,
            Self::U32(_) => SampleType::U32,
            Self::I32(_) => SampleType::I32,
            Self::F32(_) => SampleType::F32,
            Self::F64(_) => SampleType::F64,
        }
    }

    /// Memory the samples take, in bytes.
    #[must_use]
    pub fn bytes(&self) -> usize {
        self.len() * self.sample_type().bytes()
    }
}

/// What a sample type can do.
pub(crate) trait Sample: Copy + Default + PartialEq {
    /// The sample as a number; every sample type fits without rounding.
    fn number(self) -> f64;

    /// The sample that a decimal `value` in a file's header means, if the type has one.
    ///
    /// Integers must hold the value exactly. A float takes the nearest of its type, because header
    /// values such as `-3.4028e38` were written from a float of that type.
    fn exactly(value: f64) -> Option<Self>;
}

macro_rules! integer_sample {
    ($($type:ty),*) => {$(
        impl Sample for $type {
            fn number(self) -> f64 {
                f64::from(self)
            }

            fn exactly(value: f64) -> Option<Self> {
                let whole = value.fract() == 0.0;
                let inside = (f64::from(Self::MIN)..=f64::from(Self::MAX)).contains(&value);
                #[allow(
                    clippy::cast_possible_truncation,
                    clippy::cast_sign_loss,
                    reason = "a whole number inside the type's range; not every type has both lints"
                )]
                (whole && inside).then_some(value as Self)
            }
        }
    )*};
}
integer_sample!(u8, u16, u32, i8, i16, i32);

impl Sample for f32 {
    fn number(self) -> f64 {
        f64::from(self)
    }

    fn exactly(value: f64) -> Option<Self> {
        #[expect(clippy::cast_possible_truncation, reason = "the nearest f32 is what is asked for")]
        let nearest = value as f32;
        // The decimals of ±f32::MAX may round to just past it.
        let past_the_end = nearest.is_infinite() && value.is_finite();
        Some(if past_the_end && value.abs() < 3.403e38 {
            f32::MAX.copysign(nearest)
        } else {
            nearest
        })
    }
}

impl Sample for f64 {
    fn number(self) -> f64 {
        self
    }

    fn exactly(value: f64) -> Option<Self> {
        Some(value)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn header_values_become_the_sample_they_were_written_from() {
        assert_eq!(i16::exactly(-32768.0), Some(i16::MIN));
        assert_eq!(i16::exactly(-32769.0), None);
        assert_eq!(u8::exactly(0.5), None);
        assert_eq!(u8::exactly(f64::NAN), None);
        assert_eq!(f32::exactly(-3.402_823_060_737_096_5e38), Some(-3.402_823_e38));
        assert_eq!(f32::exactly(-3.402_823_466_385_29e38), Some(f32::MIN));
        assert_eq!(f32::exactly(3.402_823_6e38), Some(f32::MAX));
        assert!(f32::exactly(f64::NAN).is_some_and(f32::is_nan));
    }

    #[test]
    fn a_fill_value_outside_the_type_becomes_zero() {
        assert_eq!(Samples::filled(SampleType::U8, 2, -9999.0), Samples::U8(vec![0, 0]));
        assert_eq!(Samples::filled(SampleType::I16, 1, -9999.0), Samples::I16(vec![-9999]));
    }
}

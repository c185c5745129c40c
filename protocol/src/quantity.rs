//! Fixed-point quantities of the wire. Each has a stated step of at most a tenth of the best sigma it carries, a fixed
//! number of bytes, and saturates instead of wrapping (angles wrap).

use std::f64::consts::TAU;

use bincode::{BorrowDecode, Decode, Encode};

use crate::angle::wrap;

/// An angle in two bytes, step 2π/65536 = 0.0055° = 96 µrad.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Default)]
pub struct Angle16(pub i16);

impl Angle16 {
    /// Step in radians.
    pub const STEP_RAD: f64 = TAU / 65536.0;

    /// The nearest step; the angle is wrapped first. Non-finite input gives 0.
    pub fn from_rad(angle: f64) -> Self {
        Self((wrap(angle) / Self::STEP_RAD).round() as i64 as i16)
    }

    /// In (−π, π].
    pub fn rad(self) -> f64 {
        wrap(f64::from(self.0) * Self::STEP_RAD)
    }
}

/// A length in two bytes: millimetres, 0 to 65.535 m.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Default)]
pub struct Millimetres(pub u16);

impl Millimetres {
    /// The nearest millimetre, saturating. Non-finite input gives 0.
    pub fn from_m(length_m: f64) -> Self {
        Self((length_m * 1e3).round().clamp(0.0, 65535.0) as u16)
    }

    /// Metres.
    pub fn m(self) -> f64 {
        f64::from(self.0) * 1e-3
    }
}

/// A standard deviation (rad or m) in one byte on a log scale: 10⁻⁵ · 2^(n/10), 10⁻⁵ … 480 in steps of 7 %.
/// Rounded up, so that the wire never makes an estimate look better than it is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct LogSigma(pub u8);

impl LogSigma {
    /// The next value not below `sigma`, saturating; NaN and infinity give the largest.
    pub fn from_value(sigma: f64) -> Self {
        if !sigma.is_finite() {
            return Self(u8::MAX);
        }
        // The small slack keeps a decoded value at its own step when it is encoded again.
        let n = ((sigma.max(1e-5) / 1e-5).log2() * 10.0 - 1e-9).ceil();
        Self(n.clamp(0.0, 255.0) as u8)
    }

    /// The value in the unit it was given in.
    pub fn value(self) -> f64 {
        1e-5 * (f64::from(self.0) / 10.0).exp2()
    }
}

/// A fraction 0 … 1 in one byte.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Default)]
pub struct Fraction8(pub u8);

impl Fraction8 {
    /// The nearest step, saturating; NaN gives 0.
    pub fn from_value(value: f64) -> Self {
        Self((value * 255.0).round().clamp(0.0, 255.0) as u8)
    }

    /// In 0 … 1.
    pub fn value(self) -> f64 {
        f64::from(self.0) / 255.0
    }
}

/// Plain bytes on the wire, so that a quantity has one size whatever its value (bincode's integers vary).
macro_rules! raw_bytes {
    ($type:ident, $inner:ty, $n:expr) => {
        impl Encode for $type {
            fn encode<E: bincode::enc::Encoder>(&self, encoder: &mut E) -> Result<(), bincode::error::EncodeError> {
                self.0.to_le_bytes().encode(encoder)
            }
        }
        impl<C> Decode<C> for $type {
            fn decode<D: bincode::de::Decoder<Context = C>>(
                decoder: &mut D,
            ) -> Result<Self, bincode::error::DecodeError> {
                Ok(Self(<$inner>::from_le_bytes(<[u8; $n]>::decode(decoder)?)))
            }
        }
        impl<'de, C> BorrowDecode<'de, C> for $type {
            fn borrow_decode<D: bincode::de::BorrowDecoder<'de, Context = C>>(
                decoder: &mut D,
            ) -> Result<Self, bincode::error::DecodeError> {
                Self::decode(decoder)
            }
        }
    };
}

raw_bytes!(Angle16, i16, 2);
raw_bytes!(Millimetres, u16, 2);
raw_bytes!(LogSigma, u8, 1);
raw_bytes!(Fraction8, u8, 1);

#[cfg(test)]
mod tests {
    use std::f64::consts::PI;

    use super::*;
    use crate::angle::difference;

    #[test]
    fn an_angle_comes_back_within_half_a_step_and_wraps() {
        for i in -4000..4000 {
            let angle = f64::from(i) * 0.00173;
            let back = Angle16::from_rad(angle).rad();
            assert!(difference(back, angle).abs() <= 0.5 * Angle16::STEP_RAD + 1e-12, "{angle}");
        }
        assert_eq!(Angle16::from_rad(PI), Angle16::from_rad(-PI));
        assert_eq!(Angle16::from_rad(PI).rad(), PI);
        assert_eq!(Angle16::from_rad(f64::NAN), Angle16(0));
    }

    #[test]
    fn lengths_and_fractions_saturate() {
        assert_eq!(
            [-1.0, 0.0004, 2.0, 65.535, 1e9, f64::NAN].map(Millimetres::from_m).map(|m| m.0),
            [0, 0, 2000, 65535, 65535, 0]
        );
        assert_eq!([-1.0, 0.5, 1.0, 7.0, f64::NAN].map(Fraction8::from_value).map(|f| f.0), [0, 128, 255, 255, 0]);
    }

    #[test]
    fn a_sigma_is_never_sent_smaller_than_it_is_nor_much_larger() {
        for i in 0..1000 {
            let sigma = 1.1e-5 * f64::from(i).mul_add(0.017, 0.0).exp();
            if sigma > 400.0 {
                break;
            }
            let sent = LogSigma::from_value(sigma);
            assert!(sent.value() >= sigma * (1.0 - 1e-9) && sent.value() <= sigma * 1.0719, "{sigma}");
            assert_eq!(LogSigma::from_value(sent.value()), sent);
        }
        assert_eq!([f64::NAN, f64::INFINITY, 1e9].map(LogSigma::from_value), [LogSigma(255); 3]);
        assert_eq!([0.0, -1.0, 1e-9].map(LogSigma::from_value), [LogSigma(0); 3]);
    }

    #[test]
    fn every_quantity_has_one_size_whatever_its_value() {
        let len = |value: &dyn Fn() -> Vec<u8>| value().len();
        let config = bincode::config::standard();
        for i in [i16::MIN, -1, 0, 300, i16::MAX] {
            assert_eq!(len(&|| bincode::encode_to_vec(Angle16(i), config).unwrap()), 2);
            assert_eq!(len(&|| bincode::encode_to_vec(Millimetres(i as u16), config).unwrap()), 2);
        }
        assert_eq!(len(&|| bincode::encode_to_vec((LogSigma(255), Fraction8(255)), config).unwrap()), 2);
    }
}

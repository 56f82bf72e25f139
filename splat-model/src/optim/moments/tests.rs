use super::*;
use crate::gaussians::values_of;

#[test]
fn bits_have_names_and_sizes() {
    for (bits, text, of_48, of_3) in [(MomentBits::ThirtyTwo, "32", 384, 24), (MomentBits::Eight, "8", 96, 8)] {
        assert_eq!((bits.to_string().as_str(), text.parse()), (text, Ok(bits)));
        assert_eq!([bits.bytes(48), bits.bytes(3)], [of_48, of_3]);
        assert_eq!(serde_json::to_string(&bits).unwrap(), text);
    }
    for wrong in ["16", "", "256", "f16"] {
        assert!(wrong.parse::<MomentBits>().unwrap_err().contains("expected 32 or 8"), "{wrong}");
    }
}

#[test]
fn moments_hold_as_many_bytes_as_they_say() {
    let param = Tensor::<3>::zeros([7, 9, 3], &Device::flex());
    for bits in MomentBits::ALL {
        let moments = Moments::with_bits(&param, bits);
        let bytes = match moments.stored() {
            Stored::Full { m, v } => 4 * (m.shape().num_elements() + v.shape().num_elements()),
            Stored::Packed(words) => 4 * words.shape().num_elements(),
        };
        assert_eq!((bytes, moments.bits()), (7 * bits.bytes(27), bits));
    }
}

impl<const D: usize> Moments<D> {
    /// The tensors as numbers, for comparisons: both sums, or the words and nothing.
    pub(crate) fn numbers(&self) -> [Vec<f32>; 2] {
        match self.stored() {
            Stored::Full { m, v } => [values_of(m.clone()), values_of(v.clone())],
            Stored::Packed(words) => {
                let words = words.clone().into_data().try_into_vec::<i32>().expect("words are i32");
                // Numbers that compare as their bits do.
                let halves = |shift: u32| words.iter().map(|word| (*word as u32 >> shift & 0xffff) as f32).collect();
                [halves(0), halves(16)]
            }
        }
    }
}

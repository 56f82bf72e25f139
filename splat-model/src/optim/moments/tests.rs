use super::*;

#[test]
fn bits_have_names_and_sizes() {
    for (bits, text, of_48, of_3) in
        [(MomentBits::ThirtyTwo, "32", 384, 24), (MomentBits::Sixteen, "16", 192, 12), (MomentBits::Eight, "8", 96, 8)]
    {
        assert_eq!((bits.to_string().as_str(), text.parse()), (text, Ok(bits)));
        assert_eq!([bits.bytes(48), bits.bytes(3)], [of_48, of_3]);
        assert_eq!(serde_json::to_string(&bits).unwrap(), text);
    }
    for wrong in ["12", "", "256", "f16"] {
        assert!(wrong.parse::<MomentBits>().unwrap_err().contains("expected 32, 16 or 8"), "{wrong}");
    }
}

#[test]
fn moments_hold_as_many_bytes_as_they_say() {
    let param = Tensor::<3>::zeros([7, 9, 3], &Device::flex());
    for bits in MomentBits::ALL {
        let moments = Moments::with_bits(&param, bits);
        let bytes = match moments.stored() {
            Stored::Full { m, v } => 4 * (m.shape().num_elements() + v.shape().num_elements()),
            Stored::Packed { words, .. } => 4 * words.shape().num_elements(),
        };
        assert_eq!((bytes, moments.bits()), (7 * bits.bytes(27), bits));
    }
}

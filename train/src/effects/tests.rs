use super::*;

#[test]
fn words_mean_what_they_say() {
    use EffectKind::{Antialias, Exposure, Masks};
    let of = |text: &str| text.parse::<EffectsArg>().unwrap().of(&[Antialias, Exposure]);
    assert_eq!(EffectsArg::default(), "auto".parse().unwrap());
    assert_eq!(of("auto"), [Antialias, Exposure]);
    assert_eq!(of("none"), []);
    assert_eq!(of("masks"), [Masks]);
    assert_eq!(of("masks, exposure"), [Exposure, Masks]);
    assert_eq!(of("+masks"), [Antialias, Exposure, Masks]);
    assert_eq!(of("-exposure"), [Antialias]);
    assert_eq!(of("auto,-exposure,+masks"), [Antialias, Masks]);
    assert_eq!(of("none,+masks"), [Masks]);
    assert_eq!(of("+masks,-masks"), [Antialias, Exposure]);
}

#[test]
fn words_that_mean_nothing_are_refused() {
    for (text, part) in
        [("fog", "\"fog\""), ("", "\"\""), ("+", "\"\""), ("auto,masks", "stands alone"), ("masks,auto", "\"auto\"")]
    {
        let message = text.parse::<EffectsArg>().unwrap_err();
        assert!(message.contains(part) && (message.contains("expected one of") || part == "stands alone"), "{message}");
    }
}

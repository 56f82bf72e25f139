use super::*;

#[test]
fn words_mean_what_they_say() {
    let of = |text: &str| text.parse::<TrainBackground>().unwrap();
    let fixed = |colour| TrainBackground { backdrop: Backdrop::Fixed, colour };
    assert_eq!(of("white"), fixed([1.0; 3]));
    assert_eq!(of("0.25, 0,1"), fixed([0.25, 0.0, 1.0]));
    assert_eq!(of("environment").backdrop, Backdrop::Environment { degree: 3 });
    assert_eq!(of("environment:0").backdrop, Backdrop::Environment { degree: 0 });
    assert_eq!(["random", "learned"].map(|text| of(text).backdrop), [Backdrop::Random, Backdrop::Learned]);
    let mut config = TrainConfig::default();
    of("white").configure(&mut config);
    assert_eq!((config.background, config.backdrop), ([1.0; 3], Backdrop::Fixed));
    for text in ["0.25,0,1", "random", "learned", "environment:2"] {
        assert_eq!(of(text).to_string(), text);
    }
    for text in ["", "grey", "1,2,3", "0.1,0.2", "environment:5", "0.1,nan,0.2"] {
        let message = text.parse::<TrainBackground>().unwrap_err();
        assert!(message.contains("expected black, white"), "{message}");
    }
}

#[test]
fn what_is_shown_is_a_colour_or_a_file() {
    let of = |text: &str| text.parse::<ShownBackground>();
    let trained = TrainedAs { background: [0.25; 3], ..TrainedAs::default() };
    let read = |asked: Option<&str>, trained| {
        let asked = asked.map(|text| of(text).unwrap());
        ShownBackground::read(asked.as_ref(), Path::new("nowhere/scene.ply"), trained)
    };
    assert_eq!(read(Some("black"), &trained).unwrap(), Background::Colour([0.0; 3]));
    assert_eq!(read(Some("1,0.5,0"), &trained).unwrap(), Background::Colour([1.0, 0.5, 0.0]));
    assert_eq!(read(None, &trained).unwrap(), Background::Colour([0.25; 3]));
    assert!(read(Some("nowhere/background.json"), &trained).unwrap_err().to_string().contains("nowhere"));
    assert!(of("random").unwrap_err().contains("background.json"));
}

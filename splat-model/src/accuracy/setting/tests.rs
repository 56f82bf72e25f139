use super::*;

/// Fails if a preset sets a dial that the table does not have, or a value that it does not have.
#[test]
fn every_preset_is_made_of_dials_of_the_table() {
    for preset in Preset::ALL {
        assert_eq!(preset.setting().apply(RenderOptions::standard()), preset.options(), "{preset}");
        assert_eq!(preset.to_string().parse(), Ok(preset));
    }
    assert!(Preset::Standard.setting().is_empty());
    assert_eq!(Preset::Fast.setting().to_string(), "alpha_min 4/255, transmittance_min 1e-3");
    assert!("slow".parse::<Preset>().unwrap_err().to_string().contains("fast, standard or exact"));
}

#[test]
fn a_setting_survives_a_file_and_nonsense_does_not() {
    let setting = Setting::new([("alpha_min", "2/255"), ("sh_degree", "1")]).unwrap();
    let text = serde_json::to_string(&setting).unwrap();
    assert_eq!(text, r#"{"alpha_min":"2/255","sh_degree":"1"}"#);
    assert_eq!(serde_json::from_str::<Setting>(&text).unwrap(), setting);
    let refused = |text: &str| serde_json::from_str::<Setting>(text).unwrap_err().to_string();
    assert!(refused(r#"{"alpha":"1"}"#).contains("there is no dial \"alpha\"; the dials are alpha_min, "));
    assert!(refused(r#"{"alpha_min":"0.5"}"#).contains("no value \"0.5\"; its values are 2^-26, 1/4096"));
}

#[test]
fn what_is_turned_is_turned_and_nothing_else() {
    let base = RenderOptions::standard().with_near(0.5).with_antialias(true);
    let setting = Setting::new([("transmittance_min", "0"), ("alpha_min", "1/1024")]).unwrap();
    let turned = setting.apply(base);
    assert_eq!(turned, base.with_transmittance_min(0.0).with_alpha_min(1.0 / 1024.0));
    assert_eq!(Setting::between(&base, &turned), setting);
    assert_eq!(setting.judge(), Judge::Exact);
    let choice = Setting::new([("sh_degree", "1")]).unwrap();
    assert_eq!(choice.judge(), Judge::Photographs);
    let coarser = Setting::new([("alpha_min", "1/255")]).unwrap();
    assert_eq!(choice.and(&setting).and(&coarser).to_string(), "alpha_min 1/255, sh_degree 1, transmittance_min 0");
}

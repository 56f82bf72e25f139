use super::*;

#[test]
fn a_strategy_is_written_by_its_name() {
    for config in [DensityConfig::default(), AdaptiveConfig::absgrad().into(), McmcConfig::default().into()] {
        let text = serde_json::to_string(&config).unwrap();
        assert_eq!(serde_json::from_str::<DensityConfig>(&text).unwrap(), config, "{text}");
    }
    let mcmc: DensityConfig = serde_json::from_str(r#"{"strategy": "mcmc", "growth": 1.1}"#).unwrap();
    assert_eq!(mcmc, McmcConfig { growth: 1.1, ..McmcConfig::default() }.into());
    for wrong in [r#"{"strategy": "mcmc", "split_scale": 1}"#, r#"{"strategy": "none"}"#, "{}"] {
        assert!(serde_json::from_str::<DensityConfig>(wrong).is_err(), "{wrong}");
    }
}

#[test]
fn every_strategy_has_the_cap_that_it_is_given() {
    for config in [DensityConfig::default(), McmcConfig::default().into()] {
        assert_eq!(config.with_max_splats(77).max_splats(), 77);
    }
}

use super::*;

#[test]
fn a_missing_model_is_explained_by_the_features() {
    let features = |count: u64| (0..4).map(|i| (i.to_string(), count + i)).collect::<BTreeMap<_, _>>();
    let few = no_model(4, &features(3), Path::new("a.log")).to_string();
    assert!(few.contains("4 of them have fewer than 100 features (median 5)") && few.contains("light"), "{few}");
    let enough = no_model(4, &features(900), Path::new("a.log")).to_string();
    assert!(enough.contains("enough features (median 902)") && enough.contains("two thirds"), "{enough}");
    assert!(enough.contains("a.log"), "{enough}");
    assert!(no_model(4, &BTreeMap::new(), Path::new("a.log")).to_string().contains("median 0"));
}

#[test]
fn photographs_that_are_not_placed_are_named() {
    assert_eq!(not_placed(9, &[], 2), None);
    let names: Vec<String> = (0..6).map(|i| format!("{i}.jpg")).collect();
    let said = not_placed(9, &names, 3).unwrap();
    for part in ["less than half: 3 of 9", "3 parts", "0.jpg, 1.jpg, 2.jpg, 3.jpg, 4.jpg, …"] {
        assert!(said.contains(part), "{part}: {said}");
    }
    let said = not_placed(9, &names[..1], 1).unwrap();
    assert!(said.starts_with("8 of 9") && said.contains("Not used: 0.jpg. "), "{said}");
}

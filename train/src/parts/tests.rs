use super::*;

#[test]
fn names_are_those_of_their_part() {
    let registry = Registry::new().loss("mine", || |seen: &LossInputs| seen.alpha.clone().mean());
    assert_eq!(registry.names(Part::Loss), ["l1", "l1-ssim", "l2", "mine", "surfaces"]);
    assert!(registry.names(Part::Strategy).is_empty() && registry.names(Part::Effect).is_empty());
}

#[test]
#[should_panic(expected = "two parts named `l1-ssim`")]
fn names_of_the_program_are_taken() {
    drop(Registry::new().loss(USUAL_LOSS, || |seen: &LossInputs| seen.alpha.clone().mean()));
}

#[test]
#[should_panic(expected = "no name that an option can take")]
fn names_are_words_of_options() {
    drop(Registry::new().loss("a,b", || |seen: &LossInputs| seen.alpha.clone().mean()));
}

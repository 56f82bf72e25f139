use burn::tensor::{Float, Int};

use super::*;
use crate::gaussians::values_of;

#[test]
fn a_tensor_of_several_parts_is_put_whole() {
    let count = 2 * AT_ONCE + 3;
    let words = Tensor::<1, Int>::arange(0..count as i64, &Device::flex()).cast(DType::I32).reshape([count, 1]);
    let mut state = State::default();
    state.put("values", words.clone().float());
    state.put("words", words);
    // All of them are below 2²⁴, and so exact.
    assert!(state.entries["values"].as_slice::<f32>().unwrap().iter().copied().eq((0..count).map(|i| i as f32)));
    assert!(state.entries["words"].as_slice::<i32>().unwrap().iter().copied().eq(0..count as i32));
}

/// Whether a result is the error that says this.
fn is_refused<T>(found: Result<T, StateError>, said: &str) -> bool {
    found.is_err_and(|error| error.to_string().contains(said))
}

#[test]
fn what_is_put_is_taken_once() {
    let device = Device::flex();
    let mut state = State::default();
    state.put("means", Tensor::<2>::from_floats([[1.0, -2.5], [f32::MIN_POSITIVE, f32::NAN]], &device));
    state.tell("rate", &0.1_f64.next_up()).unwrap();
    let means: Tensor<2> = state.take_shaped("means", [2, 2], &device).unwrap();
    assert_eq!(values_of(means)[..3], [1.0, -2.5, f32::MIN_POSITIVE]);
    assert_eq!(state.told::<f64>("rate").unwrap(), 0.1_f64.next_up());
    assert!(is_refused(state.take::<2, Float>("means", &device), "there is no `means`"));
    state.finish().unwrap();
}

#[test]
fn words_are_taken_bit_for_bit_and_as_nothing_else() {
    let device = Device::flex();
    // As a float, the first would be NaN.
    let words = [0x7fa0_0001, i32::MIN, -1, 0];
    let mut state = State::default();
    state.put("words", Tensor::<2, Int>::from_data(TensorData::new(words.to_vec(), [2, 2]), (&device, DType::I32)));
    let found = state.clone().take_shaped::<2, Int>("words", [2, 2], &device).unwrap();
    assert_eq!(found.into_data().try_into_vec::<i32>().unwrap(), words);
    assert!(is_refused(
        state.clone().take_shaped::<2, Int>("words", [4, 1], &device),
        "has the shape [2, 2], expected [4, 1]"
    ));
    assert!(is_refused(state.take::<2, Float>("words", &device), "there is no `words`"));
}

#[test]
fn parts_have_names_of_their_own() {
    let device = Device::flex();
    let one = |value: f32| Tensor::<1>::from_floats([value], &device);
    let mut state = State::default();
    for (name, value) in [("a", 1.0), ("ab", 2.0)] {
        let mut part = State::default();
        part.put("x", one(value));
        part.tell("y/z", &value).unwrap();
        state.put_part(name, part);
    }
    assert!(state.has("a") && state.has("a/y") && !state.has("b"));
    let mut part = state.take_part("a");
    assert_eq!(values_of::<1>(part.take("x", &device).unwrap()), [1.0]);
    assert_eq!(part.take_part("y").told::<f32>("z").unwrap(), 1.0);
    part.finish().unwrap();
    assert!(!state.has("a"));
    let lacking = state.clone().take_part("ab").told::<f32>("none").unwrap_err();
    assert!(lacking.to_string().contains("`ab/none`"), "{lacking}");
    assert!(is_refused(state.finish(), "`ab/x` is unknown"));
    assert!(is_refused(state.load_part("ab", |part| part.told::<f32>("y/z")), "`ab/x` is unknown"));
}

#[test]
fn other_shapes_and_kinds_are_refused() {
    let device = Device::flex();
    let mut state = State::default();
    state.put("means", Tensor::<2>::zeros([2, 3], &device));
    state.tell("step", &"ten").unwrap();
    assert!(is_refused(
        state.take_shaped::<2, Float>("means", [3, 2], &device),
        "has the shape [2, 3], expected [3, 2]"
    ));
    state.put("means", Tensor::<2>::zeros([2, 3], &device));
    assert!(is_refused(state.take::<1, Float>("means", &device), "has the shape [2, 3], expected 1 dimensions"));
    assert!(is_refused(state.told::<usize>("step"), "`step` does not have the form"));
}

use super::*;
use crate::gaussians::values_of;

#[test]
fn a_tensor_of_several_parts_is_put_whole() {
    let count = 2 * AT_ONCE + 3;
    let words = Tensor::<1, Int>::arange(0..count as i64, &Device::flex()).cast(DType::I32).reshape([count, 1]);
    let mut state = State::default();
    state.put("values", words.clone().float());
    state.put_words("words", words);
    // All of them are below 2²⁴, and so exact.
    assert!(state.arrays["values"].as_slice::<f32>().unwrap().iter().copied().eq((0..count).map(|i| i as f32)));
    assert!(state.arrays["words"].as_slice::<i32>().unwrap().iter().copied().eq(0..count as i32));
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
    assert!(matches!(state.take::<2>("means", &device), Err(StateError::Missing { name }) if name == "means"));
    state.finish().unwrap();
}

#[test]
fn words_are_taken_bit_for_bit_and_as_nothing_else() {
    let device = Device::flex();
    // As a float, the first would be NaN.
    let words = [0x7fa0_0001, i32::MIN, -1, 0];
    let mut state = State::default();
    state.put_words("words", Tensor::from_data(TensorData::new(words.to_vec(), [2, 2]), (&device, DType::I32)));
    let found = state.clone().take_words("words", [2, 2], &device).unwrap();
    assert_eq!(found.into_data().try_into_vec::<i32>().unwrap(), words);
    assert!(matches!(state.clone().take_words("words", [4, 1], &device), Err(StateError::Shape { .. })));
    assert!(matches!(state.take::<2>("words", &device), Err(StateError::Missing { .. })));
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
    assert_eq!(values_of(part.take::<1>("x", &device).unwrap()), [1.0]);
    assert_eq!(part.in_part("y", |part| part.told::<f32>("z")).unwrap(), 1.0);
    part.finish().unwrap();
    assert!(!state.has("a"));
    let lacking = state.in_part("ab", |part| part.told::<f32>("none")).unwrap_err();
    assert!(lacking.to_string().contains("`ab/none`"), "{lacking}");
    let left = state.load_part("ab", |part| part.told::<f32>("y/z")).unwrap_err();
    assert!(matches!(left, StateError::Unknown { name } if name == "ab/x"));
    assert!(matches!(state.finish(), Err(StateError::Unknown { name }) if name == "ab/x"));
}

#[test]
fn other_shapes_and_kinds_are_refused() {
    let device = Device::flex();
    let mut state = State::default();
    state.put("means", Tensor::<2>::zeros([2, 3], &device));
    state.tell("step", &"ten").unwrap();
    assert!(matches!(state.take_shaped::<2>("means", [3, 2], &device), Err(StateError::Shape { .. })));
    state.put("means", Tensor::<2>::zeros([2, 3], &device));
    assert!(matches!(state.take::<1>("means", &device), Err(StateError::Shape { .. })));
    assert!(matches!(state.told::<usize>("step"), Err(StateError::Fact { .. })));
}

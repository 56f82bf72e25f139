use burn::tensor::{Device, Int, Tensor};

use super::*;

fn state() -> State {
    let mut state = State::default();
    state.put("scene/means", Tensor::<2>::from_floats([[1.0, -2.5], [f32::MIN_POSITIVE, 1e30]], &Device::flex()));
    state.put("none", Tensor::<1>::zeros([0], &Device::flex()));
    state.put("scene/words", Tensor::<2, Int>::from_data([[7, -1]], (&Device::flex(), DType::I32)));
    state.tell("step", &17).unwrap();
    state.tell("rate", &0.1_f64.next_up()).unwrap();
    state
}

#[test]
fn what_is_written_is_read() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.safetensors");
    state().write(&path).unwrap();
    state().write(&path).unwrap();
    assert_eq!(State::read(&path).unwrap(), state());
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1, "a temporary file is left");
    let other = folder.path().join("other");
    fs::write(&other, "").unwrap();
    let [written, other] = [path, other].map(|path| fs::metadata(path).unwrap().permissions());
    assert_eq!(written, other);
}

#[test]
fn a_flipped_bit_or_a_missing_end_is_noticed() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.safetensors");
    state().write(&path).unwrap();
    let bytes = fs::read(&path).unwrap();
    for at in 0..bytes.len() {
        for bit in [0, 3, 7] {
            let mut changed = bytes.clone();
            changed[at] ^= 1 << bit;
            fs::write(&path, changed).unwrap();
            // Blanks between header and data have no meaning.
            let found = State::read(&path);
            let harmless = found.as_ref().is_ok_and(|found| *found == state());
            assert!(found.is_err() || harmless && bytes[at] == b' ', "byte {at}, bit {bit}: {found:?}");
        }
    }
    for length in 0..bytes.len() {
        fs::write(&path, &bytes[..length]).unwrap();
        let error = State::read(&path).unwrap_err().to_string();
        assert!(error.contains("a.safetensors"), "{error}");
    }
}

#[test]
fn other_files_are_told_apart() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.safetensors");
    let read = || State::read(&path).unwrap_err();
    assert!(read().to_string().contains("could not read it"), "{}", read());
    let state = state();
    safetensors::serialize_to_file(state.views(), None, &path).unwrap();
    assert!(read().to_string().contains("tensors alone"), "{}", read());
    let newer = HashMap::from([(FORMAT_KEY.to_owned(), "3".to_owned())]);
    safetensors::serialize_to_file(state.views(), Some(newer), &path).unwrap();
    assert!(read().to_string().contains("\"3\""), "{}", read());
    fs::write(&path, b"").unwrap();
    assert!(read().to_string().contains("the file is damaged"), "{}", read());
}

#[test]
fn a_state_is_known_by_its_header() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.safetensors");
    state().write(&path).unwrap();
    let whole = fs::read(&path).unwrap();
    fs::write(&path, &whole[..whole.len() - 1]).unwrap();
    assert!(State::is_in(&path), "its values are damaged");
    for other in [&whole[..40], b"", b"state of another program"] {
        fs::write(&path, other).unwrap();
        assert!(!State::is_in(&path), "{other:?}");
    }
    safetensors::serialize_to_file(state().views(), None, &path).unwrap();
    assert!(!State::is_in(&path), "tensors alone");
    assert!(!State::is_in(folder.path()) && !State::is_in(&folder.path().join("none")));
}

#[test]
fn what_cannot_be_written_leaves_the_old() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.safetensors");
    // A folder in place of the file.
    fs::create_dir(&path).unwrap();
    let error = State::default().write(&path).unwrap_err().to_string();
    assert!(error.contains("a.safetensors") && error.contains("room"), "{error}");
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1, "a temporary file is left");
}

use super::*;

#[test]
#[cfg(feature = "cube")]
fn a_cpu_device_has_none() {
    assert_eq!(Abilities::of(&Device::flex()), None);
    assert_eq!(Abilities::of(&Device::flex().autodiff()), None);
}

#[test]
fn everything_fits_a_cpu() {
    let need = Need::floats("sh", [usize::MAX, 25, 3], "");
    assert_eq!(check_fits(&Device::flex().autodiff(), &[need]), Ok(()));
}

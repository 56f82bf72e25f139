//! The devices on which the tests across crates run.

use std::sync::OnceLock;

use burn::tensor::Device;
use splat_hard_cases::{Processor, TestDevice};
use splat_train::device::{Adapter, AdapterKind, DeviceName, built, open};

use crate::data::announce;

/// Devices for tests in f32: [`cpu_devices`], and the GPU by the rules of [`gpu`].
pub fn devices() -> Vec<(&'static str, Device)> {
    let mut devices = cpu_devices();
    devices.extend(gpu().map(|device| ("gpu", device)));
    devices
}

/// Returns [`devices`] as places for the battery of hard cases.
pub fn places() -> Vec<TestDevice> {
    let cpu = |(name, device): (&'static str, Device)| {
        let name = name.into();
        TestDevice { name, device, processor: Processor::Cpu, software: false }
    };
    let mut places: Vec<TestDevice> = cpu_devices().into_iter().map(cpu).collect();
    places.extend(gpu().map(|device| {
        let software = adapter().expect("it is open").kind == AdapterKind::Software;
        TestDevice { name: "gpu".into(), device, processor: Processor::Gpu, software }
    }));
    places
}

/// CPU devices, for tests in f64, which kernels do not support, and for guarantees of the CPU path only.
pub fn cpu_devices() -> Vec<(&'static str, Device)> {
    vec![("flex", Device::flex()), ("ndarray", ndarray())]
}

/// Device of the ndarray backend, which this project supports beside Flex.
#[allow(deprecated, reason = "burn-ndarray is deprecated in favour of burn-flex; this project supports both")]
pub fn ndarray() -> Device {
    Device::ndarray()
}

/// Returns the best adapter that the runtimes of this build find, a driver in software if there is nothing better. The
/// variable `SPLAT_GPU` controls the result: `skip` returns `None`, `require` panics if there is no adapter, and unset
/// returns `None` if there is no adapter. `SPLAT_RUNTIME` names the only runtime that is asked. The first call prints the adapter or the reason for skipping, and from then on
/// the kernels' buffers begin as NaN.
///
/// # Panics
/// If a required adapter is missing, or if the variable has another value.
pub fn gpu() -> Option<Device> {
    static GPU: OnceLock<Option<Device>> = OnceLock::new();
    GPU.get_or_init(|| {
        let wish = std::env::var("SPLAT_GPU").unwrap_or_default();
        let (line, device) = admit(&wish, find).unwrap_or_else(|failure| panic!("{failure}"));
        announce(&line);
        splat_op::test_hooks::poison(true);
        device
    })
    .clone()
}

/// Finds the best adapter and its name, or the reason why there is none.
fn find() -> Result<(String, Device), String> {
    let found = adapter()?;
    let name = open(&found).map_err(|error| error.to_string())?;
    Ok((name, found.device))
}

fn adapter() -> Result<Adapter, String> {
    let name = match std::env::var("SPLAT_RUNTIME") {
        Err(_) => "gpu".into(),
        Ok(wish) if built().any(|runtime| runtime == wish) => wish,
        Ok(wish) => return Err(format!("SPLAT_RUNTIME={wish} is no runtime of this build")),
    };
    let name: DeviceName = name.parse()?;
    Ok(name.find().map_err(|error| error.to_string())?.expect("a GPU's name is never the CPU"))
}

/// Applies the rules of `SPLAT_GPU`: returns the line to print and the device, or the failure.
fn admit<D>(wish: &str, find: impl FnOnce() -> Result<(String, D), String>) -> Result<(String, Option<D>), String> {
    match wish {
        "skip" => Ok(("SKIPPED: tests on a GPU: SPLAT_GPU=skip".into(), None)),
        "" | "require" => match find() {
            Ok((name, device)) => Ok((format!("tests on a GPU run on {name}"), Some(device))),
            Err(why) if wish == "require" => Err(format!("SPLAT_GPU=require: {why}")),
            Err(why) => Ok((format!("SKIPPED: tests on a GPU: {why}"), None)),
        },
        other => Err(format!("SPLAT_GPU={other} is not supported: set it to `require` or `skip`, or unset it")),
    }
}

#[cfg(test)]
mod tests {
    use burn::tensor::Tensor;

    use super::*;

    fn there() -> Result<(String, u8), String> {
        Ok(("a card".into(), 7))
    }

    fn not_there() -> Result<(String, u8), String> {
        Err("no driver".into())
    }

    #[test]
    fn require_fails_without_an_adapter() {
        assert_eq!(admit("require", there).expect("there is one").1, Some(7));
        let failure = admit("require", not_there).expect_err("there is none");
        assert!(failure.contains("require") && failure.contains("no driver"), "{failure}");
    }

    #[test]
    fn unset_skips_without_an_adapter_and_says_so() {
        assert_eq!(admit("", there).expect("no failure").1, Some(7));
        let (line, device) = admit("", not_there).expect("no failure");
        assert!(device.is_none() && line.starts_with("SKIPPED") && line.contains("no driver"), "{line}");
    }

    #[test]
    fn skip_does_not_even_look() {
        let look = || -> Result<(String, u8), String> { panic!("looked") };
        let (line, device) = admit("skip", look).expect("no failure");
        assert!(device.is_none() && line.starts_with("SKIPPED"), "{line}");
    }

    #[test]
    fn other_values_are_refused() {
        for wish in ["required", "1", "REQUIRE"] {
            assert!(admit(wish, there).expect_err(wish).contains(wish));
        }
    }

    /// Tests with Burn's own operations that the device opens, computes and returns results.
    #[test]
    fn the_gpu_computes() {
        let Some(device) = gpu() else { return };
        let tensor = Tensor::<1>::from_floats([1.0, 2.0, 3.0], &device) * 2.0;
        assert_eq!(tensor.sum().into_scalar::<f32>(), 12.0);
    }
}

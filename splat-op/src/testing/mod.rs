//! Helpers shared by the unit tests of the stages.

pub mod blending;
pub mod ceiling;
pub mod ellipses;
pub mod finite;
#[cfg(feature = "cube")]
pub mod gpu;
pub mod lenses;
#[path = "../../../tests/hard-cases/src/random.rs"]
pub mod random;

/// Every device: Flex, NdArray and a GPU, where there is one.
pub fn devices() -> Vec<burn::tensor::Device> {
    use burn::tensor::Device;

    #[expect(deprecated, reason = "NdArray is the second CPU backend that the project supports")]
    let cpu = [Device::flex(), Device::ndarray()];
    #[cfg(feature = "cube")]
    let gpu = gpu::device();
    #[cfg(not(feature = "cube"))]
    let gpu = None;
    cpu.into_iter().chain(gpu).collect()
}

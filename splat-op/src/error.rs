//! What can go wrong at the boundary of the operation.

use thiserror::Error;

/// An input that the operation refuses, named so that it can be mended.
#[derive(Debug, Clone, PartialEq, Error)]
#[non_exhaustive]
pub enum SplatError {
    /// A tensor has another shape than its argument documents.
    #[error("`{name}` has shape {found:?}, expected {expected}: {hint}")]
    Shape {
        /// The argument.
        name: &'static str,
        /// Its shape.
        found: Vec<usize>,
        /// The documented shape, with letters for the free dimensions.
        expected: &'static str,
        /// What to change.
        hint: String,
    },
    /// A tensor's element type differs from that of the means, or is none that its device computes in: f32, and f64 on
    /// CPUs.
    #[error("`{name}` holds {found}, expected {expected}: cast it with `Tensor::cast`")]
    DType {
        /// The argument.
        name: &'static str,
        /// Its element type.
        found: String,
        /// The element type of the means.
        expected: String,
    },
    /// A tensor lives on another device than the means.
    #[error("`{name}` is on device {found}, expected {expected}: move it with `Tensor::to_device`")]
    Device {
        /// The argument.
        name: &'static str,
        /// Its device.
        found: String,
        /// The device of the means.
        expected: String,
    },
    /// Something does not fit into one buffer of the GPU.
    #[error(
        "`{what}` needs {needed_bytes} bytes in one buffer, and the largest of this device holds {limit_bytes} bytes: {hint}"
    )]
    TooLarge {
        /// What lies in the buffer: an argument or a result.
        what: &'static str,
        /// Its size.
        needed_bytes: u64,
        /// The size of the device's largest buffer.
        limit_bytes: u64,
        /// What to change.
        hint: &'static str,
    },
    /// A camera or option outside its range.
    #[error("`{field}` is {found}, expected {expected}")]
    Value {
        /// The field.
        field: &'static str,
        /// Its value.
        found: String,
        /// The range.
        expected: &'static str,
    },
}

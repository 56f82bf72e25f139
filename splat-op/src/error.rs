//! Errors at the boundary of the operation.

use thiserror::Error;

/// A result, or the input that is invalid.
pub type Result<T, E = SplatError> = std::result::Result<T, E>;

/// An invalid input of the operation. The message names the input and what to change.
#[derive(Debug, Clone, PartialEq, Error)]
#[non_exhaustive]
pub enum SplatError {
    /// The shape of a tensor differs from the one that its argument documents.
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
    /// The element type of a tensor differs from that of the means, or its device does not support it. Supported are f32, and f64 on CPUs.
    #[error("`{name}` holds {found}, expected {expected}: cast it with `Tensor::cast`")]
    DType {
        /// The argument.
        name: &'static str,
        /// Its element type.
        found: String,
        /// The element type of the means.
        expected: String,
    },
    /// A tensor is on another device than the means.
    #[error("`{name}` is on device {found}, expected {expected}: move it with `Tensor::to_device`")]
    Device {
        /// The argument.
        name: &'static str,
        /// Its device.
        found: String,
        /// The device of the means.
        expected: String,
    },
    /// An argument or result does not fit into one buffer of the GPU.
    #[error(
        "`{what}` needs {needed_bytes} bytes in one buffer, and the largest of this device holds {limit_bytes} bytes: {hint}"
    )]
    TooLarge {
        /// The argument or result.
        what: &'static str,
        /// Its size, bytes.
        needed_bytes: u64,
        /// The size of the device's largest buffer, bytes.
        limit_bytes: u64,
        /// What to change.
        hint: &'static str,
    },
    /// A field of a camera or of the options is out of range.
    #[error("`{field}` is {found}, expected {expected}")]
    Value {
        /// The field.
        field: &'static str,
        /// Its value.
        found: String,
        /// The accepted values.
        expected: &'static str,
    },
}

//! Weights from a file: safetensors with the names and shapes of the package's own `state_dict`.

use std::fs::File;
use std::io::Read;
use std::path::Path;

use burn::tensor::{Device, Tensor, TensorData};
use safetensors::{Dtype, SafeTensors};
use splat_op::is_gpu;

use super::{Convolution, Lpips, MOST_ON_CPU, MOST_ON_GPU, Net, NetworkLayer};
use crate::FileError;
use crate::ply::brief;

/// Largest size of a file, bytes. Torchvision's complete VGG16, including the layers that LPIPS does not use, is 553 MB.
const MOST_BYTES: u64 = 600_000_000;

/// The tensor whose shape identifies the network.
const FIRST: &str = "net.slice1.0.weight";

impl Lpips {
    /// Reads the weights of a network and moves them to a device. The shape of the first layer identifies the network. Tensors with other
    /// names are ignored. An error if the file cannot be read or is not a safetensors file, if its tensors belong to no supported network,
    /// or if one of them is missing, has another shape or type, or holds values that are not finite or, in a linear layer, negative.
    pub fn read(path: &Path, device: &Device) -> Result<Self, FileError> {
        let io = |reason| FileError::io(path, "read the weights of LPIPS")(reason);
        let format = |found: String| {
            let advice = "docs/METRICS.md describes the tensors and has the command that exports them";
            FileError::new(path, format!("{found}; {advice}"))
        };
        let mut bytes = Vec::new();
        File::open(path).map_err(io)?.take(MOST_BYTES + 1).read_to_end(&mut bytes).map_err(io)?;
        if bytes.len() as u64 > MOST_BYTES {
            return Err(format(format!("larger than {} MB, more than any network", MOST_BYTES / 1_000_000)));
        }
        let tensors = SafeTensors::deserialize(&bytes);
        let tensors = tensors.map_err(|error| format(format!("not a safetensors file: {error}")))?;
        let net = network(&tensors).map_err(|found| {
            format(format!("{found}, expected the weights of LPIPS with the network alex (AlexNet) or vgg (VGG16)"))
        })?;
        let device = device.clone().inner();
        let read = |name: &str, shape: &[usize], is_weight| {
            let values = values(&tensors, name, shape, is_weight);
            values
                .map(|values| TensorData::new(values, shape))
                .map_err(|wrong| format(format!("`{name}` of the network {} {wrong}", net.name())))
        };
        let mut convolutions = Vec::new();
        let mut linear = Vec::new();
        let mut channels = 3;
        for (tap, slice) in net.slices().into_iter().enumerate() {
            for layer in slice {
                let NetworkLayer { convolution: Some((number, out)), side, .. } = *layer else { continue };
                let name = |what| format!("net.slice{}.{number}.{what}", tap + 1);
                let weight = read(&name("weight"), &[out, channels, side, side], false)?;
                let bias = read(&name("bias"), &[out], false)?;
                let (weight, bias) = (Tensor::from_data(weight, &device), Tensor::from_data(bias, &device));
                convolutions.push(Convolution { weight, bias });
                channels = out;
            }
            let weights = read(&format!("lin{tap}.model.1.weight"), &[1, channels, 1, 1], true)?;
            linear.push(Tensor::<4>::from_data(weights, &device).reshape([1, channels]));
        }
        let most = if is_gpu(&device) { MOST_ON_GPU } else { MOST_ON_CPU };
        Ok(Self { net, convolutions, linear, device, most })
    }
}

/// The network that the tensors belong to, or a description of the tensors.
fn network(tensors: &SafeTensors) -> Result<Net, String> {
    let Ok(first) = tensors.tensor(FIRST) else {
        let found = tensors.names().into_iter().min().map_or("no tensors".into(), |name| format!("`{}`", brief(name)));
        return Err(format!("there is no `{FIRST}`, found {found}"));
    };
    if tensors.tensor("lin5.model.1.weight").is_ok() {
        return Err("the network is squeeze (SqueezeNet), which is not supported".into());
    }
    match first.shape() {
        [64, 3, 11, 11] => Ok(Net::Alex),
        [64, 3, 3, 3] => Ok(Net::Vgg),
        other => Err(format!("`{FIRST}` has the shape {other:?}")),
    }
}

/// The values of a tensor, or what is wrong with it. They have to be finite and, if `is_weight`, not negative.
fn values(tensors: &SafeTensors, name: &str, shape: &[usize], is_weight: bool) -> Result<Vec<f32>, String> {
    let Ok(view) = tensors.tensor(name) else { return Err(format!("is missing, expected F32 of the shape {shape:?}")) };
    if view.dtype() != Dtype::F32 || view.shape() != shape {
        return Err(format!(
            "is {} of the shape {:?}, expected F32 of the shape {shape:?}",
            view.dtype(),
            view.shape()
        ));
    }
    let values: Vec<f32> = view.data().as_chunks::<4>().0.iter().map(|bytes| f32::from_le_bytes(*bytes)).collect();
    let holds = |at: usize| format!("holds {} as value {at}", values[at]);
    if let Some(at) = values.iter().position(|value| !value.is_finite()) {
        return Err(format!("{}, expected finite numbers", holds(at)));
    }
    if is_weight && let Some(at) = values.iter().position(|value| *value < 0.0) {
        return Err(format!("{}, expected no negative numbers, as in version 0.1 of LPIPS", holds(at)));
    }
    Ok(values)
}

//! Weights from a file: safetensors with the names and shapes of the package's own `state_dict`.

use std::fs::File;
use std::io::{self, Read};
use std::path::{Path, PathBuf};

use burn::tensor::{Device, Tensor, TensorData};
use safetensors::tensor::TensorView;
use safetensors::{Dtype, SafeTensors};
use splat_op::is_gpu;
use thiserror::Error;

use super::layers::{Layer, Net};
use super::{Convolution, Input, Lpips, MOST_ON_CPU, MOST_ON_GPU};

/// Of a file. All of torchvision's VGG16, with the layers that LPIPS has no use for, is 553 MB.
const MOST_BYTES: u64 = 600_000_000;

/// The tensor that tells networks apart.
const FIRST: &str = "net.slice1.0.weight";

/// The file's names that a message tells.
const NAMES_TOLD: usize = 6;

/// Weights that cannot be read.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum WeightsError {
    /// The operating system refused.
    #[error("{path}: could not read the weights of LPIPS: {source}", path = path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// The system's reason.
        source: io::Error,
    },
    /// No file of safetensors, or a damaged one.
    #[error(
        "{path}: the weights of LPIPS are to be in a safetensors file, and this is none: {detail}; docs/METRICS.md has the \
         command that writes one",
        path = path.display()
    )]
    Format {
        /// The file.
        path: PathBuf,
        /// How that is known.
        detail: String,
    },
    /// Tensors, but not those of a network that is known here.
    #[error(
        "{path}: {found}, expected the weights of LPIPS with the network alex (AlexNet) or vgg (VGG16), as docs/METRICS.md \
         has them",
        path = path.display()
    )]
    Network {
        /// The file.
        path: PathBuf,
        /// What it is instead.
        found: String,
    },
    /// One of the network's tensors is not what it has to be.
    #[error("{path}: `{name}` of the network {} {found}, expected {expected}; docs/METRICS.md has all names", net.name(), path = path.display())]
    Tensor {
        /// The file.
        path: PathBuf,
        /// The tensor's name.
        name: String,
        /// The network that the first layer is of.
        net: Net,
        /// What it is.
        found: String,
        /// What it has to be.
        expected: String,
    },
}

impl Lpips {
    /// Reads the weights of a network, which their shapes tell, and puts them on a device. Tensors of other names are left alone.
    ///
    /// # Errors
    /// If the file cannot be read or is none of safetensors, its tensors are of no known network, or one of them is missing or has
    /// another shape or type, values that are not finite, or, in a linear layer, negative ones.
    pub fn read(path: &Path, input: Input, device: &Device) -> Result<Self, WeightsError> {
        let io = |source| WeightsError::Io { path: path.to_owned(), source };
        let format = |detail: String| WeightsError::Format { path: path.to_owned(), detail };
        let mut bytes = Vec::new();
        File::open(path).map_err(io)?.take(MOST_BYTES + 1).read_to_end(&mut bytes).map_err(io)?;
        if bytes.len() as u64 > MOST_BYTES {
            return Err(format(format!("it is larger than {} MB, which no network here is", MOST_BYTES / 1_000_000)));
        }
        let tensors = SafeTensors::deserialize(&bytes).map_err(|error| format(error.to_string()))?;
        let net = network(&tensors).map_err(|found| WeightsError::Network { path: path.to_owned(), found })?;
        let device = device.clone().inner();
        let source = Source { path, tensors: &tensors, net, device: &device };
        let mut convolutions = Vec::new();
        let mut linear = Vec::new();
        let mut channels = 3;
        for (tap, slice) in net.slices().into_iter().enumerate() {
            for layer in slice {
                let Layer::Conv { number, channels: out, window } = *layer else { continue };
                let name = |what| format!("net.slice{}.{number}.{what}", tap + 1);
                let weight = source.tensor(&name("weight"), [out, channels, window.side, window.side], false)?;
                convolutions.push(Convolution { weight, bias: source.tensor(&name("bias"), [out], false)? });
                channels = out;
            }
            let weights = source.tensor(&format!("lin{tap}.model.1.weight"), [1, channels, 1, 1], true)?;
            linear.push(weights.reshape([1, channels]));
        }
        let most = if is_gpu(&device) { MOST_ON_GPU } else { MOST_ON_CPU };
        Ok(Self { net, input, convolutions, linear, device, most })
    }
}

/// The network that tensors are of, or what they are instead.
fn network(tensors: &SafeTensors) -> Result<Net, String> {
    let Ok(first) = tensors.tensor(FIRST) else {
        let mut names: Vec<&str> = tensors.names();
        names.sort_unstable();
        let told: Vec<String> = names.iter().take(NAMES_TOLD).map(|name| format!("`{}`", printable(name))).collect();
        let more = if names.len() > NAMES_TOLD { ", …" } else { "" };
        let has = if told.is_empty() { "no tensors".into() } else { format!("{}{more}", told.join(", ")) };
        return Err(format!("there is no `{FIRST}` but {has}"));
    };
    if tensors.tensor("lin5.model.1.weight").is_ok() {
        return Err("the network is squeeze (SqueezeNet), which is not known here".into());
    }
    match first.shape() {
        [64, 3, 11, 11] => Ok(Net::Alex),
        [64, 3, 3, 3] => Ok(Net::Vgg),
        other => Err(format!("`{FIRST}` has the shape {other:?}")),
    }
}

/// Names are anyone's to choose, and messages go to terminals.
fn printable(name: &str) -> String {
    name.chars().take(60).map(|letter| if letter.is_control() { char::REPLACEMENT_CHARACTER } else { letter }).collect()
}

struct Source<'a> {
    path: &'a Path,
    tensors: &'a SafeTensors<'a>,
    net: Net,
    device: &'a Device,
}

impl Source<'_> {
    /// A tensor of the network, which is finite, and not negative where it must not be.
    fn tensor<const D: usize>(
        &self,
        name: &str,
        shape: [usize; D],
        is_weight: bool,
    ) -> Result<Tensor<D>, WeightsError> {
        let wrong = |found: String, expected: String| {
            let (path, name) = (self.path.to_owned(), name.to_owned());
            WeightsError::Tensor { path, name, net: self.net, found, expected }
        };
        let shaped = format!("F32 of the shape {shape:?}");
        let Ok(view) = self.tensors.tensor(name) else { return Err(wrong("is missing".into(), shaped)) };
        if view.dtype() != Dtype::F32 || view.shape() != shape {
            return Err(wrong(format!("is {} of the shape {:?}", view.dtype(), view.shape()), shaped));
        }
        let values = values(&view);
        if let Some(at) = values.iter().position(|value| !value.is_finite()) {
            return Err(wrong(format!("holds {} as value {at}", values[at]), "finite numbers".into()));
        }
        if is_weight && let Some(at) = values.iter().position(|value| *value < 0.0) {
            let expected = "numbers that are not negative, as version 0.1 of LPIPS has them".into();
            return Err(wrong(format!("holds {} as value {at}", values[at]), expected));
        }
        Ok(Tensor::from_data(TensorData::new(values, shape), self.device))
    }
}

fn values(view: &TensorView) -> Vec<f32> {
    view.data().as_chunks::<4>().0.iter().map(|bytes| f32::from_le_bytes(*bytes)).collect()
}

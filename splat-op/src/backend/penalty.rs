//! Scalar penalties on Burn's CPU backends. Their derivatives are computed with them, so no backward node is needed: the public functions
//! attach the derivatives. On GPUs they are tensor code.

#![allow(deprecated, reason = "burn-ndarray is deprecated in favour of burn-flex; this project supports both")]

use burn::backend::tensor::FloatTensor;
use burn::backend::{Backend, ExtensionType, Flex, NdArray, TensorMetadata, backend_extension};

use super::cpu::host;
use super::host::{HostBackend, by_type};
use super::tensors::SightedTensors;
use crate::bilateral::roughness::{GridSize, roughness_cpu};
use crate::pose::cpu::miss_cpu;
use crate::simd::real::Real;

/// A penalty and its derivative.
#[derive(Clone, Debug, ExtensionType)]
pub struct Penalty<B: Backend> {
    /// `[1]`: the penalty.
    pub value: FloatTensor<B>,
    /// Its derivative, of the shape of the variable.
    pub gradient: FloatTensor<B>,
}

/// Scalar penalties, on CPU backends without autodiff.
#[backend_extension(Flex, NdArray)]
pub trait PenaltyBackend: Backend {
    /// Returns the roughness of a grid, `[12, L, R, C]`; see `bilateral/roughness.rs`.
    fn roughness(grid: FloatTensor<Self>) -> Penalty<Self>;

    /// Returns the miss of a pose, with the derivative with respect to it; see `pose/`. `scale` is the `r` of its formula.
    fn pose_miss(#[extension_type] inputs: SightedTensors<Self>, scale: f64) -> Penalty<Self>;
}

/// Makes the tensors of a penalty on the device of its variable.
fn penalty_of<B: HostBackend, F: Real>((value, gradient): (F, Vec<F>), variable: &FloatTensor<B>) -> Penalty<B> {
    Penalty {
        value: B::from_host(vec![value], &[1], variable),
        gradient: B::from_host(gradient, &variable.shape(), variable),
    }
}

macro_rules! cpu_backend {
    ($backend:ty) => {
        impl PenaltyBackend for $backend {
            fn roughness(grid: FloatTensor<Self>) -> Penalty<Self> {
                let size = GridSize::new(&grid.shape());
                by_type!(grid, F => penalty_of(roughness_cpu::<F>(&Self::host(grid.clone()), size), &grid))
            }

            fn pose_miss(inputs: SightedTensors<Self>, scale: f64) -> Penalty<Self> {
                let pose = &inputs.pose.0;
                by_type!(pose, F => {
                    let read = inputs.each_ref().map(host::<Self, F>);
                    penalty_of(miss_cpu(read.each_ref().map(|host| &host[..]), scale), pose)
                })
            }
        }
    };
}

cpu_backend!(Flex);
cpu_backend!(NdArray);

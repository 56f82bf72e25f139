//! The sort of rows on Burn's backends. Not differentiable.

#![allow(deprecated, reason = "burn-ndarray is deprecated in favour of burn-flex; this project supports both")]

use burn::backend::ops::IntTensorOps;
use burn::backend::tensor::{FloatTensor, IntTensor};
use burn::backend::{Backend, Flex, NdArray, TensorMetadata, backend_extension};
use burn::tensor::TensorData;
use rayon::prelude::*;

use super::host::HostBackend;
use crate::argsort::cpu::argsort_cpu;
use crate::counters::count_twin_call;

/// The stable order of rows by a key of each, on backends without autodiff; see `argsort/`.
#[backend_extension(Cube: cfg(feature = "cube"), Flex, NdArray, Fusion: cfg(feature = "fusion"))]
pub trait ArgsortBackend: Backend {
    /// Returns the order of whole numbers below `2^bits`, `[N]`, i32.
    #[fusion(dtype = burn::tensor::DType::I32, shape = keys)]
    fn argsort(keys: IntTensor<Self>, bits: u32) -> IntTensor<Self>;

    /// Returns the order of numbers in f32 that are not negative, `[N]`.
    #[fusion(dtype = burn::tensor::DType::I32, shape = keys)]
    fn argsort_floats(keys: FloatTensor<Self>) -> IntTensor<Self>;
}

macro_rules! cpu_backend {
    ($backend:ty) => {
        impl ArgsortBackend for $backend {
            fn argsort(keys: IntTensor<Self>, _: u32) -> IntTensor<Self> {
                count_twin_call();
                let (shape, device) = (keys.shape(), keys.device());
                let order = argsort_cpu(Self::host_ints(keys).par_iter().map(|&key| key as u32));
                Self::int_from_data(TensorData::new(order, shape), &device)
            }

            fn argsort_floats(keys: FloatTensor<Self>) -> IntTensor<Self> {
                count_twin_call();
                let (shape, device) = (keys.shape(), keys.device());
                // The bits of floats that are not negative are in the order of the floats.
                let order = argsort_cpu(Self::host::<f32>(keys).par_iter().map(|key| key.to_bits()));
                Self::int_from_data(TensorData::new(order, shape), &device)
            }
        }
    };
}

cpu_backend!(Flex);
cpu_backend!(NdArray);

#[cfg(feature = "cube")]
mod gpu {
    use burn::tensor::DType;
    use burn_cubecl::CubeBackend;
    use burn_cubecl::tensor::CubeTensor;

    use super::*;
    use crate::argsort::ALL_BITS;
    use crate::backend::cube::{owned, tensor};
    use crate::gpu::{Buffer, Gpu};
    use crate::intersect::sort::launch_sort;

    fn sorted(keys: CubeTensor, bits: u32) -> CubeTensor {
        let gpu = Gpu::new(&keys.client);
        let len = keys.shape().num_elements();
        if len == 0 {
            return tensor(Buffer::<i32>::new(&gpu, 0), [0], DType::I32, &keys);
        }
        // The sort writes over its keys.
        let keys = owned(keys);
        let mut order = launch_sort(&gpu, Buffer::from_handle(keys.handle.clone(), len), None, bits).indices;
        let room = order.handle.size_in_used() - 4 * len as u64;
        order.handle = order.handle.offset_end(room);
        tensor(order, [len], DType::I32, &keys)
    }

    impl ArgsortBackend for CubeBackend {
        fn argsort(keys: IntTensor<Self>, bits: u32) -> IntTensor<Self> {
            sorted(keys, bits)
        }

        fn argsort_floats(keys: FloatTensor<Self>) -> IntTensor<Self> {
            sorted(keys, ALL_BITS)
        }
    }
}

//! What the launches of the kernels share: the device's abilities, its buffers, the size of a dispatch, and the small
//! mathematics of the kernels. The CPU twins use none of it, so that a fault here shows against them.

pub(crate) mod atomic;
mod buffer;
pub(crate) mod half;
pub(crate) mod math;
pub(crate) mod reduce;

use cubecl::client::Client;
use cubecl::features::{AtomicUsage, Plane};
use cubecl::ir::{ElemType, FloatKind, Type};
use cubecl::prelude::{CubeCount, CubeDim};

pub(crate) use buffer::poison;
pub(crate) use buffer::{Buffer, launch_scale};

use crate::test_hooks::count_dispatch;

/// Units of a cube where a kernel has no reason to choose another number.
pub(crate) const UNITS: usize = 256;

/// Cubes along the first axis of a dispatch; WebGPU guarantees 65,535.
const CUBES_X: usize = 32_768;

/// A device as the launches see it. Tests switch its abilities off to run the paths of lesser devices.
#[derive(Clone)]
pub(crate) struct Gpu {
    pub client: Client,
    /// Whether the units of a plane can sum among themselves; else they go through shared memory.
    pub planes: bool,
    /// Whether floats can be added atomically; else by compare-and-swap on their bits.
    pub float_atomics: bool,
    /// Bytes of the largest buffer.
    pub buffer_limit: u64,
}

/// Kernels number elements by u32, whatever a device can hold.
const INDEX_LIMIT: u64 = 4 * (1 << 32);

impl Gpu {
    pub fn new(client: &Client) -> Self {
        let properties = client.properties();
        let float = Type::atomic(Type::from(ElemType::Float(FloatKind::F32)));
        Self {
            planes: properties.features.plane.contains(Plane::Ops),
            float_atomics: properties.atomic_type_usage(float).contains(AtomicUsage::Add),
            buffer_limit: properties.memory.max_page_size.min(INDEX_LIMIT),
            client: client.clone(),
        }
    }
}

/// A dispatch of at least `cubes` cubes, within the limits of every device. Kernels number their cubes by `CUBE_POS` and
/// leave those beyond.
pub(crate) fn cubes(cubes: usize) -> CubeCount {
    count_dispatch();
    let cubes = cubes.max(1);
    match cubes <= CUBES_X {
        true => CubeCount::Static(cubes as u32, 1, 1),
        false => CubeCount::Static(CUBES_X as u32, cubes.div_ceil(CUBES_X) as u32, 1),
    }
}

/// A dispatch with at least one unit per element.
pub(crate) fn elementwise(elements: usize) -> (CubeCount, CubeDim) {
    (cubes(elements.div_ceil(UNITS)), CubeDim::new_1d(UNITS as u32))
}

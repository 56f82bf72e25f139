//! Shared code of the kernel launches: device features, buffers, dispatch sizes, and the mathematics of the kernels. The CPU
//! twins use none of it, so that an error here shows as a difference from them.

pub(crate) mod atomic;
mod buffer;
pub(crate) mod math;
pub(crate) mod number;
pub(crate) mod reduce;

use std::ops::Range;

pub(crate) use cubecl::client::Client;
use cubecl::features::{AtomicUsage, Plane};
use cubecl::ir::{DeviceProperties, ElemType, FloatKind, Type};
use cubecl::prelude::{CubeCount, CubeDim};

pub use buffer::poison;
pub(crate) use buffer::{Argument, Buffer, PART_BYTES, launch_scale, roomy};
pub(crate) use math::*;
pub(crate) use number::*;
pub(crate) use reduce::*;

use crate::counters::count_dispatches;
use crate::limits::lowered_limit;

/// Returns a bit for each buffer that there is. A kernel with several optional buffers takes the bits as a comptime argument that it does
/// not read: without them, CubeCL 0.11.3 gives its forms with equally many buffers one key in the cache of compiled kernels, and loads
/// one form for another.
pub(crate) fn given<T, const N: usize>(buffers: [&Option<T>; N]) -> u32 {
    buffers.iter().enumerate().map(|(i, buffer)| u32::from(buffer.is_some()) << i).sum()
}

/// Default number of units of a cube.
pub(crate) const UNITS: usize = 256;

/// Shared memory of a cube that every device offers, bytes.
pub(crate) const SHARED_BYTES: usize = 16 << 10;

/// Cubes along the first axis of a dispatch; WebGPU guarantees 65,535.
const CUBES_X: usize = 32_768;

/// The features of a device that the launches use. Tests switch features off to run the paths of devices without them.
#[derive(Clone)]
pub(crate) struct Gpu {
    pub client: Client,
    /// Whether atomic addition of floats is supported; otherwise additions exchange the bits of floats.
    pub float_atomics: bool,
    /// Number of units of every plane, where planes are whole and their units exchange values and wait for one another; otherwise
    /// kernels go through shared memory. WGSL has no such wait.
    pub plane_units: Option<u32>,
    /// Shared memory of a cube, bytes.
    pub shared_bytes: usize,
    /// Size of the largest buffer, bytes.
    pub buffer_limit: u64,
    /// Whether launches are collected until the device is told to begin; elsewhere it begins with each.
    pub collects: bool,
}

/// Where and how often a kernel runs.
pub(crate) type Dispatch<'a> = (&'a Client, CubeCount, CubeDim);

/// Largest buffer that kernels can index, bytes: they number elements of four bytes by u32, even if a device supports larger
/// buffers. The number of elements must fit, and so must the next number of a unit that goes past the last element; no unit goes
/// further than the units of a row of cubes.
const INDEX_LIMIT: u64 = 4 * ((1 << 32) - (CUBES_X * UNITS) as u64);

impl Gpu {
    pub fn new(client: &Client) -> Self {
        let properties = client.properties();
        let float = Type::atomic(Type::from(ElemType::Float(FloatKind::F32)));
        Self {
            float_atomics: properties.atomic_type_usage(float).contains(AtomicUsage::Add),
            plane_units: plane_units(properties),
            shared_bytes: properties.hardware.max_shared_memory_size,
            buffer_limit: properties.memory.max_page_size.min(INDEX_LIMIT).min(lowered_limit()),
            collects: client.name().starts_with("wgpu"),
            client: client.clone(),
        }
    }

    /// Returns a dispatch with at least one unit per element. Without elements it is empty, and CubeCL launches nothing.
    pub fn units(&self, elements: usize) -> Dispatch<'_> {
        match elements {
            0 => (&self.client, CubeCount::Static(0, 0, 0), CubeDim::new_1d(UNITS as u32)),
            _ => self.cubes(elements.div_ceil(UNITS)),
        }
    }

    /// Returns a dispatch of at least `count` cubes of [`UNITS`] units.
    pub fn cubes(&self, count: usize) -> Dispatch<'_> {
        (&self.client, cubes(count), CubeDim::new_1d(UNITS as u32))
    }

    /// Lets the device begin with what was launched so far. Faults are reported when something is read.
    pub fn begin(&self) {
        if self.collects {
            let _ = self.client.flush();
        }
    }
}

/// Returns the number of units of every plane. CubeCL withholds plane operations from drivers in software; the environment variable
/// `SPLAT_PLANES`, a number of units, has tests use them.
fn plane_units(properties: &DeviceProperties) -> Option<u32> {
    let hardware = &properties.hardware;
    let forced = std::env::var("SPLAT_PLANES").ok().and_then(|units| units.parse().ok());
    let same = hardware.plane_size_min == hardware.plane_size_max
        && [Plane::Ops, Plane::Sync].iter().all(|&feature| properties.features.plane.contains(feature));
    forced.or_else(|| same.then_some(hardware.plane_size_min)).filter(|units| *units > 1)
}

/// Returns a dispatch of at least `cubes` cubes, within the limits of every device. Kernels number their cubes by `CUBE_POS` and
/// skip the surplus cubes.
pub(crate) fn cubes(cubes: usize) -> CubeCount {
    count_dispatches(1);
    let cubes = cubes.max(1);
    CubeCount::Static(cubes.min(CUBES_X) as u32, cubes.div_ceil(CUBES_X) as u32, 1)
}

/// Largest number of units of a search. A large GPU holds 270,000 units at once, and needs about that many loads of some words each
/// under way to saturate its memory.
const SEARCH_UNITS: usize = 1 << 18;

/// Returns the dispatch of a search through `values` values, and the distance between the values of a unit. The units
/// are enough to occupy a large GPU, and few enough that each loads several values at once.
pub(crate) fn search(values: usize) -> (CubeCount, CubeDim, u32) {
    let units = values.div_ceil(math::AT_ONCE).min(SEARCH_UNITS);
    let (grid, dim) = elementwise(units);
    // The surplus units of the last cube count too; otherwise they would repeat the work of others.
    (grid, dim, units.next_multiple_of(UNITS) as u32)
}

/// Returns a dispatch with at least one unit per element.
pub(crate) fn elementwise(elements: usize) -> (CubeCount, CubeDim) {
    (cubes(elements.div_ceil(UNITS)), CubeDim::new_1d(UNITS as u32))
}

/// Launches a kernel whose accesses are not checked: `launch_unchecked!(dispatch, kernel(arguments))`, with a [`Dispatch`] and what
/// [`Argument`] takes.
///
/// # Safety
/// Every access of the kernel lies within its buffers. A comment at each use says why.
macro_rules! launch_unchecked {
    ($dispatch:expr, $kernel:ident($($argument:expr),* $(,)?)) => {{
        let (client, grid, dim) = $dispatch;
        // SAFETY: see the comment at the use.
        unsafe {
            $kernel::launch_unchecked(client, grid, dim, $($crate::gpu::Argument::argument($argument)),*);
        }
    }};
}
pub(crate) use launch_unchecked;

/// Splits the indices `0..count` into ranges that need at most `room`, unless a range is a single index. The indices below `i`
/// need `before(i)` together. There is at least one range.
pub(crate) fn split(count: usize, room: usize, before: impl Fn(usize) -> usize) -> Vec<Range<usize>> {
    let (mut ranges, mut first) = (Vec::new(), 0);
    for end in 1..count {
        if before(end + 1) - before(first) > room {
            ranges.push(first..end);
            first = end;
        }
    }
    ranges.push(first..count);
    ranges
}

#[cfg(test)]
mod tests;

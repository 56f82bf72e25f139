//! The limits that kernels hold to, so that they run on small devices too. `docs/DEVICES.md` states them.

use naga::proc::Layouter;
use naga::{AddressSpace, Module, ShaderStage};

/// Workgroup memory, bytes: what WebGPU and Vulkan guarantee.
const SHARED_BYTES: u32 = 16 * 1024;
/// Storage buffers of a kernel, which some drivers of phones limit to 16.
const STORAGE_BUFFERS: u32 = 16;
/// Units of a cube: what WebGPU guarantees.
const UNITS: u32 = 256;

/// Returns what a module exceeds.
pub fn excess(module: &Module) -> Vec<String> {
    let mut layouter = Layouter::default();
    if let Err(error) = layouter.update(module.to_ctx()) {
        return vec![format!("no layout: {error}")];
    }
    let (mut shared_bytes, mut storage_buffers) = (0, 0);
    for (_, variable) in module.global_variables.iter() {
        match variable.space {
            AddressSpace::WorkGroup => {
                let layout = &layouter[variable.ty];
                shared_bytes = layout.alignment.round_up(shared_bytes) + layout.size;
            }
            AddressSpace::Storage { .. } => storage_buffers += 1,
            _ => {}
        }
    }
    let kernels = module.entry_points.iter().filter(|entry| entry.stage == ShaderStage::Compute);
    let units = kernels.map(|kernel| kernel.workgroup_size.iter().product()).max().unwrap_or(0);
    [
        ("bytes of shared memory", shared_bytes, SHARED_BYTES),
        ("storage buffers", storage_buffers, STORAGE_BUFFERS),
        ("units of a cube", units, UNITS),
    ]
    .into_iter()
    .filter(|(_, is, limit)| is > limit)
    .map(|(what, is, limit)| format!("{is} {what}, above the limit of {limit}"))
    .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn found(shared: u32, buffers: u32, units: u32) -> Vec<String> {
        let buffers: String = (0..buffers)
            .map(|n| format!("@group(0) @binding({n}) var<storage, read_write> b{n}: array<f32>;\n"))
            .collect();
        let text = format!(
            "{buffers}var<workgroup> s: array<vec3<f32>, {shared}>;\nvar<workgroup> t: atomic<u32>;\n\
             @compute @workgroup_size(32, {}) fn k() {{ }}",
            units / 32
        );
        excess(&naga::front::wgsl::parse_str(&text).unwrap_or_else(|error| panic!("{error}")))
    }

    #[test]
    fn kernels_at_the_limits_pass_and_those_above_do_not() {
        // An array of vectors of three takes 16 bytes for each.
        assert_eq!(found(1023, 16, 256), Vec::<String>::new());
        assert_eq!(found(1024, 16, 256), ["16388 bytes of shared memory, above the limit of 16384"]);
        assert_eq!(found(1, 17, 288).len(), 2);
    }
}

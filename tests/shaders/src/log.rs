//! CubeCL's log of the kernels that it compiles.

use std::collections::BTreeMap;

/// The text of each module, and the kernel's name: `stage::file::function::Type`.
pub type Modules<'a> = BTreeMap<&'a str, &'a str>;

/// Returns the modules of the crate `splat-op` in a log.
pub fn modules(log: &str) -> Modules<'_> {
    log.split("[START_KERNEL_COMPILATION]").skip(1).filter_map(module).collect()
}

fn module(entry: &str) -> Option<(&str, &str)> {
    let (head, rest) = entry.split_once("```wgsl\n")?;
    let (text, _) = rest.split_once("\n```")?;
    let name = head.lines().find_map(|line| line.strip_prefix("name: "))?;
    // The generic arguments of a name follow in brackets.
    let name = name.strip_prefix("splat_op::")?.split(['<', ' ']).next()?;
    Some((text, name))
}

/// Returns the function's name in a kernel's name.
pub fn function(name: &str) -> &str {
    name.rsplit("::").nth(1).unwrap_or(name)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_log_holds_modules_of_many_crates() {
        let entry = |name: &str| {
            format!(
                "[START_KERNEL_COMPILATION]\nname: {name}\nid: 1\nsource:\n```wgsl\nfn x() {{}}\n```\n[END_KERNEL_COMPILATION]\n"
            )
        };
        let log = entry("splat_op::a::b::c_kernel::CKernel<f32>") + &entry("burn::x");
        assert_eq!(modules(&log), BTreeMap::from([("fn x() {}", "a::b::c_kernel::CKernel")]));
        assert_eq!(function("a::b::c_kernel::CKernel"), "c_kernel");
    }
}

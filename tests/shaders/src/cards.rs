//! Modules in SPIR-V, for the compilers of cards (`tests/cards/statistics.c`).

use std::path::Path;
use std::{fs, io};

use naga::back::spv;
use naga::front::wgsl;
use naga::proc::{BoundsCheckPolicies, BoundsCheckPolicy};
use naga::valid::Capabilities;

use crate::log::{self, Modules};
use crate::target;

/// Writes each module to a file of its own. Prints a line for each: file, entry point, whether the card needs to add floats atomically
/// (`atomic` or `any`), and name of the kernel.
///
/// # Errors
/// If a module is not valid, or a file cannot be written.
pub fn write(modules: &Modules, folder: &Path) -> io::Result<()> {
    fs::create_dir_all(folder)?;
    for (number, (text, name)) in modules.iter().enumerate() {
        let translated = translate(text).map_err(|error| io::Error::other(format!("{name}: {error}")))?;
        let file = folder.join(format!("{number:04}.spv"));
        fs::write(&file, translated.words.iter().flat_map(|word| word.to_le_bytes()).collect::<Vec<u8>>())?;
        let needs = if translated.adds_atomically { "atomic" } else { "any" };
        println!("{}\t{}\t{needs}\t{}", file.display(), translated.entry_point, log::function(name));
    }
    Ok(())
}

/// A module in SPIR-V.
struct Translated {
    entry_point: String,
    adds_atomically: bool,
    words: Vec<u32>,
}

/// Translates a module as CubeCL has wgpu do it: without checks of bounds and without zeros in shared memory.
fn translate(text: &str) -> Result<Translated, String> {
    let module = wgsl::parse_str(text).map_err(|error| error.emit_to_string(text))?;
    let info = target::validate(&module, target::ALL)?;
    let unchecked = BoundsCheckPolicy::Unchecked;
    let options = spv::Options {
        lang_version: (1, 3),
        bounds_check_policies: BoundsCheckPolicies {
            index: unchecked,
            buffer: unchecked,
            image_load: unchecked,
            binding_array: unchecked,
        },
        zero_initialize_workgroup_memory: spv::ZeroInitializeWorkgroupMemoryMode::None,
        force_loop_bounding: false,
        ..spv::Options::default()
    };
    let entry_point = module.entry_points.first().ok_or("no entry point")?.name.clone();
    let adds_atomically = target::validate(&module, Capabilities::empty()).is_err();
    let words = spv::write_vec(&module, &info, &options, None).map_err(|error| error.to_string())?;
    Ok(Translated { entry_point, adds_atomically, words })
}

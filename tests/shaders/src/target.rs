//! The languages that wgpu hands to drivers beside SPIR-V, and the features that wgpu offers with each.

use naga::Module;
use naga::back::{hlsl, msl};
use naga::valid::{Capabilities, ModuleInfo, ValidationFlags, Validator};

/// A language with the features that wgpu's devices of it have.
pub struct Target {
    /// Name for reports.
    pub name: &'static str,
    language: Language,
    features: Capabilities,
}

enum Language {
    Hlsl(hlsl::ShaderModel),
    Msl((u8, u8)),
}

/// What becomes of a module.
pub enum Outcome {
    /// It is valid, and naga writes it.
    Translated,
    /// It needs a feature that devices of this target lack. They take another form of the kernel.
    LacksFeature,
    /// It is not valid, or naga cannot write it.
    Refused(String),
}

/// All features that kernels use where they exist.
pub const ALL: Capabilities = Capabilities::SHADER_FLOAT32_ATOMIC;

/// DirectX 12 with its older compiler (FXC) and with its newer one (DXC), Metal before and since float atomics.
pub const TARGETS: [Target; 4] = [
    Target {
        name: "HLSL, shader model 5.1",
        language: Language::Hlsl(hlsl::ShaderModel::V5_1),
        features: Capabilities::empty(),
    },
    Target {
        name: "HLSL, shader model 6.0",
        language: Language::Hlsl(hlsl::ShaderModel::V6_0),
        features: Capabilities::empty(),
    },
    Target { name: "MSL 2.4", language: Language::Msl((2, 4)), features: Capabilities::empty() },
    Target { name: "MSL 3.0", language: Language::Msl((3, 0)), features: ALL },
];

impl Target {
    /// Validates a module and translates it.
    pub fn translate(&self, module: &Module) -> Outcome {
        let written = match (validate(module, self.features), validate(module, ALL)) {
            (Ok(info), _) => self.write(module, &info),
            (Err(_), Ok(_)) => return Outcome::LacksFeature,
            (_, Err(why)) => Err(why),
        };
        written.map_or_else(Outcome::Refused, |()| Outcome::Translated)
    }

    fn write(&self, module: &Module, info: &ModuleInfo) -> Result<(), String> {
        match self.language {
            Language::Hlsl(shader_model) => {
                let options = hlsl::Options { shader_model, ..hlsl::Options::default() };
                let mut text = String::new();
                let written = hlsl::Writer::new(&mut text, &options, &hlsl::PipelineOptions::default())
                    .write(module, info, None)
                    .map_err(|error| error.to_string())?;
                all(written.entry_point_names)
            }
            Language::Msl(lang_version) => {
                let options = msl::Options { lang_version, ..msl::Options::default() };
                let (_, written) = msl::write_string(module, info, &options, &msl::PipelineOptions::default())
                    .map_err(|error| error.to_string())?;
                all(written.entry_point_names)
            }
        }
    }
}

/// Returns the first failure of the entry points.
fn all<E: std::fmt::Display>(entry_points: Vec<Result<String, E>>) -> Result<(), String> {
    entry_points.into_iter().try_for_each(|name| name.map(drop).map_err(|error| error.to_string()))
}

/// Returns what naga finds out about a module, or why it is not valid.
pub fn validate(module: &Module, features: Capabilities) -> Result<ModuleInfo, String> {
    Validator::new(ValidationFlags::all(), features)
        .validate(module)
        .map_err(|error| format!("{:?}", error.into_inner()))
}

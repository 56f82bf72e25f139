//! `splat convert`: writes a scene in another format and reports the loss.

use std::fs;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, ensure};
use clap::builder::{PossibleValue, PossibleValuesParser, TypedValueParser};
use clap::value_parser;
use splat_model::formats::{self, Deviation, Format, QuantisationError, SceneFile, SpzVersion, WriteOptions, Written};
use splat_model::ply::TrainedAs;

use crate::inputs::Inputs;
use crate::output::{prepare_file, short};
use crate::{input, progress};

/// Range of SPZ's standard deviations, in words: their logarithms are stored in 8 bits.
const SPZ_SCALES: &str = "SPZ holds standard deviations from 0.000045 to 379 scene units; SOG has no such limits";

/// Largest relative error of a scale that is in range, half a step of 1/16 of the logarithm; a larger error means out of range.
const SPZ_SCALE_ERROR: f64 = 0.033;

/// Options of `splat convert`.
#[derive(Clone, Debug, clap::Args)]
pub struct ConvertArgs {
    /// Scene to convert: PLY, SuperSplat's compressed PLY, SPZ or SOG, recognized by its content
    pub scene: PathBuf,
    /// File to write, replacing an existing one; its name gives the format: .ply, .spz, .glb or .sog
    pub out: PathBuf,
    /// Format to write, if the name does not give it
    #[arg(long, value_parser = formats_by_name())]
    pub format: Option<Format>,
    /// Drop spherical harmonics above this degree; many readers support at most 3
    #[arg(long, value_name = "DEGREE", value_parser = value_parser!(u8).range(0..=4))]
    pub sh_degree: Option<u8>,
    /// Bits of each spherical-harmonics coefficient in SPZ: more are larger and closer to the scene [default: 5 at degree 1 and 4
    /// above it, as the format's reference]
    #[arg(long, value_name = "BITS", value_parser = value_parser!(u8).range(1..=8))]
    pub sh_bits: Option<u8>,
    /// Largest number of entries of SOG's palette of spherical harmonics: more are larger and closer to the scene [default: one for
    /// eight splats, 1024 at the least]
    #[arg(long, value_name = "ENTRIES", value_parser = value_parser!(u32).range(1..=65_536))]
    pub sh_palette: Option<u32>,
    /// Version of SPZ: 3 for programs that do not read 4 [default: 4]
    #[arg(long, value_name = "VERSION", value_parser = value_parser!(u8).range(3..=4))]
    pub spz_version: Option<u8>,
    /// Mark the scene as trained with --antialias, which files of other programs do not say
    #[arg(long)]
    pub antialias: bool,
}

const FORMATS: [(&str, &str, Format); 4] = [
    ("ply", "all parameters, in 32-bit floats", Format::Ply),
    ("spz", "Niantic's: 20 bytes a splat and one for each higher coefficient, then zstd", Format::Spz),
    ("glb", "glTF: all parameters to degree 3, in 32-bit floats; written, not read", Format::Glb),
    ("sog", "PlayCanvas': pictures of 8 bits and a palette of harmonics, to degree 3", Format::Sog),
];

fn formats_by_name() -> impl TypedValueParser<Value = Format> {
    let found = |name: String| FORMATS.into_iter().find(|(known, ..)| *known == name).ok_or("no format");
    let values = FORMATS.map(|(name, help, _)| PossibleValue::new(name).help(help));
    PossibleValuesParser::new(values).try_map(move |name| found(name).map(|(.., format)| format))
}

/// Writes the scene in the other format, reads it back, and prints the differences. An error if the scene cannot be
/// read, the format is unknown, no splat is left, the file cannot be written, or it is the scene itself.
pub fn run(args: &ConvertArgs) -> Result<()> {
    let shown = args.out.display();
    let format = match args.format {
        Some(format) => format,
        None => format_of(&args.out).context("no format is chosen with `--format`")?,
    };
    let (mut scene, found) = formats::read(&args.scene).context("cannot read the scene")?;
    scene.trained.antialias |= args.antialias;
    let (splats, of_degree) = (scene.rows.len(), scene.rows.sh_degree);
    for (option, given, of) in [
        ("--sh-bits", args.sh_bits.is_some(), Format::Spz),
        ("--spz-version", args.spz_version.is_some(), Format::Spz),
        ("--sh-palette", args.sh_palette.is_some(), Format::Sog),
    ] {
        ensure!(
            !given || format == of,
            "`{option}` is for {of}, and {shown} is {format}: leave it out, or name a file that ends in {}",
            of.extension()
        );
    }
    prepare_file(&args.out, &Inputs::of([&args.scene]))?;
    if let Some(degree) = args.sh_degree.map(usize::from).filter(|degree| *degree < of_degree) {
        scene.rows = input::selected(&scene.rows, 0..splats, degree);
    }
    let written = formats::write_with(&args.out, &scene, format, options(args))
        .with_context(|| format!("cannot convert {} to {}", args.scene.display(), args.out.display()))?;
    let (count, sh_degree) = (written.rows.len(), written.rows.sh_degree);

    progress::say(&describe_file(&args.scene, found, splats, of_degree)?);
    progress::say(&describe_file(&args.out, format, count, sh_degree)?);
    if let Some(metres) = scene.metres_per_unit {
        progress::say(&format!("a scene unit is {metres} m"));
    }
    let mut lost = dropped(&scene, format, &written, of_degree);
    // Numbers of glTF are those of the scene but for the rounding of f32.
    if !format.is_exact() && Format::READ.contains(&format) {
        let read = formats::read(&args.out).context("cannot read what was written")?.0;
        let error = QuantisationError::between(&written.rows, &read.rows);
        lost.extend(table(&error, sh_degree));
        if format == Format::Spz && error.scale.largest > SPZ_SCALE_ERROR {
            lost.push(SPZ_SCALES.into());
        }
    }
    progress::say(&if lost.is_empty() { "nothing is lost".into() } else { format!("lost:\n  {}", lost.join("\n  ")) });
    Ok(())
}

/// Returns the format that the name of a file gives. An error if it gives none that is written.
pub fn format_of(path: &Path) -> Result<Format> {
    let known = || Format::WRITTEN.map(Format::extension).join(", ");
    let format = Format::of_name(path)
        .with_context(|| format!("the name {} does not give a format: end it in one of {}", path.display(), known()))?;
    ensure!(
        Format::WRITTEN.contains(&format),
        "{}: {format} is read, not written: end the name in one of {}",
        path.display(),
        known()
    );
    Ok(format)
}

fn options(args: &ConvertArgs) -> WriteOptions {
    let mut options = WriteOptions::default();
    options.sog.entries = args.sh_palette.map(|entries| entries as usize);
    if args.spz_version == Some(3) {
        options.spz.version = SpzVersion::Three;
    }
    if let Some(bits) = args.sh_bits {
        options.spz.sh_bits = [bits; 2];
    }
    options
}

/// Describes a scene file in one line. An error if the size of the file cannot be read.
pub fn describe_file(path: &Path, format: Format, splats: usize, sh_degree: usize) -> Result<String> {
    let bytes = fs::metadata(path).with_context(|| format!("cannot read the size of {}", path.display()))?.len();
    let each = bytes as f64 / splats.max(1) as f64;
    Ok(format!("{}: {format}, {splats} splats of degree {sh_degree}, {bytes} bytes, {each:.1} a splat", path.display()))
}

/// Lists everything that the format cannot store.
fn dropped(scene: &SceneFile, format: Format, written: &Written, of_degree: usize) -> Vec<String> {
    let mut lost = Vec::new();
    let (left_out, moved, sh_degree) = (written.left_out, written.moved, written.rows.sh_degree);
    if moved > 0 {
        lost.push(format!(
            "the distance of {moved} splats, more than 512 times the scene's width away: they are moved to the border of \
             the grid and shrunk, and look the same from the middle of the scene"
        ));
    }
    if left_out > 0 {
        lost.push(format!(
            "{left_out} splats that cannot be rendered, because a parameter is not finite or out of range"
        ));
    }
    if let Some(group) = scene.rows.groups.iter().find(|group| !written.rows.has_group(group)) {
        let others = scene.rows.groups.len() - 1;
        let more = if others == 0 { String::new() } else { format!(" and {others} more") };
        lost.push(format!("the further properties `{}`{more}: only PLY holds them", group.name));
    }
    if sh_degree < of_degree {
        lost.push(format!("spherical harmonics above degree {sh_degree}"));
    }
    if scene.origin.to_array() != [0.0; 3] && !format.holds_origin() {
        let [x, y, z] = scene.origin.to_array();
        lost.push(format!("the origin {x} {y} {z}, which positions were relative to: they are stored without it"));
    }
    if let Some(metres) = scene.metres_per_unit.filter(|_| !format.holds_origin()) {
        lost.push(format!("the size of a unit, {metres} m"));
    }
    if scene.trained != (TrainedAs { antialias: scene.trained.antialias, ..TrainedAs::default() })
        && format == Format::Spz
    {
        lost.push("the background and the projection that it was trained with".into());
    }
    lost
}

fn table(loss: &QuantisationError, sh_degree: usize) -> Vec<String> {
    let row = |name: &str, Deviation { largest, rms }: Deviation, factor: f64, unit: &str| {
        format!("{name:10} {:>10} {:>10}  {unit}", short(factor * largest, 2), short(factor * rms, 2))
    };
    let mut rows = vec![
        format!("{:10} {:>10} {:>10}", "rounding", "largest", "RMS"),
        row("position", loss.position, 1.0, "scene units"),
        row("scale", loss.scale, 100.0, "% of the standard deviation"),
        row("rotation", loss.rotation, 1.0, "degrees"),
        row("opacity", loss.opacity, 1.0, "of 1"),
        row("colour", loss.colour, 1.0, "of 1, degree 0"),
    ];
    if sh_degree > 0 {
        rows.push(row("harmonics", loss.harmonics, 1.0, "higher coefficients"));
    }
    rows
}

//! COLMAP's stages: features, matches, models.

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;
use std::process::Command;

use anyhow::{Context, Result};
use splat_model::capture::photographs_in;
use splat_model::capture::unposed::Unposed;

use super::cache::{
    DATABASE, DATABASE_FILES, IMAGES, LISTS, LOG, SPARSE, SPARSE_PARTIAL, Stage, VOCABULARY, Workspace,
};
use super::photographs::{CameraModelName, extractions};
use super::programs::{ColmapProgram, Options};
use super::{failure, stage};
use crate::output;
use crate::progress::{self, CountedProgress};
use crate::stop::Stop;

/// Side of the pictures in which features are found, px, where photographs are larger. In 12 megapixels the search takes twenty times as long.
const FEATURE_SIDE: usize = 1_600;

/// Most photographs of which every pair is compared.
const ALL_PAIRS: usize = 40;

/// Features of a photograph, without second orientations, where photographs are large or not all pairs are compared. The time of a pair grows with them.
const FEATURES: usize = 2_048;

/// Photographs that are compared with each one because they look alike.
const ALIKE: usize = 20;

/// Options of `vocab_tree_builder`. For `fox_small`, a vocabulary of 1,024 words takes six times as long as one of 256 and finds fewer of the
/// pairs that match.
const VOCABULARY_OPTIONS: [(&str, &str); 3] =
    [("num_visual_words", "256"), ("num_iterations", "3"), ("max_num_images", "25")];

/// Number of features by which a photograph is looked up in the vocabulary.
const LOOKED_UP: [&str; 2] = ["VocabTreeMatching.max_num_features", "1000"];

/// Photographs of a block of exhaustive matching, at most: the progress is that of blocks.
const BLOCK: usize = 25;

/// Frames of a video that are compared with the one before them. As many again are at distances of powers of two.
const FRAMES_NEAR: usize = 20;

/// The same for photographs in order of name, where not all pairs are compared.
const PHOTOGRAPHS_NEAR: usize = 5;

/// Share of the photographs that the global mapper has to place. Below it the incremental one is tried too.
const ENOUGH: f64 = 0.8;

/// Runs the stages of a reconstruction.
pub struct Stages<'a> {
    pub colmap: &'a ColmapProgram,
    pub stop: &'a Stop,
    /// Whether photographs are the frames of a video, of which neighbours by name are neighbours.
    pub is_video: bool,
    pub model: Option<CameraModelName>,
    /// Whether the size of pictures and the number of features are left to COLMAP.
    pub full_size: bool,
}

impl Stages<'_> {
    /// Runs the stages that are not finished.
    pub fn run(&self, workspace: &mut Workspace, photographs: &[Unposed]) -> Result<()> {
        if !workspace.has(Stage::Features) {
            // Half of the features would have other cameras than the rest.
            workspace.clear(&DATABASE_FILES)?;
            let features = self.features(workspace, photographs)?;
            workspace.set_features(features);
            workspace.finish(Stage::Features)?;
        }
        if !workspace.has(Stage::Matches) {
            self.matches(workspace, photographs.len())?;
            workspace.finish(Stage::Matches)?;
        }
        self.models(workspace, photographs)
    }

    /// Runs a command to its end. Returns an error unless it succeeds.
    fn succeed(&self, workspace: &Workspace, command: Command, doing: &str, line: impl FnMut(&str)) -> Result<()> {
        let during = format!("while COLMAP was {doing}");
        let ended = stage::run(command, self.stop, &during, &mut workspace.log()?, line)?;
        if ended.status.success() { Ok(()) } else { Err(failure::ended("COLMAP", doing, &ended, &workspace.join(LOG))) }
    }

    /// Extracts features, and returns their number by photograph.
    fn features(&self, workspace: &Workspace, photographs: &[Unposed]) -> Result<BTreeMap<String, u64>> {
        let options = self.colmap.options("feature_extractor")?;
        let limits = self.limits(&options, photographs);
        let mut features = BTreeMap::new();
        let mut counted = CountedProgress::new("features");
        let extractions = extractions(photographs, self.model);
        for (i, extraction) in extractions.iter().enumerate() {
            let list = workspace.join(LISTS).join(format!("{i}.txt"));
            output::write_lines(&list, &extraction.names)?;
            let mut command = with_paths(ColmapProgram::command("feature_extractor"), workspace, true);
            command.arg("--image_list_path").arg(&list).args(&extraction.arguments);
            command.args(&limits);
            let mut of = String::new();
            self.succeed(workspace, command, "finding features", |line| match field(line) {
                Some(("Name", name)) => of = name.to_owned(),
                Some(("Features", count)) => {
                    let count = count.split_whitespace().next().and_then(|count| count.parse().ok());
                    features.extend(count.map(|count| (of.clone(), count)));
                    counted.set(features.len(), Some(photographs.len()));
                }
                _ => {}
            })?;
        }
        counted.finish();
        let unread: Vec<&str> = photographs
            .iter()
            .map(|photograph| photograph.name.as_str())
            .filter(|name| !features.contains_key(*name))
            .collect();
        if !unread.is_empty() && !features.is_empty() {
            progress::note(&format!(
                "COLMAP read no features in {} photographs, {} for one: save them as ordinary JPEG with 8 bits",
                unread.len(),
                unread[0]
            ));
        }
        Ok(features)
    }

    /// Options of `feature_extractor` that limit its time, and keep it off graphics cards. `first_octave` of zero does without COLMAP's
    /// doubling of the picture.
    fn limits(&self, options: &Options, photographs: &[Unposed]) -> Vec<String> {
        let large = !self.full_size && largest_side(photographs) > FEATURE_SIDE;
        let many = !self.full_size && photographs.len() > ALL_PAIRS;
        if large {
            progress::note(&format!(
                "features are found in pictures of {FEATURE_SIDE} px, up to {FEATURES} in each; `--full-size-features` finds more and takes many times as long"
            ));
        }
        let limits = [
            (true, &["FeatureExtraction.use_gpu", "SiftExtraction.use_gpu"][..], 0),
            (large, &["FeatureExtraction.max_image_size", "SiftExtraction.max_image_size"], FEATURE_SIDE),
            (large, &["SiftExtraction.first_octave"], 0),
            (large || many, &["SiftExtraction.max_num_features"], FEATURES),
        ];
        let chosen = limits.iter().filter(|(is_on, ..)| *is_on);
        let arguments =
            chosen.filter_map(|(_, names, value)| Some([format!("--{}", options.first(names)?), value.to_string()]));
        arguments.flatten().collect()
    }

    /// Matches photographs. COLMAP skips pairs that are in the database already.
    fn matches(&self, workspace: &Workspace, photographs: usize) -> Result<()> {
        let by_look = ["vocab_tree_builder", "vocab_tree_matcher"].iter().all(|command| self.colmap.has(command));
        if !self.is_video && (photographs <= ALL_PAIRS || !by_look) {
            progress::note(&format!("matching all pairs of {photographs} photographs"));
            return self.matcher(workspace, "exhaustive_matcher", photographs, &[]);
        }
        let near = if self.is_video { FRAMES_NEAR } else { PHOTOGRAPHS_NEAR }.to_string();
        progress::note(&match self.is_video {
            true => {
                format!("matching each of {photographs} frames with the {near} that follow it, and some further on")
            }
            false => format!(
                "matching each of {photographs} photographs with the {ALIKE} that look most like it, and the {near} that follow it by name and \
                 some further on: all pairs are compared up to {ALL_PAIRS}"
            ),
        });
        self.matcher(workspace, "sequential_matcher", photographs, &[["SequentialMatching.overlap", &near]])?;
        if self.is_video { Ok(()) } else { self.match_alike(workspace, photographs) }
    }

    /// Matches each photograph with those that look most like it, by a vocabulary of all features.
    fn match_alike(&self, workspace: &Workspace, photographs: usize) -> Result<()> {
        let vocabulary = workspace.join(VOCABULARY);
        let options = self.colmap.options("vocab_tree_builder")?;
        let mut command = with_paths(ColmapProgram::command("vocab_tree_builder"), workspace, false);
        command.arg("--vocab_tree_path").arg(&vocabulary);
        for (name, value) in VOCABULARY_OPTIONS.iter().filter(|(name, _)| options.first(&[name]).is_some()) {
            command.arg(format!("--{name}")).arg(value);
        }
        self.succeed(workspace, command, "building a vocabulary of features", |_| {})?;
        let alike = ALIKE.to_string();
        let path = vocabulary.to_string_lossy();
        let arguments =
            [["VocabTreeMatching.vocab_tree_path", &path], ["VocabTreeMatching.num_images", &alike], LOOKED_UP];
        self.matcher(workspace, "vocab_tree_matcher", photographs, &arguments)
    }

    fn matcher(&self, workspace: &Workspace, name: &str, photographs: usize, arguments: &[[&str; 2]]) -> Result<()> {
        let options = self.colmap.options(name)?;
        let mut command = with_paths(ColmapProgram::command(name), workspace, false);
        let on_gpu = options.first(&["FeatureMatching.use_gpu", "SiftMatching.use_gpu"]).map(|name| [name, "0"]);
        // A second pass along the epipolar lines: a third more points, from which the scene grows.
        let guided = options.first(&["FeatureMatching.guided_matching", "SiftMatching.guided_matching"]);
        let block = photographs.div_ceil(4).clamp(2, BLOCK).to_string();
        let block = options.first(&["ExhaustiveMatching.block_size"]).map(|name| [name, block.as_str()]);
        for [name, value] in arguments.iter().copied().chain(on_gpu).chain(guided.map(|name| [name, "1"])).chain(block)
        {
            command.arg(format!("--{name}")).arg(value);
        }
        let mut counted = CountedProgress::new("matching");
        self.succeed(workspace, command, "matching photographs", |line| {
            if let Some((done, all)) = matched(line) {
                counted.set(done, Some(all));
            }
        })?;
        counted.finish();
        Ok(())
    }

    /// Makes models in `sparse/`.
    fn models(&self, workspace: &Workspace, photographs: &[Unposed]) -> Result<()> {
        let error = largest_error(photographs).to_string();
        let photographs = photographs.len();
        let global = self.colmap.has("global_mapper");
        let (mut most, mut best) = (0, None);
        workspace.clear(&[SPARSE_PARTIAL])?;
        for mapper in if global { &["global_mapper", "mapper"][..] } else { &["mapper"] } {
            if most as f64 >= ENOUGH * photographs as f64 {
                break;
            }
            if *mapper == "mapper" && global {
                progress::note(&format!(
                    "the global mapper placed {most} of {photographs} photographs: trying the incremental one"
                ));
            }
            let partial = workspace.join(SPARSE_PARTIAL).join(mapper);
            fs::create_dir_all(&partial).with_context(|| format!("cannot make {}", partial.display()))?;
            let mut command = with_paths(ColmapProgram::command(mapper), workspace, true);
            command.arg("--output_path").arg(&partial);
            let options = self.colmap.options(mapper)?;
            for name in ERRORS.iter().filter_map(|name| options.first(&[name])) {
                command.arg(format!("--{name}")).arg(&error);
            }
            let mut counted = CountedProgress::new("placing");
            let during = "while COLMAP was placing photographs";
            let ended = stage::run(command, self.stop, during, &mut workspace.log()?, |line| {
                if let Some(placed) = registered(line) {
                    counted.set(placed, Some(photographs));
                }
            })?;
            counted.finish();
            let placed = placed(&partial);
            // COLMAP fails where it makes no model, and says why in words that only its authors know.
            let crashed = ended.signal().is_some();
            if placed == 0 && crashed && *mapper == "mapper" && most == 0 {
                return Err(failure::ended("COLMAP", "placing photographs", &ended, &workspace.join(LOG)));
            }
            if placed > most {
                (most, best) = (placed, Some(partial));
            }
        }
        let Some(best) = best else {
            return Err(failure::no_model(photographs, workspace.features(), &workspace.join(LOG)));
        };
        workspace.complete(&best, SPARSE)?;
        workspace.clear(&[SPARSE_PARTIAL, LISTS, VOCABULARY])
    }
}

/// The options of `mapper` for the largest error of a point, px.
const ERRORS: [&str; 3] =
    ["Mapper.filter_max_reproj_error", "Mapper.tri_complete_max_reproj_error", "Mapper.tri_merge_max_reproj_error"];

/// The largest error of a point, px: COLMAP's 4 px for photographs of 1,600 px, and less for smaller ones. With 4 px of 480, poses are worse.
fn largest_error(photographs: &[Unposed]) -> f64 {
    (4.0 * largest_side(photographs) as f64 / 1_600.0).clamp(1.0, 4.0)
}

fn largest_side(photographs: &[Unposed]) -> usize {
    photographs.iter().flat_map(|photograph| photograph.size).max().unwrap_or(0)
}

/// The number of photographs in the largest of the models in a folder.
fn placed(models: &Path) -> usize {
    let count = |model: &Path| photographs_in(model).unwrap_or(0);
    let folders = fs::read_dir(models).into_iter().flatten().flatten();
    folders.map(|entry| count(&entry.path())).max().unwrap_or(0)
}

fn with_paths(mut command: Command, workspace: &Workspace, images: bool) -> Command {
    command.arg("--database_path").arg(workspace.join(DATABASE));
    if images {
        command.arg("--image_path").arg(workspace.join(IMAGES));
    }
    command
}

/// `Name: value` in a line, after whatever a log puts before it.
fn field(line: &str) -> Option<(&str, &str)> {
    let (before, value) = line.split_once(": ")?;
    let name = before.split_whitespace().next_back()?;
    Some((name, value.trim()))
}

/// The blocks or photographs that are matched, of how many: `Matching block [2/5, 1/5]`, `Matching image [7/50]`. `Indexing image [7/50]`
/// comes before them.
fn matched(line: &str) -> Option<(usize, usize)> {
    let inside = line.split_once("[").filter(|(before, _)| !before.contains("Indexing"))?.1.split_once(']')?.0;
    let pairs: Vec<(usize, usize)> = inside
        .split(',')
        .map(|pair| pair.trim().split_once('/').and_then(|(a, b)| Some((a.parse().ok()?, b.parse().ok()?))))
        .collect::<Option<_>>()?;
    match *pairs.as_slice() {
        [(done, all)] => Some((done, all)),
        [(row, rows), (column, columns)] => Some((row.checked_sub(1)? * columns + column, rows * columns)),
        _ => None,
    }
}

/// The number of placed photographs in a line of the mapper: `Registering image #19 (3)`, or since 3.12 `(num_reg_frames=3)`.
fn registered(line: &str) -> Option<usize> {
    let inside = line.split_once("Registering image #")?.1.split_once('(')?.1.split_once(')')?.0;
    inside.rsplit('=').next()?.parse().ok()
}

#[cfg(test)]
mod tests;

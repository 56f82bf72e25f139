//! The folder of a plan: `plan.json`, `jobs.txt`, and a folder for each block.

use std::fs;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use serde::{Deserialize, Serialize};
use splat_model::capture::Capture;
use splat_model::capture::blocks::{BLOCK, BlockFile};

use crate::report::{METRICS, SCENE};
use crate::{input, output};

pub const PLAN: &str = "plan.json";

/// The file of lines that train the blocks.
pub const JOBS: &str = "jobs.txt";

/// The output folder of a block's run, in the block's folder.
const RUN: &str = "run";

/// A plan, as its file holds it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BlockPlan {
    /// Version of the program that wrote it.
    pub version: String,
    /// Folders of the blocks, beside the plan.
    pub blocks: Vec<String>,
    /// Options of `splat train` that all lines share.
    pub options: Vec<String>,
}

pub struct PlanFolder {
    pub path: PathBuf,
    pub plan: BlockPlan,
}

impl PlanFolder {
    pub fn open(path: &Path) -> Result<Self> {
        let file = path.join(PLAN);
        let shown = file.display();
        let cannot = || format!("cannot read {shown}: give the `--out` of `splat blocks plan`");
        let text = fs::read(&file).with_context(cannot)?;
        let plan: BlockPlan = serde_json::from_slice(&text).with_context(cannot)?;
        Ok(Self { path: path.to_owned(), plan })
    }

    pub fn write(&self, lines: &[String]) -> Result<()> {
        output::write_lines(&self.path.join(JOBS), lines)?;
        output::write(&self.path.join(PLAN), |file| Ok(serde_json::to_writer_pretty(file, &self.plan)?))
    }

    /// Output folder of a block's run.
    pub fn run(&self, name: &str) -> PathBuf {
        self.path.join(name).join(RUN)
    }

    /// The files of the plan and of the blocks' runs, from which they are merged.
    pub fn files_of_runs(&self) -> impl Iterator<Item = PathBuf> {
        let of_run = |name: &String| {
            [self.path.join(name).join(BLOCK), self.run(name).join(SCENE), self.run(name).join(METRICS)]
        };
        let own = [PLAN, JOBS].map(|name| self.path.join(name));
        own.into_iter().chain(self.plan.blocks.iter().flat_map(of_run))
    }

    pub fn files(&self) -> Result<Vec<BlockFile>> {
        let file = |name: &String| {
            let folder = self.path.join(name);
            BlockFile::read(&folder).with_context(|| format!("the plan lists {}", folder.join(BLOCK).display()))
        };
        self.plan.blocks.iter().map(file).collect()
    }

    /// The capture that was cut.
    pub fn capture(&self, files: &[BlockFile]) -> Result<Capture> {
        let (name, file) =
            self.plan.blocks.iter().zip(files).next().with_context(|| format!("{PLAN} lists no block"))?;
        input::capture(&file.capture_folder(&self.path.join(name)))
    }
}

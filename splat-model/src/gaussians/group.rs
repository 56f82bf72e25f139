//! Named groups of parameters: one row of numbers for each Gaussian.

use std::ops::Range;

use burn::module::{Module, Param};
use burn::tensor::kind::Basic;
use burn::tensor::{Device, Tensor, TensorData, activation};
use splat_op::{largest_tensor, read_back};

use super::{Activation, BASE_GROUPS, GroupOptions, GroupRows, RowsError, SH, check_name};

/// A named parameter `[N, width]` with a row for each Gaussian.
#[derive(Module, Debug)]
pub struct Group {
    /// `[n, width]`: consecutive rows. There is one block, except for coefficients of spherical harmonics that exceed
    /// [`splat_op::largest_tensor`] (on wgpu from 11 million Gaussians of degree 3 on).
    pub(crate) blocks: Vec<Param<Tensor<2>>>,
    #[module(skip)]
    name: String,
    #[module(skip)]
    options: GroupOptions,
}

impl Group {
    /// A group of these values, `[N, width]`.
    ///
    /// # Errors
    /// If files cannot hold the name, because it is empty, contains white space, control characters or a slash, or is that of a property
    /// of every scene; if a row has no numbers, or an option is out of range.
    pub fn new(name: &str, values: Tensor<2>, options: GroupOptions) -> Result<Self, RowsError> {
        check_name(name)?;
        options.check(name)?;
        if values.dims()[1] == 0 {
            return Err(RowsError::empty(name));
        }
        Ok(Self::of_blocks(name, vec![Param::from_tensor(values)], options))
    }

    pub(crate) fn of_blocks(name: &str, blocks: Vec<Param<Tensor<2>>>, options: GroupOptions) -> Self {
        Self { blocks, name: name.to_owned(), options }
    }

    /// A group of numbers on the host, row-major.
    pub(super) fn of_numbers(name: &str, count: usize, width: usize, numbers: Vec<f32>, device: &Device) -> Self {
        let blocks = row_blocks(name, count, width, device);
        if blocks.len() == 1 {
            let values = tensor(numbers, [count, width], device);
            return Self::of_blocks(name, vec![Param::from_tensor(values)], GroupOptions::default());
        }
        let of = |rows: Range<usize>| {
            let part = numbers[width * rows.start..width * rows.end].to_vec();
            Param::from_tensor(tensor(part, [rows.len(), width], device))
        };
        Self::of_blocks(name, blocks.into_iter().map(of).collect(), GroupOptions::default())
    }

    /// The name.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// How the group is trained.
    pub fn options(&self) -> &GroupOptions {
        &self.options
    }

    pub(crate) fn set_options(&mut self, options: GroupOptions) {
        self.options = options;
    }

    /// Numbers in a row.
    pub fn width(&self) -> usize {
        self.blocks[0].val().dims()[1]
    }

    /// Number of rows.
    pub fn rows(&self) -> usize {
        self.blocks.iter().map(|block| block.val().dims()[0]).sum()
    }

    /// The same in blocks of consecutive rows, of which only coefficients of spherical harmonics have several.
    pub fn blocks(&self) -> impl Iterator<Item = Tensor<2>> {
        self.blocks.iter().map(Param::val)
    }

    /// `[N, width]`: the numbers that are trained, tracked on an autodiff device. Several blocks are joined, which a GPU may not hold.
    pub fn raw(&self) -> Tensor<2> {
        joined(self.blocks().collect())
    }

    /// `[N, width]`: the values, activated, tracked on an autodiff device.
    pub fn values(&self) -> Tensor<2> {
        let raw = self.raw();
        match self.options.activation {
            Activation::Identity => raw,
            Activation::Exp => raw.exp(),
            Activation::Sigmoid => activation::sigmoid(raw),
            Activation::Normalise => {
                let length = raw.clone().square().sum_dim(1).sqrt().clamp_min(f32::MIN_POSITIVE);
                raw / length
            }
        }
    }

    /// Some rows on the host, without their values.
    pub(super) fn about(&self) -> GroupRows {
        GroupRows { name: self.name.clone(), width: self.width(), values: Vec::new(), options: self.options }
    }

    /// Appends the numbers of some rows.
    pub(super) fn copy(&self, which: &Range<usize>, to: &mut Vec<f32>) {
        let mut first = 0;
        for block in &self.blocks {
            let block = block.val();
            let end = first + block.dims()[0];
            let (from, to_row) = (which.start.max(first), which.end.min(end));
            if from < to_row {
                to.extend(values_of(block.narrow(0, from - first, to_row - from)));
            }
            first = end;
        }
    }

    pub(super) fn untracked(&self) -> Self {
        let plain = |block: &Param<Tensor<2>>| Param::from_tensor(block.val().inner());
        Self { blocks: self.blocks.iter().map(plain).collect(), name: self.name.clone(), options: self.options }
    }
}

/// Divides the rows of a group into blocks that a device can hold; at least one. Only spherical harmonics have several: the render
/// takes them in blocks.
pub(crate) fn row_blocks(name: &str, count: usize, width: usize, device: &Device) -> Vec<Range<usize>> {
    let several = name == BASE_GROUPS[SH];
    let room = if several { largest_tensor(device) / (size_of::<f32>() * width) as u64 } else { u64::MAX };
    let rows = usize::try_from(room).unwrap_or(usize::MAX).max(1);
    (0..count.max(1)).step_by(rows).map(|first| first..first.saturating_add(rows).min(count)).collect()
}

pub(crate) fn joined<const D: usize, K: Basic>(mut blocks: Vec<Tensor<D, K>>) -> Tensor<D, K> {
    if blocks.len() == 1 { blocks.swap_remove(0) } else { Tensor::cat(blocks, 0) }
}

pub(super) fn tensor<const D: usize>(values: Vec<f32>, shape: [usize; D], device: &Device) -> Tensor<D> {
    Tensor::from_data(TensorData::new(values, shape), device)
}

/// All elements of a tensor, row-major.
pub fn values_of<const D: usize>(tensor: Tensor<D>) -> Vec<f32> {
    let data = read_back(tensor).convert::<f32>();
    data.try_into_vec().expect("converted to f32 in the line above")
}

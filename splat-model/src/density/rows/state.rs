//! What a checkpoint keeps of a scene in training: for each group its values and moments, each as one array.

use burn::module::Param;
use burn::tensor::{Device, Tensor};

use super::Trained;
use super::step::on;
use crate::density::pick::all_rows;
use crate::gaussians::{BASE_GROUPS, Gaussians, Group, GroupOptions, SH, joined, row_blocks};
use crate::optim::{MomentBits, Moments};
use crate::state::{State, StateError};

/// Entry of the names and options of the groups that are not in every scene.
const FURTHER: &str = "groups";

impl Trained {
    /// Saves parameters and moments.
    ///
    /// # Errors
    /// If the options of a group cannot be stored.
    pub fn save(&self) -> Result<State, StateError> {
        let mut state = State::default();
        let (all, count) = (self.gaussians.groups(), self.gaussians.len());
        let further: Vec<_> = all[BASE_GROUPS.len()..].iter().map(|group| (group.name(), group.options())).collect();
        if !further.is_empty() {
            state.tell(FURTHER, &further)?;
        }
        for (group, moments) in all.iter().zip(&self.moments) {
            state.in_part(group.name(), |part| match &moments[..] {
                [moments] => {
                    part.put("values", untracked(group.blocks[0].val()));
                    moments.save(part);
                }
                blocks => {
                    // Only a host can hold them as one.
                    let host = Device::flex();
                    let values = group.blocks.iter().map(|block| untracked(block.val()).to_device(&host)).collect();
                    let rows = group.blocks.iter().map(|block| block.val().dims()[0]);
                    let parts: Vec<_> =
                        blocks.iter().zip(rows).map(|(m, rows)| m.rows(0..rows, &host).take()).collect();
                    part.put("values", joined(values));
                    Moments::<2>::gathered(&parts, &all_rows(count, &host), count).save(part);
                }
            });
        }
        Ok(state)
    }

    /// Restores a scene with moments of so many bits. It can be trained if `device` is an autodiff device.
    ///
    /// # Errors
    /// If a value is missing, or if parameters and moments are inconsistent.
    pub fn load(from: &mut State, bits: MomentBits, device: &Device) -> Result<Self, StateError> {
        let further: Vec<(String, GroupOptions)> = if from.has(FURTHER) { from.told(FURTHER)? } else { Vec::new() };
        let own = BASE_GROUPS.map(|name| (name.to_owned(), GroupOptions::default()));
        let (mut groups, mut moments) = (Vec::new(), Vec::new());
        let mut count = None;
        for (name, options) in own.into_iter().chain(further) {
            let (mut group, of_group) = load_group(from, &name, count, bits, device)?;
            count = Some(group.rows());
            group.set_options(options);
            groups.push(group);
            moments.push(of_group);
        }
        Ok(Self { gaussians: Gaussians { groups }, moments, mark: None })
    }
}

/// A group on `device`, and its moments. It must have `count` rows, if that is known.
fn load_group(
    from: &mut State,
    name: &str,
    count: Option<usize>,
    bits: MomentBits,
    device: &Device,
) -> Result<(Group, Vec<Moments<2>>), StateError> {
    let plain = device.clone().inner();
    // One array may be too large for the device.
    let at_first = if name == BASE_GROUPS[SH] { Device::flex() } else { plain.clone() };
    let (values, moments) = from.load_part(name, |part| {
        let values: Tensor<2> = part.take("values", &at_first)?;
        let shape @ [rows, width] = values.dims();
        if count.is_some_and(|count| count != rows) || !fits(name, width) {
            return Err(part.shape_error("values", &shape, "one that fits the other arrays"));
        }
        Ok((values, Moments::load(part, shape, bits, &at_first)?))
    })?;
    let [count, width] = values.dims();
    let block = |rows: std::ops::Range<usize>| {
        let part = if rows.len() == count { values.clone() } else { values.clone().narrow(0, rows.start, rows.len()) };
        (Param::from_tensor(on(device, part.to_device(&plain))), moments.rows(rows, &plain))
    };
    let (blocks, moments) = row_blocks(name, count, width, device).into_iter().map(block).unzip();
    Ok((Group::of_blocks(name, blocks, GroupOptions::default()), moments))
}

/// Whether rows of a group may have so many numbers.
fn fits(name: &str, width: usize) -> bool {
    match BASE_GROUPS.iter().position(|own| *own == name) {
        Some(SH) => (1..=splat_op::sh::SH_DEGREE_MAX + 1).any(|side| 3 * side * side == width),
        Some(own) => width == [3, 4, 3, 1][own],
        None => width > 0,
    }
}

fn untracked(values: Tensor<2>) -> Tensor<2> {
    if values.is_autodiff() { values.inner() } else { values }
}

//! Rows chosen on the device: what strategies are made of. Nothing is read back but counts.

use burn::tensor::{Bool, DType, Device, Int, Tensor, TensorData};
use splat_op::argsort::{argsort, argsort_floats};
use splat_op::read_back;

use crate::fold::folded;

/// Numbers of rows of a scene are multiples of this: kernels are compiled for the widest vectors that divide a length, so that scenes
/// whose lengths have no divisor in common are compiled for again after every edit.
const ROWS_AT_A_TIME: usize = 8;

/// Scenes below this number of rows may have any, because a few rows matter in them and little is compiled anew.
const FEW: usize = 1024;

/// The largest number of rows up to `rows` that a scene may have.
pub(crate) fn rounded_down(rows: usize) -> usize {
    if rows < FEW { rows } else { rows / ROWS_AT_A_TIME * ROWS_AT_A_TIME }
}

/// How many rows to add to `surviving` ones of at most `most`, and how many of `doomed` rows to keep, so that the scene may have
/// their number.
pub(super) fn whole(surviving: usize, most: usize, doomed: usize) -> (usize, usize) {
    let excess = surviving + most - rounded_down(surviving + most);
    match (excess <= most, ROWS_AT_A_TIME - excess) {
        (true, _) => (most - excess, 0),
        (false, spared) if spared <= doomed => (most, spared),
        // A scene that began with a number of its own.
        (false, _) => (most, 0),
    }
}

/// `[N]`: 1 where the mask is set, else 0.
pub(super) fn ones(mask: Tensor<1, Bool>) -> Tensor<1, Int> {
    mask.int().cast(DType::I32)
}

pub(super) fn all_rows(count: usize, device: &Device) -> Tensor<1, Int> {
    Tensor::arange(0..count as i64, (device, DType::I32))
}

/// Rows as a tensor, for strategies that choose them on the host.
pub fn rows_on(device: &Device, rows: &[u32]) -> Tensor<1, Int> {
    let rows: Vec<i32> = rows.iter().map(|&row| row as i32).collect();
    let count = rows.len();
    Tensor::from_data(TensorData::new(rows, [count]), (device, DType::I32))
}

/// The numbers of rows of masks, read at once.
pub fn counts<const K: usize>(masks: [Tensor<1, Bool>; K]) -> [usize; K] {
    let sums = folded(Tensor::stack(masks.map(ones).to_vec(), 0), 0.0).sum_dim(2).sum_dim(1);
    let counts: Vec<usize> = read_back(sums).iter::<i64>().map(|count| count as usize).collect();
    counts.try_into().expect("one for each mask")
}

/// The rows of a mask, `[count]`, in the order of `order`, a permutation of all rows. `count` is their number.
pub fn picked(order: &Tensor<1, Int>, mask: &Tensor<1, Bool>, count: usize) -> Tensor<1, Int> {
    if count == 0 {
        return rows_on(&order.device(), &[]);
    }
    let others = ones(mask.clone().bool_not()).select(0, order.clone());
    order.clone().select(0, argsort(others, 1).narrow(0, 0, count))
}

/// The mask of the `count` rows of the mask `among` with the largest of `values`, `[N]`, which are not negative, and the largest value
/// of the others. Among equal values, later rows count as larger.
pub fn largest(values: &Tensor<1>, among: &Tensor<1, Bool>, count: usize) -> (Tensor<1, Bool>, Option<f64>) {
    let [rows] = values.dims();
    // Zeros of the mask come after others.
    let keys = (values.clone() + f64::from(f32::MIN_POSITIVE)).mask_fill(among.clone().bool_not(), 0.0);
    let order = argsort_floats(keys);
    let next = (count < rows).then(|| order.clone().narrow(0, rows - count - 1, 1));
    let next = next.and_then(|row| read_back(values.clone().select(0, row)).iter::<f64>().next());
    (inverse(order).greater_equal_elem((rows - count) as i64), next)
}

/// The place of each row in an order.
pub(super) fn inverse(order: Tensor<1, Int>) -> Tensor<1, Int> {
    let bits = order.dims()[0].max(2).ilog2() + 1;
    argsort(order, bits)
}

/// `[N]`: sums of whole numbers, `[N]`, over each row and those before it. Burn's own is a loop over all of them for each on a GPU.
pub(super) fn running_sums(values: Tensor<1, Int>) -> Tensor<1, Int> {
    let [count] = values.dims();
    let side = count.isqrt() + 1;
    let padding = Tensor::zeros([side * side - count], (&values.device(), DType::I32));
    let within = Tensor::cat(vec![values, padding], 0).reshape([side, side]).cumsum(1);
    let totals = within.clone().narrow(1, side - 1, 1);
    let before = totals.clone().cumsum(0) - totals;
    (within + before).reshape([side * side]).narrow(0, 0, count)
}

/// Each row as often as `copies`, `[N]`, says, in order: `[total]`, where `total` is their sum.
pub(super) fn repeated(copies: Tensor<1, Int>, total: usize) -> Tensor<1, Int> {
    let [count] = copies.dims();
    // A row ends before the places that other rows have. In the order of ends and places, a place comes after as many rows as end
    // before it, which is the number of its row.
    let ends = running_sums(copies) * 2;
    let places = all_rows(total, &ends.device());
    let keys = Tensor::cat(vec![ends, places.clone() * 2 + 1], 0);
    inverse(argsort(keys, (2 * total + 1).ilog2() + 1)).narrow(0, count, total) - places
}

#[cfg(test)]
mod tests;

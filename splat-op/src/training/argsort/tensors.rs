//! The sorts as tensor code. They run on the host, because Burn's sort reads keys back from a GPU. That sort leaves equal keys in any
//! order.

use burn::tensor::{DType, Device, Int, Tensor};

/// The order of whole numbers that are not negative.
pub(super) fn argsort(keys: Tensor<1, Int>) -> Tensor<1, Int> {
    let (device, [rows], host) = (keys.device(), keys.dims(), Device::flex());
    if rows < 2 {
        return Tensor::zeros([rows], (&device, DType::I32));
    }
    // A key and its row are one number, and no two are equal.
    let rows_on_host = Tensor::<1, Int>::arange(0..rows as i64, (&host, DType::I64));
    let keys = keys.to_device(&host).cast(DType::I64) * rows as i64 + rows_on_host;
    keys.argsort(0).cast(DType::I32).to_device(&device)
}

/// The order of numbers that are not negative.
pub(super) fn argsort_floats(keys: Tensor<1>) -> Tensor<1, Int> {
    let (device, [rows]) = (keys.device(), keys.dims());
    if rows < 2 {
        return Tensor::zeros([rows], (&device, DType::I32));
    }
    let keys = keys.to_device(&Device::flex());
    let order = keys.clone().argsort(0);
    let sorted = keys.select(0, order.clone());
    // How many different keys come before each. All NaN are one.
    let (before, after) = (sorted.clone().narrow(0, 0, rows - 1), sorted.narrow(0, 1, rows - 1));
    let differs = before.clone().not_equal(after).bool_and(before.is_nan().bool_not()).int();
    let before = Tensor::cat(vec![Tensor::zeros([1], &differs.device()), differs.cumsum(0)], 0);
    argsort(before.select(0, order.argsort(0))).to_device(&device)
}

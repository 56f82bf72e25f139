use burn::tensor::Device;

use super::*;

#[test]
fn a_stand_in_has_the_gradients_of_the_loss_to_the_bit() {
    let device = Device::flex();
    let leaf = |shape| Tensor::<2>::from_inner(Tensor::ones(shape, &device)).require_grad();
    let (a, b, unused) = (leaf([2, 3]), leaf([1, 1]), leaf([4, 1]));
    let odd = [0.1, -0.0, f32::MIN_POSITIVE / 8.0, f32::MAX, f32::INFINITY, -7.25];
    let weights = Tensor::<2>::from_data(TensorData::new(odd.to_vec(), [2, 3]), &device);
    let loss = (a.clone() * Tensor::from_inner(weights)).sum() + b.clone().sum() * 3.0;
    let gradients = loss.backward();
    let leaves = [&a, &b, &unused].map(|leaf| Leaf::new(leaf.clone()));
    assert_eq!(leaves.each_ref().map(Leaf::count), [6, 1, 4]);
    let [of_a, of_b, none] = leaves.each_ref().map(|leaf| leaf.gradient(&gradients));
    assert!(none.is_none());
    let (of_a, of_b) = (of_a.unwrap(), of_b.unwrap());
    let stand_in = stand_in([(&leaves[0], &of_a[..]), (&leaves[1], &of_b[..])]).unwrap();
    let bits = |values: Vec<f32>| values.into_iter().map(f32::to_bits).collect::<Vec<_>>();
    assert_eq!(bits(values_of(a.grad(&stand_in).unwrap())), odd.map(f32::to_bits));
    assert_eq!(values_of(b.grad(&stand_in).unwrap()), [3.0]);
    assert!(unused.grad(&stand_in).is_none());
}

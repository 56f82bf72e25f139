use burn::nn::{Linear, LinearConfig};
use burn::tensor::{Device, Distribution};

use super::*;
use crate::gaussians::testing::devices;
use crate::gaussians::values_of;

/// The line y = W x + b of a linear layer is found, and a network that is loaded half way goes on to the same bits.
#[test]
fn a_network_learns_and_resumes() {
    for device in devices() {
        let layer = |device: &Device| LinearConfig::new(2, 3).init(device);
        let weights = |network: &Network<Linear>| {
            let layer = network.value();
            [values_of(layer.weight.val()), values_of(layer.bias.expect("a layer with a bias").val())]
        };
        let truth: Linear = layer(&device);
        let (mut whole, mut resumed) = (Network::new(layer(&device.clone().autodiff())), Network::new(layer(&device)));
        assert_ne!(weights(&whole), weights(&resumed));
        let points = Tensor::<2>::random([40, 2], Distribution::Uniform(-1.0, 1.0), &device);
        let step = |network: &mut Network<Linear>| {
            let found = network.tracked().forward(Tensor::from_inner(points.clone()));
            let loss = (found - Tensor::from_inner(truth.forward(points.clone()))).square().mean();
            network.step(&mut loss.backward(), 0.02, None);
            loss.into_scalar::<f32>()
        };
        let first = step(&mut whole);
        (0..200).for_each(|_| _ = step(&mut whole));
        assert_eq!(whole.leaves().len(), 2);
        let mut state = State::default();
        whole.save(&mut state).unwrap();
        resumed.load(&mut state).unwrap();
        state.finish().unwrap();
        for _ in 0..200 {
            assert_eq!(step(&mut whole), step(&mut resumed));
        }
        assert_eq!(weights(&whole), weights(&resumed));
        let last = step(&mut whole);
        assert!(last < 1e-4 * first, "{first} to {last}");
    }
}

//! Renders one Gaussian, and prints its picture and the gradient of its centre.
use burn::tensor::{Device, Tensor};
use glam::{DAffine3, DVec3};
use splat_op::{Camera, Colour, Extras, Intrinsics, RenderOptions, Splats, render};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let device = Device::flex().autodiff();
    let means = Tensor::<2>::from_floats([[0.2, 0.1, 0.0]], &device).require_grad();
    let splats = Splats {
        means: means.clone(),
        rotations: Tensor::from_floats([[1.0, 0.0, 0.0, 0.3]], &device),
        scales: Tensor::from_floats([[0.5, 0.2, 0.2]], &device),
        opacities: Tensor::from_floats([0.9], &device),
        colour: Colour::Features(Tensor::from_floats([[1.0, 0.5, 0.1]], &device)),
    };
    // Two units in front of a camera that looks along +z.
    let cam_from_world = DAffine3::from_translation(DVec3::new(0.0, 0.0, 2.0));
    let camera = Camera::new(Intrinsics::centred(48, 24, 30.0), &cam_from_world, &device);
    let rendered = render(&splats, &[camera], &Extras::default(), &RenderOptions::standard())?;
    for row in rendered.alpha.clone().inner().into_data().try_to_vec::<f32>()?.chunks(48) {
        println!("{}", row.iter().map(|a| b" .:-=+*#%@"[(a * 9.9) as usize] as char).collect::<String>());
    }
    let gradients = rendered.colour.mean().backward();
    println!("gradient at the centre: {}", means.grad(&gradients).ok_or("the centre is tracked")?);
    Ok(())
}

//! A smaller scene (after Lee et al. 2024, "Compact 3D Gaussian Representation", and Müller et al. 2022, "Instant NGP"): a hash grid and a
//! small network predict harmonics from the Gaussian's centre, instead of storing them. Prints bytes of colour and dB.
//! Run: `cargo run --release -p splat-gallery --example compact -- compact.png`.
use burn::module::{Module, Param};
use burn::nn::{Linear, LinearConfig};
use burn::tensor::activation::relu;
use burn::tensor::{Device, Distribution, Int, Tensor, TensorData};
use burn_optim::{AdamConfig, GradientsParams};
use splat_demo::DemoOptions;
use splat_gallery::{SMALL, Shot, demo, picture, quality, save, shown, trained};
use splat_model::loss::{DEFAULT_LAMBDA, photometric};
use splat_model::trainer::TrainConfig;
use splat_op::{Colour, SplatError, Splats};

const DEGREE: usize = 2;
const COEFFICIENTS: usize = (DEGREE + 1) * (DEGREE + 1);
const LEVELS: usize = 6;
/// Rows of a level's table, and numbers in each.
const ROWS: usize = 2048;
const WIDTH: usize = 4;
const HIDDEN: usize = 32;
const STEPS: usize = 600;

/// A hash grid and the network behind it.
#[derive(Module, Debug)]
struct Field {
    /// `[LEVELS · ROWS, WIDTH]`.
    table: Param<Tensor<2>>,
    hidden: Linear,
    output: Linear,
}

/// Where the Gaussians lie in the grids: constants, since their centres are.
struct Places {
    /// `[N · LEVELS · 8]`: rows of the table, for the corners of each cell.
    rows: Tensor<1, Int>,
    /// `[N · LEVELS, 8, 1]`: trilinear weights.
    weights: Tensor<3>,
}

impl Places {
    fn new(means: &Tensor<2>, device: &Device) -> Self {
        let (low, high) = (means.clone().min_dim(0), means.clone().max_dim(0));
        let unit: Vec<f32> = ((means.clone() - low.clone()) / (high - low)).into_data().iter::<f32>().collect();
        let count = unit.len() / 3;
        let (mut rows, mut weights) = (Vec::new(), Vec::new());
        for centre in unit.chunks_exact(3) {
            for level in 0..LEVELS {
                let at: [f32; 3] = std::array::from_fn(|axis| centre[axis] * (8 << level) as f32);
                for corner in 0..8 {
                    let upper: [u32; 3] = std::array::from_fn(|axis| corner >> axis & 1);
                    let [x, y, z] = std::array::from_fn(|axis| at[axis] as u32 + upper[axis]);
                    // The primes are those of the paper on hash grids.
                    let hash = x ^ y.wrapping_mul(2_654_435_761) ^ z.wrapping_mul(805_459_861);
                    rows.push((level * ROWS + hash as usize % ROWS) as i32);
                    let part = |axis: usize| if upper[axis] == 1 { at[axis].fract() } else { 1.0 - at[axis].fract() };
                    weights.push(part(0) * part(1) * part(2));
                }
            }
        }
        let weights = Tensor::from_data(TensorData::new(weights, [count * LEVELS, 8, 1]), device);
        Self { rows: Tensor::from_ints(&rows[..], device), weights }
    }
}

impl Field {
    fn new(device: &Device) -> Self {
        let small = Distribution::Uniform(-1e-2, 1e-2);
        Self {
            table: Param::from_tensor(Tensor::random([LEVELS * ROWS, WIDTH], small, device)),
            hidden: LinearConfig::new(LEVELS * WIDTH, HIDDEN).init(device),
            output: LinearConfig::new(HIDDEN, COEFFICIENTS * 3).init(device),
        }
    }

    /// Harmonics, `[N, (DEGREE + 1)², 3]`.
    fn forward(&self, at: &Places) -> Tensor<3> {
        let cells = at.weights.dims()[0];
        let corners = self.table.val().select(0, at.rows.clone()).reshape([cells, 8, WIDTH]);
        let features = (corners * at.weights.clone()).sum_dim(1).reshape([cells / LEVELS, LEVELS * WIDTH]);
        let harmonics = self.output.forward(relu(self.hidden.forward(features)));
        harmonics.reshape([cells / LEVELS, COEFFICIENTS, 3])
    }
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let device = Device::flex().autodiff();
    device.seed(1);
    let options = DemoOptions { glossy: true, ..SMALL };
    let (shots, points) = demo(options, &device.clone().inner())?;
    let scene = trained(&shots, &points, TrainConfig { sh_degree: DEGREE, ..TrainConfig::for_steps(400) })?;
    let places = Places::new(&scene.means, &device);
    let mut field = Field::new(&device);
    let painted =
        |field: &Field| Splats { colour: Colour::SphericalHarmonics(field.forward(&places)), ..scene.clone() };
    let mut optimiser = AdamConfig::new().init();
    for step in 0..STEPS {
        let shot = &shots[step * 7 % shots.len()];
        let loss = photometric(shown(&painted(&field), &shot.camera)?.colour, &shot.truth, DEFAULT_LAMBDA);
        let gradients = GradientsParams::from_grads(loss.backward(), &field);
        field = optimiser.step(0.01 * 0.1_f64.powf(step as f64 / STEPS as f64), field, gradients);
    }
    let Colour::SphericalHarmonics(harmonics) = painted(&field).colour else { unreachable!("it was made so") };
    let small = Splats { colour: Colour::SphericalHarmonics(harmonics.inner()), ..scene.clone() };
    let (stored, predicted) = (4 * 3 * COEFFICIENTS * scene.means.dims()[0], 4 * field.num_params());
    let of = |scene: &Splats, shot: &Shot| Ok::<_, SplatError>(shown(scene, &shot.camera)?.colour);
    let quality_of = |scene: &Splats| quality(&shots, |shot| Ok((of(scene, shot)?, shot.image())));
    let (before, after) = (quality_of(&scene)?, quality_of(&small)?);
    println!("harmonics stored    {stored:7} bytes  {before:.2} dB");
    println!("harmonics predicted {predicted:7} bytes  {after:.2} dB");
    assert!(2 * predicted < stored && after > before - 1.5, "the field costs too much");
    save(&picture()?, vec![shots[0].image(), of(&scene, &shots[0])?, of(&small, &shots[0])?])
}

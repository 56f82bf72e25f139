//! Splatting by the papers' formulas (Zwicker et al. 2001; Kerbl et al. 2023), as in most implementations:
//! determinant `a c − b²`, an inverted covariance, an expanded quadratic form, division by `1 − α` in the backward pass.
//! Every pixel visits every Gaussian, over any [`Number`]: in f32 this fills the table's textbook columns, in [`Wide`] it is
//! the reference. It shares no code with the operation.

mod linalg;
mod project;
mod rasterize;

use rayon::prelude::*;
use splat_op::RenderOptions;

use self::linalg::{add, plus, zero};
use self::project::{Conic, TextbookCamera, TextbookGaussian, TextbookProjection, project};
use self::rasterize::{Cuts, PixelGrad};
use crate::evaluate::Outputs;
use crate::number::{Number, Wide};
use crate::scene::{HardScene, OutputWeights};

/// How the backward pass obtains the transmittance in front of a layer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Backward {
    /// Divides the final transmittance by `1 − α` layer by layer, as the textbook does.
    Dividing,
    /// Keeps the forward pass's values: the reference must not divide by zero.
    Kept,
}

/// Number of pixels per partial sum. The partial sums are added in a fixed order.
const CHUNK: usize = 64;

/// The projected and sorted scene, before rasterization.
struct ProjectedScene<N> {
    lens: TextbookCamera<N>,
    /// Visible Gaussians, by depth and then by order of input, each with its index in the input.
    projected: Vec<(usize, TextbookProjection<N>)>,
    colours: Vec<Vec<N>>,
    background: Vec<N>,
}

fn all<N: Number>(values: &[f64]) -> Vec<N> {
    values.iter().map(|v| N::of(*v)).collect()
}

/// Activated parameters of one Gaussian.
fn gaussian<N: Number>(scene: &HardScene, i: usize) -> TextbookGaussian<N> {
    let take = |values: &[f64], k: usize| N::of(values[k]);
    let one = N::of(1.0);
    let activated = |scale: N| if scene.stored { scale.exp() } else { scale };
    let opacity = take(&scene.opacities, i);
    TextbookGaussian {
        mean: [0, 1, 2].map(|k| take(&scene.means, 3 * i + k)),
        quat: [0, 1, 2, 3].map(|k| take(&scene.quats, 4 * i + k)),
        scale: [0, 1, 2].map(|k| activated(take(&scene.scales, 3 * i + k))),
        opacity: if scene.stored { one / (one + (-opacity).exp()) } else { opacity },
    }
}

impl<N: Number> ProjectedScene<N> {
    fn new(scene: &HardScene) -> Self {
        let lens = TextbookCamera::new(&scene.pose, &scene.intrinsics, &scene.options);
        let seen = (0..scene.count()).filter_map(|i| Some((i, project(gaussian(scene, i), &lens)?)));
        let mut projected: Vec<(usize, TextbookProjection<N>)> = seen.collect();
        // A stable sort, in which values without an order (NaN) count as equal.
        projected
            .sort_by(|(_, a), (_, b)| a.conic.depth.partial_cmp(&b.conic.depth).unwrap_or(std::cmp::Ordering::Equal));
        let colour = |i: usize| all(&scene.colours[i * scene.channels()..(i + 1) * scene.channels()]);
        let colours = projected.iter().map(|(i, _)| colour(*i)).collect();
        Self { lens, projected, colours, background: all(&scene.background) }
    }

    fn splats(&self) -> Vec<(Conic<N>, &[N])> {
        self.projected.iter().zip(&self.colours).map(|((_, p), colour)| (p.conic, colour.as_slice())).collect()
    }
}

fn centre<N: Number>(scene: &HardScene, pixel: usize) -> [N; 2] {
    let width = scene.intrinsics.width;
    [pixel % width, pixel / width].map(|px| N::of(px as f64 + 0.5))
}

/// Returns the largest condition number of a 2D covariance in the scene.
pub fn condition(scene: &HardScene) -> f64 {
    let view = ProjectedScene::<Wide>::new(scene);
    view.projected.iter().map(|(_, p)| p.condition()).fold(1.0, f64::max)
}

/// `image alpha` of every pixel under the given options, for boundary bands.
pub fn pictures<N: Number>(scene: &HardScene, options: &RenderOptions) -> Vec<Vec<f64>> {
    let view = ProjectedScene::<N>::new(&HardScene { options: *options, ..scene.clone() });
    let (splats, cuts) = (view.splats(), Cuts::new(options));
    let pixels = scene.intrinsics.width * scene.intrinsics.height;
    let pixel = |pixel: usize| {
        let seen = rasterize::forward(centre(scene, pixel), &splats, &view.background, &cuts);
        seen.colour.iter().map(|v| v.f64()).chain([seen.transmittance.f64()]).collect()
    };
    (0..pixels).into_par_iter().map(pixel).collect()
}

/// Colour, alpha and depth of one pixel.
type PixelValues<N> = (Vec<N>, N, N);

/// Sums over pixels: one per visible Gaussian, and one for the background.
type PixelSums<N> = (Vec<(Conic<N>, Vec<N>)>, Vec<N>);

/// Renders and differentiates a scene whose colours are features.
pub fn evaluate<N: Number>(scene: &HardScene, weights: &OutputWeights, style: Backward) -> Outputs {
    let view = ProjectedScene::<N>::new(scene);
    let (splats, cuts) = (view.splats(), Cuts::new(&scene.options));
    let channels = scene.channels();
    let pixels = scene.intrinsics.width * scene.intrinsics.height;
    let nought = N::of(0.0);
    let nothing = || Conic { mean_px: [nought; 2], conic: [nought; 3], depth: nought, opacity: nought };
    let chunk = |first: usize| -> (Vec<PixelValues<N>>, PixelSums<N>) {
        let mut sums: Vec<_> = splats.iter().map(|_| (nothing(), vec![nought; channels])).collect();
        let mut background = vec![nought; channels];
        let seen = (first..(first + CHUNK).min(pixels)).map(|pixel| {
            let out = rasterize::forward(centre(scene, pixel), &splats, &view.background, &cuts);
            let grad = PixelGrad {
                colour: all(&weights.image[channels * pixel..channels * (pixel + 1)]),
                alpha: N::of(weights.alpha[pixel]),
                depth: N::of(weights.depth[pixel]),
            };
            rasterize::backward(&out, &grad, &splats, &view.background, style, &mut sums);
            background.iter_mut().zip(&grad.colour).for_each(|(sum, g)| *sum = *sum + out.transmittance * *g);
            (out.colour, N::of(1.0) - out.transmittance, out.depth)
        });
        (seen.collect(), (sums, background))
    };
    let chunks: Vec<_> = (0..pixels).step_by(CHUNK).collect::<Vec<_>>().into_par_iter().map(chunk).collect();
    let mut pictures = [Vec::new(), Vec::new(), Vec::new()];
    let mut total: Option<PixelSums<N>> = None;
    for (seen, sums) in chunks {
        for (colour, alpha, depth) in seen {
            pictures[0].extend(colour.iter().map(|v| v.f64()));
            pictures[1].push(alpha.f64());
            pictures[2].push(depth.f64());
        }
        total = Some(match total {
            Some(total) => added(total, sums),
            None => sums,
        });
    }
    let (sums, background) = total.expect("a picture has pixels");
    gradients(scene, &view, &sums, &background, pictures)
}

fn added<N: Number>((mut conics, mut background): PixelSums<N>, (more, behind): PixelSums<N>) -> PixelSums<N> {
    let sum = |to: &mut N, from: N| *to = *to + from;
    for ((to, to_colour), (from, from_colour)) in conics.iter_mut().zip(more) {
        to.mean_px.iter_mut().zip(from.mean_px).for_each(|(to, from)| sum(to, from));
        to.conic.iter_mut().zip(from.conic).for_each(|(to, from)| sum(to, from));
        sum(&mut to.depth, from.depth);
        sum(&mut to.opacity, from.opacity);
        to_colour.iter_mut().zip(from_colour).for_each(|(to, from)| sum(to, from));
    }
    background.iter_mut().zip(behind).for_each(|(to, from)| sum(to, from));
    (conics, background)
}

/// Computes the gradients of the parameters from the sums over pixels.
fn gradients<N: Number>(
    scene: &HardScene,
    view: &ProjectedScene<N>,
    sums: &[(Conic<N>, Vec<N>)],
    background: &[N],
    pictures: [Vec<f64>; 3],
) -> Outputs {
    let (count, channels) = (scene.count(), scene.channels());
    let rows = |columns: usize| vec![0.0; count * columns];
    let [mut means, mut quats, mut scales] = [rows(3), rows(4), rows(3)];
    let [mut opacities, mut colours, mut mean2d] = [rows(1), rows(channels), rows(2)];
    let mut pose = (zero::<N>(), [N::of(0.0); 3]);
    let store = |to: &mut [f64], i: usize, row: &[N]| {
        to[i * row.len()..(i + 1) * row.len()].iter_mut().zip(row).for_each(|(to, v)| *to = v.f64());
    };
    for ((i, projected), (grad, grad_colour)) in view.projected.iter().zip(sums) {
        let mut one = projected.backward(&view.lens, grad);
        if scene.stored {
            let activated = gaussian::<N>(scene, *i);
            one.scale = [0, 1, 2].map(|k| one.scale[k] * activated.scale[k]);
            // The derivative of the logistic function, with `1 − σ(x) = σ(−x)`.
            let logit = N::of(scene.opacities[*i]);
            one.opacity = one.opacity * activated.opacity * (N::of(1.0) / (N::of(1.0) + logit.exp()));
        }
        store(&mut means, *i, &one.mean);
        store(&mut quats, *i, &one.quat);
        store(&mut scales, *i, &one.scale);
        store(&mut opacities, *i, &[one.opacity]);
        store(&mut colours, *i, grad_colour);
        store(&mut mean2d, *i, &grad.mean_px);
        pose = (plus(&pose.0, &one.pose_rotation), add(pose.1, one.pose_translation));
    }
    let pose = [0, 1, 2].map(|row| [pose.0[row][0], pose.0[row][1], pose.0[row][2], pose.1[row]].map(N::f64)).concat();
    let background = background.iter().map(|v| v.f64()).collect();
    Outputs::new(scene, pictures, [means, quats, scales, opacities, colours, mean2d, pose, background])
}

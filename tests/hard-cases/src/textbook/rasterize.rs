//! Rasterization of one pixel, as in most implementations: an expanded quadratic form forwards, and backwards a
//! transmittance that is divided by `1 − α` layer by layer.

use splat_op::RenderOptions;

use super::Backward;
use super::project::Conic;
use crate::number::Number;

/// Thresholds of alpha and transmittance.
pub struct Cuts<N> {
    alpha_min: N,
    alpha_max: N,
    transmittance_min: N,
}

impl<N: Number> Cuts<N> {
    pub fn new(options: &RenderOptions) -> Self {
        Self {
            alpha_min: N::of(options.alpha_min),
            alpha_max: N::of(options.alpha_max),
            transmittance_min: N::of(options.transmittance_min),
        }
    }
}

/// One layer at a pixel.
pub struct TextbookLayer<N> {
    /// Index in the order of depth.
    place: usize,
    offset: [N; 2],
    falloff: N,
    alpha: N,
    /// Whether alpha is below its limit.
    free: bool,
    /// Transmittance in front of the layer.
    transmittance: N,
}

/// Result of one pixel, and the layers that contribute to it.
pub struct TextbookPixel<N> {
    pub colour: Vec<N>,
    pub depth: N,
    pub transmittance: N,
    pub layers: Vec<TextbookLayer<N>>,
}

/// Rasterizes one pixel, front to back over sorted `splats`, each with its colour.
pub fn forward<N: Number>(
    centre: [N; 2],
    splats: &[(Conic<N>, &[N])],
    background: &[N],
    cuts: &Cuts<N>,
) -> TextbookPixel<N> {
    let (zero, one) = (N::of(0.0), N::of(1.0));
    let mut pixel =
        TextbookPixel { colour: vec![zero; background.len()], depth: zero, transmittance: one, layers: Vec::new() };
    for (place, (splat, colour)) in splats.iter().enumerate() {
        let offset = [0, 1].map(|i| centre[i] - splat.mean_px[i]);
        let ([dx, dy], [a, b, c]) = (offset, splat.conic);
        let power = -(N::of(0.5) * (a * dx * dx + c * dy * dy)) - b * dx * dy;
        if power > zero {
            continue;
        }
        let falloff = power.exp();
        let unlimited = splat.opacity * falloff;
        let free = unlimited < cuts.alpha_max;
        let alpha = if free { unlimited } else { cuts.alpha_max };
        if alpha < cuts.alpha_min {
            continue;
        }
        let behind = pixel.transmittance * (one - alpha);
        if cuts.transmittance_min > zero && behind <= cuts.transmittance_min {
            break;
        }
        let weight = alpha * pixel.transmittance;
        pixel.colour.iter_mut().zip(*colour).for_each(|(sum, c)| *sum = *sum + weight * *c);
        pixel.depth = pixel.depth + weight * splat.depth;
        pixel.layers.push(TextbookLayer { place, offset, falloff, alpha, free, transmittance: pixel.transmittance });
        pixel.transmittance = behind;
    }
    pixel.colour.iter_mut().zip(background).for_each(|(sum, c)| *sum = *sum + pixel.transmittance * *c);
    pixel
}

/// Gradient of the loss with respect to one pixel's outputs.
pub struct PixelGrad<N> {
    pub colour: Vec<N>,
    pub alpha: N,
    pub depth: N,
}

/// Adds a pixel's share to the gradients of the `splats` and of their colours.
pub fn backward<N: Number>(
    pixel: &TextbookPixel<N>,
    grad: &PixelGrad<N>,
    splats: &[(Conic<N>, &[N])],
    background: &[N],
    style: Backward,
    sums: &mut [(Conic<N>, Vec<N>)],
) {
    let (zero, one) = (N::of(0.0), N::of(1.0));
    let inner = |a: &[N], b: &[N]| a.iter().zip(b).fold(zero, |sum, (a, b)| sum + *a * *b);
    let through_background = inner(&grad.colour, background);
    // `g·R`, the share of everything behind the layer in the loss. Implementations that divide leave out the background.
    let mut behind = match style {
        Backward::Dividing => zero,
        Backward::Kept => through_background,
    };
    let mut transmittance = pixel.transmittance;
    for layer in pixel.layers.iter().rev() {
        let (splat, colour) = &splats[layer.place];
        let (alpha, through) = (layer.alpha, one - layer.alpha);
        transmittance = match style {
            Backward::Dividing => transmittance / through,
            Backward::Kept => layer.transmittance,
        };
        let own = inner(&grad.colour, colour) + grad.depth * splat.depth;
        let mut grad_alpha = match style {
            Backward::Dividing => {
                // Effect of each layer on the final transmittance, and thereby on background and alpha.
                (own - behind) * transmittance + pixel.transmittance / through * (grad.alpha - through_background)
            }
            // Alpha is a channel whose colour is one, over a background of zero.
            Backward::Kept => (own + grad.alpha - behind) * transmittance,
        };
        behind = match style {
            Backward::Dividing => alpha * own + through * behind,
            Backward::Kept => alpha * (own + grad.alpha) + through * behind,
        };
        let weight = alpha * transmittance;
        let (sum, colour_sum) = &mut sums[layer.place];
        colour_sum.iter_mut().zip(&grad.colour).for_each(|(sum, g)| *sum = *sum + weight * *g);
        sum.depth = sum.depth + weight * grad.depth;
        if !layer.free {
            grad_alpha = zero;
        }
        sum.opacity = sum.opacity + layer.falloff * grad_alpha;
        let grad_power = grad_alpha * alpha;
        let ([dx, dy], [a, b, c]) = (layer.offset, splat.conic);
        let half = N::of(0.5);
        sum.conic[0] = sum.conic[0] - half * dx * dx * grad_power;
        sum.conic[1] = sum.conic[1] - dx * dy * grad_power;
        sum.conic[2] = sum.conic[2] - half * dy * dy * grad_power;
        sum.mean_px[0] = sum.mean_px[0] + (a * dx + b * dy) * grad_power;
        sum.mean_px[1] = sum.mean_px[1] + (b * dx + c * dy) * grad_power;
    }
}

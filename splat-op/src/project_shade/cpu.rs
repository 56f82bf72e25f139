//! The CPU twin: the twins of the two stages one after the other, the second for what can show.

use super::{ProjectShadeNeeds, reach_sigmas};
use crate::project::cpu::{Grads as ProjectGrads, Inputs as ProjectInputs, project_backward_cpu, project_cpu};
use crate::project::{COLUMNS, Ellipse, ProjectSpec};
use crate::real::Real;
use crate::shade::ShadeNeeds;
use crate::shade::cpu::{Coefficients, Inputs as ShadeInputs, shade_backward_onto_cpu, shade_where_cpu};

/// Borrowed inputs, row-major.
#[derive(Clone, Copy)]
pub(crate) struct Inputs<'a, F> {
    pub geometry: ProjectInputs<'a, F>,
    pub sh: Coefficients<'a, F>,
    /// Coefficients per channel.
    pub coefficients: usize,
    /// Those of matte Gaussians, one per channel, which come last.
    pub matte: Option<Coefficients<'a, F>>,
}

impl<'a, F: Real> Inputs<'a, F> {
    /// Where matte Gaussians begin.
    fn directional(&self) -> usize {
        (self.geometry.means.len() - self.matte.map_or(0, |matte| matte.len())) / 3
    }

    /// Of all that are not matte.
    fn shade(&self) -> ShadeInputs<'a, F> {
        let ProjectInputs { means, cam_from_world, .. } = self.geometry;
        let means = &means[..3 * self.directional()];
        ShadeInputs { sh: self.sh, means, cam_from_world, coefficients: self.coefficients }
    }

    /// Of those that are.
    fn shade_matte(&self) -> Option<ShadeInputs<'a, F>> {
        let ProjectInputs { means, cam_from_world, .. } = self.geometry;
        let means = &means[3 * self.directional()..];
        self.matte.map(|sh| ShadeInputs { sh, means, cam_from_world, coefficients: 1 })
    }
}

/// Gradients; an empty vector where none was asked for.
pub(crate) struct Grads<F> {
    pub geometry: ProjectGrads<F>,
    pub sh: Vec<F>,
    pub matte: Vec<F>,
}

/// What can show in a picture.
struct Frame<F> {
    sigmas: F,
    /// Of the picture, px.
    size: [F; 2],
}

impl<F: Real> Frame<F> {
    fn new(spec: &ProjectSpec) -> Self {
        let size = [spec.intrinsics.width, spec.intrinsics.height];
        Self { sigmas: F::of(reach_sigmas(spec.options.alpha_min)), size: size.map(|px| F::of(px as f64)) }
    }

    /// The box of [`reach_sigmas`]; an opacity above one, which the op does not forbid, reaches further than it.
    #[inline(always)]
    fn may_show(&self, ellipse: &Ellipse<F>) -> bool {
        let half = [ellipse.sigma_u, ellipse.sigma_v + ellipse.shear.abs() * ellipse.sigma_u];
        let meets = |axis: usize| {
            let (centre, half) = (ellipse.mean_px[axis], self.sigmas * half[axis] + F::ONE);
            centre + half >= F::ZERO && centre - half <= self.size[axis]
        };
        ellipse.opacity > F::ONE || (ellipse.opacity > F::ZERO && meets(0) && meets(1))
    }
}

/// `[N, 7]` packed ellipses and `[N, 3]` colours.
pub(crate) fn project_shade_cpu<F: Real>(inputs: Inputs<F>, spec: &ProjectSpec) -> (Vec<F>, Vec<F>) {
    let packed = project_cpu(inputs.geometry, spec);
    let frame = Frame::new(spec);
    let shown = |i: usize| frame.may_show(&Ellipse::from_row(&packed[COLUMNS * i..COLUMNS * (i + 1)]));
    let mut colours = shade_where_cpu(inputs.shade(), shown);
    if let Some(matte) = inputs.shade_matte() {
        let first = inputs.directional();
        colours.extend(shade_where_cpu(matte, |i| shown(first + i)));
    }
    (packed, colours)
}

/// Gradients of the inputs from those of the packed ellipses, `[N, 7]`, and of the colours, `[N, 3]`.
pub(crate) fn project_shade_backward_cpu<F: Real>(
    inputs: Inputs<F>,
    (grad_packed, grad_colours): (&[F], &[F]),
    spec: &ProjectSpec,
    needs: ProjectShadeNeeds,
) -> Grads<F> {
    assert!(!needs.geometry.cam_from_world, "where the pose is trained, the stages run one by one");
    let mut geometry = project_backward_cpu(inputs.geometry, grad_packed, spec, needs.geometry);
    let means = std::mem::take(&mut geometry.means);
    let shade_needs = ShadeNeeds { sh: needs.sh, means: needs.geometry.means, cam_from_world: false };
    let of_shade = shade_backward_onto_cpu(inputs.shade(), grad_colours, means, shade_needs);
    geometry.means = of_shade.means;
    let matte = match inputs.shade_matte() {
        // Their colours do not depend on where they are.
        Some(matte) if needs.matte => {
            let shade_needs = ShadeNeeds { sh: true, means: false, cam_from_world: false };
            shade_backward_onto_cpu(matte, &grad_colours[3 * inputs.directional()..], Vec::new(), shade_needs).sh
        }
        _ => Vec::new(),
    };
    Grads { geometry, sh: of_shade.sh, matte }
}

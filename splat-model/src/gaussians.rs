//! The scene: Gaussians with unconstrained parameters.

/// The rows of a scene on the host, as files hold them. Row `i` of every field belongs to Gaussian `i`.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct GaussianRows {
    /// Centres, world frame, scene units.
    pub means: Vec<[f32; 3]>,
    /// Rotations, quaternions wxyz of any non-zero length.
    pub rotations: Vec<[f32; 4]>,
    /// Natural logarithms of the standard deviations along the rotated axes.
    pub log_scales: Vec<[f32; 3]>,
    /// Logits of the opacities.
    pub logit_opacities: Vec<f32>,
    /// Degree-0 spherical-harmonics coefficient per colour channel.
    pub sh_dc: Vec<[f32; 3]>,
    /// Higher coefficients, `[N, (degree+1)² − 1, 3]` row-major: coefficient by coefficient, channels innermost.
    pub sh_rest: Vec<f32>,
    /// Degree of the spherical harmonics, 0 to 4.
    pub sh_degree: usize,
}

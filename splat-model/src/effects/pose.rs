//! Refinement of the photographs' poses along with the scene.
//!
//! A correction rotates a camera by `R(ω)` and moves it by `e τ` in its own frame: `cam_from_world` becomes
//! `[R(ω) R₀ | R(ω) t₀ + e τ]`. `e` is the scene extent, so that `ω` and `τ` are of similar size. `R(ω)` is the Cayley map
//! of `ω/2`, a rotation up to rounding for every `ω` ([`splat_op::pose`] has the formulas). It rotates about `ω` by
//! `2 atan(|ω|/2)`, which differs from `|ω|` in third order. It has no division by an angle and no square root: the map and
//! its derivative are rational and exact at zero, where the series of the exponential map needs a special case. Learning poses along with the scene from the colour
//! gradient follows BARF (Lin et al. 2021), and for Gaussians gsplat's `pose_opt`.
//!
//! Scene and cameras could move together without a change in any render, and they do: on the demo with poses wrong by 1°
//! and 1%, forty cameras ended 0.037 scene units above the true ones together. Where the reconstruction has tracks, they
//! hold the cameras to the sparse points (see [`anchors`]).
//!
//! The configuration states how far a camera can move in a run instead of a learning rate (see `Learned::step_within`).

pub mod anchors;

use burn::tensor::{Device, Gradients, Tensor};
use glam::{DAffine3, DQuat, DVec3};
use splat_op::{Rendered, pose};

use self::anchors::{Anchors, penalty, rotation};
use super::{Effect, EffectContext, EffectKind, Leaf, Learned, RenderInput};
use crate::gaussians::{Gaussians, values_of};
use crate::state::{State, StateError};

options! {
    /// Options of pose refinement.
    #[derive(Copy)]
    pub struct PoseConfig {
        /// Largest rotation of a camera in the whole run, rad: 0.06, about 3.4°.
        pub reach_rad: f64 = 0.06,
        /// Largest movement of a camera in the whole run, scene extents: 0.06.
        pub reach_extents: f64 = 0.06,
        /// Ratio of the last step size to the first: 0.01.
        pub fall: f64 = 0.01,
        /// Weight of the mean angle between the tracks' directions and the pose's, per rad: 3. An error of one pixel then
        /// counts about as much as it does in the photograph.
        pub anchor_weight: f64 = 3.0,
    }
}

/// The pose corrections of all photographs of a run.
pub struct Poses {
    config: PoseConfig,
    extent: f64,
    /// `[2, 3]` each: `ω`, rad, and `τ`, scene extents.
    corrections: Vec<Learned<2>>,
    /// Points (world frame) and directions to them (camera frame), `[M, 3]` each, that hold each camera. `None` without tracks.
    anchors: Vec<Option<[Tensor<2>; 2]>>,
}

impl Poses {
    /// Zero corrections for `views` photographs of a scene of `extent` (see [`scene_extent`](crate::optim::scene_extent)).
    pub fn new(config: PoseConfig, extent: f64, views: usize, device: &Device) -> Self {
        // A camera that must not move has a reach that is too small to be seen, because a reach must not be zero.
        let reach = [config.reach_rad, config.reach_extents].map(|reach| [reach.max(1e-9); 3]);
        let reach = Tensor::<2>::from_floats(reach, device);
        let correction = |_| Learned::reaching(Tensor::zeros([2, 3], device), reach.clone());
        let corrections = (0..views).map(correction).collect();
        let anchors = (0..views).map(|_| None).collect();
        Self { config, extent, corrections, anchors }
    }

    /// Moves the cameras from their `given` poses to the poses that the tracks imply, and holds them there. Both lists are
    /// in the order of the photographs.
    pub fn anchor(&mut self, anchors: &[Anchors], given: &[DAffine3], device: &Device) {
        for (view, (anchors, given)) in anchors.iter().zip(given).enumerate().take(self.corrections.len()) {
            let moved = anchors.resected(given);
            let turn = DQuat::from_mat3(&(moved.matrix3 * given.matrix3.transpose()));
            // tan(θ/2) along the axis. A camera that would have to rotate by half a turn is not refined.
            let half = DVec3::new(turn.x, turn.y, turn.z) / turn.w;
            let shift = (moved.translation - rotation(2.0 * half) * given.translation) / self.extent;
            if half.is_finite() && shift.is_finite() {
                let rows = [(2.0 * half).as_vec3().to_array(), shift.as_vec3().to_array()];
                self.corrections[view].set(Tensor::from_floats(rows, device));
            }
            self.anchors[view] = anchors.on_device(device);
        }
    }

    /// The corrected pose of photograph `view`, `[3, 4]`, tracked. `cam_from_world`, `[3, 4]`, is not tracked.
    pub fn apply(&mut self, cam_from_world: Tensor<2>, view: usize) -> Tensor<2> {
        let given = Tensor::from_inner(cam_from_world);
        pose::corrected(&self.corrections[view].tracked(), &given, self.extent).expect("poses of one device")
    }

    /// The corrected pose of a view, on the host.
    pub fn corrected(&self, cam_from_world: &DAffine3, view: usize) -> DAffine3 {
        let values: Vec<f64> = values_of(self.corrections[view].value()).into_iter().map(f64::from).collect();
        let moved = self.extent * DVec3::from_slice(&values[3..]);
        DAffine3::from_mat3_translation(rotation(DVec3::from_slice(&values[..3])), moved) * *cam_from_world
    }
}

impl Effect for Poses {
    fn name(&self) -> &'static str {
        EffectKind::PoseRefinement.name()
    }

    fn before(&mut self, input: &mut RenderInput, _: &Gaussians, at: EffectContext) {
        input.camera.cam_from_world = self.apply(input.camera.cam_from_world.clone(), at.view);
    }

    fn penalty(&mut self, input: &RenderInput, _: &Rendered<3>, at: EffectContext) -> Option<Tensor<1>> {
        let anchors = self.anchors[at.view].as_ref()?;
        Some(penalty(anchors, &input.camera.cam_from_world) * self.config.anchor_weight)
    }

    fn leaves(&mut self, at: EffectContext) -> Vec<Leaf> {
        vec![self.corrections[at.view].leaf()]
    }

    fn step(&mut self, gradients: &mut Gradients, at: EffectContext) {
        let views = self.corrections.len();
        self.corrections[at.view].step_within(gradients, self.config.fall, views, at);
    }

    fn save(&self, to: &mut State) -> Result<(), StateError> {
        Learned::save_all(&self.corrections, to)
    }

    fn load(&mut self, from: &mut State, _: &Device) -> Result<(), StateError> {
        Learned::load_all(&mut self.corrections, from)
    }
}

#[cfg(test)]
mod tests;

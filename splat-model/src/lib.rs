//! Gaussian scenes as ordinary Burn tensor code: captures, model, losses, optimiser, densification, metrics, formats.
//!
//! [`capture`] reads photographs and points, a [`Trainer`](trainer::Trainer) optimises a scene, and [`ply`] and [`formats`]
//! write its [`gaussians`]. The example below trains on photographs that it renders itself;
//! [`Capture::load`](capture::Capture::load) and [`load_all`](capture::load_all) read the photographs of a folder.
//!
//! ```
//! use burn::tensor::Device;
//! use glam::{DAffine3, DVec3};
//! use splat_model::capture::{Photo, PointCloud};
//! use splat_model::evaluate::evaluate;
//! use splat_model::gaussians::Gaussians;
//! use splat_model::trainer::{TrainConfig, Trainer};
//! use splat_model::{init, ply};
//! use splat_op::{Camera, Extras, Intrinsics, RenderOptions, render_view};
//!
//! let device = Device::flex();
//! let points = PointCloud {
//!     positions: vec![[-0.4, -0.3, 0.0], [0.4, -0.3, 0.1], [-0.3, 0.4, -0.1], [0.3, 0.3, 0.0]],
//!     colours: vec![[230, 60, 40], [50, 200, 70], [60, 80, 230], [240, 200, 40]],
//! };
//!
//! // The photographed scene: round, nearly opaque Gaussians at the points, with a standard deviation of 0.2.
//! let mut rows = init::from_points(&points);
//! rows.log_scales.fill([0.2_f32.ln(); 3]);
//! rows.logit_opacities.fill(2.0);
//! let scene = Gaussians::from_rows(&rows, &device)?.splats();
//! let photograph = |i: u8| -> Result<Photo, splat_op::SplatError> {
//!     let intrinsics = Intrinsics::centred(32, 32, 40.0);
//!     let cam_from_world = DAffine3::from_translation(DVec3::new(0.1 * f64::from(i) - 0.15, 0.0, 2.0));
//!     let camera = Camera::new(intrinsics, &cam_from_world, &device);
//!     let picture = render_view(&scene, &camera, &Extras::default(), &RenderOptions::standard())?.colour;
//!     let rgb = picture.into_data().iter::<f32>().map(|value| (255.0 * value).round() as u8).collect();
//!     Ok(Photo { name: format!("{i}.png"), intrinsics, cam_from_world, rgb, alpha: None, mask: None })
//! };
//! let photos = (0..4).map(photograph).collect::<Result<Vec<Photo>, _>>()?;
//!
//! // Training starts from faint Gaussians at the points, as large as the distances between the points.
//! let config = TrainConfig { steps: 40, sh_degree: 0, ..TrainConfig::default() };
//! let mut trainer = Trainer::new(photos.clone(), &points, config, &device)?;
//! let mut losses = Vec::new();
//! while !trainer.is_done() {
//!     losses.push(trainer.step()?.loss.into_scalar::<f32>());
//! }
//! let epoch = |losses: &[f32]| losses.iter().sum::<f32>() / 4.0;
//! assert!(epoch(&losses[36..]) < epoch(&losses[..4]), "{losses:?}");
//!
//! // Scores are means over photographs. These photographs were trained on, so the scores say little.
//! let splats = trainer.gaussians().untracked().splats();
//! let scores = evaluate(&splats, &photos, &trainer.background(), &trainer.render_options(), |_, _| {})?;
//! assert_eq!(scores.views.len(), 4);
//!
//! let folder = tempfile::tempdir()?;
//! let file = folder.path().join("scene.ply");
//! ply::write(&file, &trainer.rows(), DVec3::ZERO)?;
//! assert_eq!(ply::read(&file)?.0.len(), 4);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! [`Trainer::with_loss`](trainer::Trainer::with_loss) sets a custom loss (`docs/WRITE_A_LOSS.md`);
//! [`TrainConfig`](trainer::TrainConfig) holds all other options of a run. A custom training loop can use the parts of the
//! trainer: [`loss`], [`optim`], [`density`], [`effects`].

#![cfg_attr(docsrs, feature(doc_cfg))]
#![warn(missing_docs)]

#[macro_use]
mod options;

pub mod accuracy;
pub mod capture;
pub mod cleanup;
pub mod density;
pub mod effects;
mod encoding;
pub mod evaluate;
mod file_error;
mod fold;
pub mod formats;
pub mod gaussians;
pub mod init;
mod json;
pub mod loss;
pub mod mesh;
pub mod metrics;
pub mod optim;
pub mod ply;
pub mod quantile;
pub mod replace;
pub mod sniff;
mod solve;
pub mod state;
pub mod trainer;

pub use file_error::FileError;

/// Compiles the code of the pages in `docs/` together with the other examples.
#[cfg(doctest)]
#[doc = include_str!("../../docs/WRITE_A_LOSS.md")]
#[doc = include_str!("../../docs/WRITE_A_STRATEGY.md")]
#[doc = include_str!("../../docs/WRITE_AN_EFFECT.md")]
mod pages {}

//! The kernel of `blend`, forwards: a cube per tile, a unit per pixel.
//!
//! A tile's places are passed in buckets of 32. Within a bucket a pixel's sums and transmittance are relative to those
//! before it; at its end they are added in. What the backward pass needs of a bucket is then a few numbers per pixel that
//! do not depend on any other bucket, and it can work on all buckets at once.

use cubecl::prelude::*;

use crate::project::COLUMNS;
use crate::tile::forward::Frame;
use crate::tile::{TILE, TILE_PIXELS};

/// Places of a bucket.
pub(super) const BUCKET: usize = 32;

/// Channels up to which colours go through shared memory and sums through registers, and the trace keeps the sums of each
/// bucket; above, all three would not fit.
pub(super) const FEW: usize = 4;

/// Numbers of an ellipse in shared memory.
pub(super) const FOOTPRINT: usize = 7;

/// Thresholds of the render besides the frame's.
#[derive(CubeType, CubeLaunch, Clone, Copy)]
#[expand(derive(Clone, Copy))]
pub(crate) struct Limits {
    pub alpha_max: f32,
    /// Below zero for none.
    pub transmittance_min: f32,
}

/// What a kernel of this stage is compiled for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) struct Shape {
    /// Features.
    pub features: usize,
    /// Whether depth is accumulated, as a further channel.
    pub depth: bool,
}

impl Shape {
    pub const fn channels(&self) -> usize {
        self.features + self.depth as usize
    }

    pub const fn few(&self) -> bool {
        self.channels() <= FEW
    }

    /// Numbers per pixel and bucket that the forward pass keeps: the transmittance before the bucket (negative where the
    /// pixel was finished), the share that the bucket lets through, and its sums if there are few channels.
    pub const fn kept(&self) -> usize {
        2 + if self.few() { self.channels() } else { 0 }
    }
}

/// An ellipse as the pixels' loop reads it.
#[derive(CubeType, Clone, Copy)]
#[expand(derive(Clone, Copy))]
pub(super) struct Footprint {
    pub x: f32,
    pub y: f32,
    pub inverse_u: f32,
    pub inverse_v: f32,
    pub shear: f32,
    pub opacity: f32,
    /// Exponents below this give an alpha below `alpha_min` for certain.
    pub exponent_min: f32,
}

#[cube]
impl Footprint {
    /// Of a row of the packed ellipses.
    pub fn of(projected: &[f32], gaussian: usize, alpha_min: f32) -> Footprint {
        let at = gaussian * comptime!(COLUMNS);
        let opacity = projected[at + 6];
        let mut exponent_min = f32::min_value();
        if alpha_min > 0.0 {
            // A relative margin for the logarithm, an absolute one for the exponential.
            exponent_min = (alpha_min / opacity).ln() * 1.00001 - 5e-5;
        }
        Footprint {
            x: projected[at],
            y: projected[at + 1],
            inverse_u: 1.0 / projected[at + 2],
            inverse_v: 1.0 / projected[at + 4],
            shear: projected[at + 3],
            opacity,
            exponent_min,
        }
    }

    pub fn store(&self, to: &mut Shared<[f32]>, index: usize) {
        let at = index * comptime!(FOOTPRINT);
        to[at] = self.x;
        to[at + 1] = self.y;
        to[at + 2] = self.inverse_u;
        to[at + 3] = self.inverse_v;
        to[at + 4] = self.shear;
        to[at + 5] = self.opacity;
        to[at + 6] = self.exponent_min;
    }

    pub fn load(from: &Shared<[f32]>, index: usize) -> Footprint {
        let at = index * comptime!(FOOTPRINT);
        Footprint {
            x: from[at],
            y: from[at + 1],
            inverse_u: from[at + 2],
            inverse_v: from[at + 3],
            shear: from[at + 4],
            opacity: from[at + 5],
            exponent_min: from[at + 6],
        }
    }

    /// `u, v` of a pixel with its centre at `x, y` px.
    pub fn whiten(&self, x: f32, y: f32) -> (f32, f32) {
        let dx = x - self.x;
        let dy = y - self.y;
        (dx * self.inverse_u, (dy - self.shear * dx) * self.inverse_v)
    }

    /// The alpha at a pixel; zero where it does not show.
    pub fn alpha(&self, x: f32, y: f32, alpha_min: f32, alpha_max: f32) -> f32 {
        let (u, v) = self.whiten(x, y);
        let exponent = -(0.5 * (u * u + v * v));
        let mut alpha = 0.0f32;
        if exponent >= self.exponent_min {
            let value = min(self.opacity * exponent.exp(), alpha_max);
            if value >= alpha_min {
                alpha = value;
            }
        }
        alpha
    }
}

/// The first slot of a tile's buckets: a slot per started 32 places, so that no two tiles share one and no list of slots
/// is needed.
#[cube]
pub(super) fn first_slot(first_place: u32, tile: u32) -> u32 {
    first_place / comptime!(BUCKET as u32) + tile
}

/// Channel `channel` of a Gaussian, the depth after the features.
#[cube]
pub(super) fn colour(
    projected: &[f32],
    features: &[f32],
    gaussian: usize,
    channel: usize,
    #[comptime] shape: Shape,
) -> f32 {
    let mut value = 0.0f32;
    if comptime!(shape.depth) {
        if channel == comptime!(shape.features) {
            value = projected[gaussian * comptime!(COLUMNS) + 5];
        } else {
            value = features[gaussian * comptime!(shape.features) + channel];
        }
    } else {
        value = features[gaussian * comptime!(shape.features) + channel];
    }
    value
}

/// Planes `[C + 1 (+ 1), H, W]`; and, if a trace is kept, the kept numbers `[slot][number][pixel]`, the transmittance
/// behind all layers `[tile][pixel]`, and how many buckets of each tile were passed.
#[cube(launch_unchecked)]
pub(super) fn blend_forward_kernel(
    projected: &[f32],
    features: &[f32],
    background: &[f32],
    tile_start: &[u32],
    hit_of_place: &[u32],
    gaussian_of_hit: &[u32],
    planes: &mut [f32],
    kept: &mut [f32],
    behind: &mut [f32],
    passed: &mut [u32],
    frame: Frame,
    limits: Limits,
    #[comptime] shape: Shape,
    #[comptime] keep: bool,
    #[comptime] batch: usize,
) {
    let channels = comptime!(shape.channels());
    let few = comptime!(shape.few());
    let tile = CUBE_POS as u32;
    let unit = UNIT_POS;
    let mut footprints = Shared::<[f32]>::new_slice(comptime!(batch * FOOTPRINT));
    let mut colours = Shared::<[f32]>::new_slice(comptime!(if few { batch * channels } else { 1 }));
    let mut gaussians = Shared::<[u32]>::new_slice(batch);
    let mut anybody = Shared::<[u32]>::new_slice(1usize);

    if tile < frame.tiles_x * frame.tiles_y {
        let column = tile % frame.tiles_x * comptime!(TILE as u32) + unit % comptime!(TILE as u32);
        let row = tile / frame.tiles_x * comptime!(TILE as u32) + unit / comptime!(TILE as u32);
        let x = f32::cast_from(column) + 0.5;
        let y = f32::cast_from(row) + 0.5;
        let inside = column < frame.width && row < frame.height;
        let first = tile_start[tile as usize];
        let places = tile_start[tile as usize + 1] - first;
        let slot = first_slot(first, tile);

        let mut open = inside;
        let mut transmittance = 1.0f32;
        let mut sums = Array::<f32>::new(channels);
        let mut own = Array::<f32>::new(channels);
        #[unroll(few)]
        for channel in 0..channels {
            sums[channel] = 0.0f32;
        }

        let mut place = 0u32;
        let mut running = true;
        while running && place < places {
            // The next batch, unless nobody wants it.
            if unit == 0 {
                anybody[0] = 0u32;
            }
            sync_cube();
            if open {
                anybody[0] = 1u32;
            }
            if unit < comptime!(batch as u32) && place + unit < places {
                let gaussian = gaussian_of_hit[hit_of_place[(first + place + unit) as usize] as usize];
                Footprint::of(projected, gaussian as usize, frame.alpha_min).store(&mut footprints, unit as usize);
                gaussians[unit as usize] = gaussian;
                if comptime!(few) {
                    #[unroll]
                    for channel in 0..channels {
                        colours[unit as usize * channels + channel] =
                            colour(projected, features, gaussian as usize, channel, shape);
                    }
                }
            }
            sync_cube();
            running = anybody[0] != 0;
            if running {
                let count = min(places - place, comptime!(batch as u32));
                let mut bucket = 0u32;
                while bucket < count {
                    let was_open = open;
                    let mut through = 1.0f32;
                    #[unroll(few)]
                    for channel in 0..channels {
                        own[channel] = 0.0f32;
                    }
                    let end = min(bucket + comptime!(BUCKET as u32), count);
                    let mut i = bucket;
                    while i < end && open {
                        let footprint = Footprint::load(&footprints, i as usize);
                        let alpha = footprint.alpha(x, y, frame.alpha_min, limits.alpha_max);
                        if alpha > 0.0 {
                            let next = through * (1.0 - alpha);
                            if transmittance * next <= limits.transmittance_min {
                                open = false;
                            } else {
                                let weight = alpha * through;
                                if comptime!(few) {
                                    #[unroll]
                                    for channel in 0..channels {
                                        own[channel] += weight * colours[i as usize * channels + channel];
                                    }
                                } else {
                                    let gaussian = gaussians[i as usize] as usize;
                                    for channel in 0..channels {
                                        own[channel] += weight * colour(projected, features, gaussian, channel, shape);
                                    }
                                }
                                through = next;
                            }
                        }
                        i += 1;
                    }
                    if comptime!(keep) {
                        let numbers = comptime!(shape.kept());
                        let at = (slot + (place + bucket) / comptime!(BUCKET as u32)) as usize
                            * comptime!(numbers * TILE_PIXELS)
                            + unit as usize;
                        kept[at] = select(was_open, transmittance, -transmittance);
                        kept[at + comptime!(TILE_PIXELS)] = through;
                        if comptime!(few) {
                            #[unroll]
                            for channel in 0..channels {
                                kept[at + (channel + 2) * comptime!(TILE_PIXELS)] = own[channel];
                            }
                        }
                    }
                    #[unroll(few)]
                    for channel in 0..channels {
                        sums[channel] += transmittance * own[channel];
                    }
                    transmittance *= through;
                    bucket += comptime!(BUCKET as u32);
                }
                place += count;
            }
            sync_cube();
        }

        if comptime!(keep) {
            behind[tile as usize * comptime!(TILE_PIXELS) + unit as usize] = transmittance;
            if unit == 0 {
                passed[tile as usize] = (place + comptime!(BUCKET as u32 - 1)) / comptime!(BUCKET as u32);
            }
        }
        if inside {
            let plane = (frame.width * frame.height) as usize;
            let pixel = (row * frame.width + column) as usize;
            #[unroll(few)]
            for channel in 0..comptime!(shape.features) {
                planes[channel * plane + pixel] = sums[channel] + transmittance * background[channel];
            }
            planes[comptime!(shape.features) * plane + pixel] = 1.0 - transmittance;
            if comptime!(shape.depth) {
                planes[comptime!(shape.features + 1) * plane + pixel] = sums[comptime!(shape.features)];
            }
        }
    }
}

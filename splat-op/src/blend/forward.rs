//! The kernel of `blend`, forwards: a cube per tile, a unit per strip of pixels, whose numbers stay in registers. How many
//! pixels a strip has is chosen by the device, see [`Strip`].
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

/// Places that a cube loads at once.
const BATCH: usize = 64;

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

/// The pixels of a unit: some columns of a tile, and of those a block of rows. Pixels in one column share `u`, and all
/// share what is read of a Gaussian. A graphics card has units to fill, and hides the reading behind them. A software
/// driver runs eight units at a time as one vector, and reads for each of them one after the other, ten times slower than
/// it computes: there a strip is as long as eight units leave it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) struct Strip {
    /// Columns of a unit.
    pub across: usize,
    /// Blocks that the rows of a tile are cut into.
    pub blocks: usize,
}

impl Strip {
    pub const fn units(&self) -> usize {
        TILE / self.across * self.blocks
    }

    pub const fn rows(&self) -> usize {
        TILE / self.blocks
    }

    pub const fn pixels(&self) -> usize {
        self.across * self.rows()
    }
}

/// Column and row in the tile of a unit's first pixel.
#[cube]
pub(super) fn strip_origin(#[comptime] strip: Strip) -> (u32, u32) {
    let along = comptime!((TILE / strip.across) as u32);
    (UNIT_POS % along * comptime!(strip.across as u32), UNIT_POS / along * comptime!(strip.rows() as u32))
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

    /// One that shows in no pixel.
    pub fn nowhere() -> Footprint {
        Footprint { x: 0.0, y: 0.0, inverse_u: 0.0, inverse_v: 0.0, shear: 0.0, opacity: 0.0, exponent_min: 1.0 }
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

    /// `u` in the column at `x` px, and what `v` is computed from along it: `v = (y − this) inverse_v`.
    pub fn along_column(&self, x: f32) -> (f32, f32) {
        let dx = x - self.x;
        (dx * self.inverse_u, self.y + self.shear * dx)
    }

    /// `u, v` of a pixel with its centre at `x, y` px.
    pub fn whiten(&self, x: f32, y: f32) -> (f32, f32) {
        let dx = x - self.x;
        let dy = y - self.y;
        (dx * self.inverse_u, (dy - self.shear * dx) * self.inverse_v)
    }

    /// The alpha at whitened coordinates; zero where it does not show.
    pub fn alpha(&self, u: f32, v: f32, alpha_min: f32, alpha_max: f32) -> f32 {
        let exponent = -(0.5 * (u * u + v * v));
        let value = min(self.opacity * exponent.exp(), alpha_max);
        select(exponent >= self.exponent_min && value >= alpha_min, value, 0.0)
    }
}

/// Passes a layer at a pixel: its alpha, zero if it does not contribute, and what is let through behind it relative to the
/// bucket; negative where the pixel is finished.
#[cube]
pub(super) fn layer(alpha: f32, through: f32, before: f32, transmittance_min: f32) -> (f32, f32) {
    let next = through * (1.0 - alpha);
    let shows = alpha > 0.0 && through >= 0.0;
    let finishes = shows && before * next <= transmittance_min;
    let contributes = shows && !finishes;
    (select(contributes, alpha, 0.0), select(contributes, next, select(finishes, -through, through)))
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
    let is_depth = comptime!(shape.depth) && channel == comptime!(shape.features);
    let mut value = 0.0f32;
    if is_depth {
        value = projected[gaussian * comptime!(COLUMNS) + 5];
    }
    if !is_depth {
        value = features[gaussian * comptime!(shape.features) + channel];
    }
    value
}

/// Planes `[C + 1 (+ 1), H, W]`; and, if a trace is kept, the kept numbers `[slot][number][pixel]`, the transmittance
/// behind all layers `[tile][pixel]`, and how many buckets of each tile were passed.
///
/// A finished pixel has its transmittance negated, and one outside the picture is finished from the start.
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
    #[comptime] strip: Strip,
) {
    let channels = comptime!(shape.channels());
    let few = comptime!(shape.few());
    let (rows, pixels) = comptime!((strip.rows(), strip.pixels()));
    let tile = CUBE_POS as u32;
    let mut footprints = Shared::<[f32]>::new_slice(comptime!(BATCH * FOOTPRINT));
    let mut colours = Shared::<[f32]>::new_slice(comptime!(if few { BATCH * channels } else { 1 }));
    let mut gaussians = Shared::<[u32]>::new_slice(comptime!(BATCH));
    let mut anybody = Shared::<[u32]>::new_slice(1usize);

    if tile < frame.tiles_x * frame.tiles_y {
        let (column, row) = strip_origin(strip);
        let first_column = tile % frame.tiles_x * comptime!(TILE as u32) + column;
        let first_row = tile / frame.tiles_x * comptime!(TILE as u32) + row;
        let in_tile = (row * comptime!(TILE as u32) + column) as usize;
        let x = f32::cast_from(first_column) + 0.5;
        let y = f32::cast_from(first_row) + 0.5;
        let first = tile_start[tile as usize];
        let places = tile_start[tile as usize + 1] - first;
        let slot = first_slot(first, tile);

        let mut transmittance = Array::<f32>::new(pixels);
        let mut through = Array::<f32>::new(pixels);
        let mut sums = Array::<f32>::new(comptime!(pixels * channels));
        let mut own = Array::<f32>::new(comptime!(pixels * channels));
        #[unroll]
        for p in 0..pixels {
            let inside = first_column + comptime!((p / rows) as u32) < frame.width
                && first_row + comptime!((p % rows) as u32) < frame.height;
            transmittance[p] = select(inside, 1.0f32, -1.0f32);
            #[unroll(few)]
            for channel in 0..channels {
                sums[comptime!(p * channels) + channel] = 0.0f32;
            }
        }

        let mut place = 0u32;
        let mut running = true;
        while running && place < places {
            // The next batch, unless nobody wants it.
            let mut open = false;
            #[unroll]
            for p in 0..pixels {
                open = open || transmittance[p] >= 0.0;
            }
            if UNIT_POS == 0 {
                anybody[0] = 0u32;
            }
            sync_cube();
            if open {
                anybody[0] = 1u32;
            }
            let count = min(places - place, comptime!(BATCH as u32));
            let mut i = UNIT_POS;
            while i < count {
                let gaussian = gaussian_of_hit[hit_of_place[(first + place + i) as usize] as usize];
                Footprint::of(projected, gaussian as usize, frame.alpha_min).store(&mut footprints, i as usize);
                gaussians[i as usize] = gaussian;
                if comptime!(few) {
                    #[unroll]
                    for channel in 0..channels {
                        colours[i as usize * channels + channel] =
                            colour(projected, features, gaussian as usize, channel, shape);
                    }
                }
                i += comptime!(strip.units() as u32);
            }
            sync_cube();
            running = anybody[0] != 0;
            if running {
                let mut bucket = 0u32;
                while bucket < count {
                    #[unroll]
                    for p in 0..pixels {
                        through[p] = select(transmittance[p] >= 0.0, 1.0f32, -1.0f32);
                        #[unroll(few)]
                        for channel in 0..channels {
                            own[comptime!(p * channels) + channel] = 0.0f32;
                        }
                    }
                    let end = select(open, min(bucket + comptime!(BUCKET as u32), count), bucket);
                    for i in bucket..end {
                        let footprint = Footprint::load(&footprints, i as usize);
                        let mut colour_here = Array::<f32>::new(comptime!(if few { channels } else { 1 }));
                        if comptime!(few) {
                            #[unroll]
                            for channel in 0..channels {
                                colour_here[channel] = colours[i as usize * channels + channel];
                            }
                        }
                        #[unroll]
                        for p in 0..pixels {
                            let (u, from) = footprint.along_column(x + comptime!((p / rows) as f32));
                            let v = (y + comptime!((p % rows) as f32) - from) * footprint.inverse_v;
                            let alpha = footprint.alpha(u, v, frame.alpha_min, limits.alpha_max);
                            let before = through[p];
                            let (alpha, next) = layer(alpha, before, transmittance[p], limits.transmittance_min);
                            through[p] = next;
                            if comptime!(few) {
                                let weight = alpha * before;
                                #[unroll]
                                for channel in 0..channels {
                                    own[comptime!(p * channels) + channel] += weight * colour_here[channel];
                                }
                            } else if alpha > 0.0 {
                                let weight = alpha * before;
                                let gaussian = gaussians[i as usize] as usize;
                                for channel in 0..channels {
                                    own[comptime!(p * channels) + channel] +=
                                        weight * colour(projected, features, gaussian, channel, shape);
                                }
                            }
                        }
                    }
                    let at = (slot + (place + bucket) / comptime!(BUCKET as u32)) as usize
                        * comptime!(shape.kept() * TILE_PIXELS)
                        + in_tile;
                    #[unroll]
                    for p in 0..pixels {
                        let before = transmittance[p];
                        let share = through[p].abs();
                        if comptime!(keep) {
                            let at = at + comptime!(p % rows * TILE + p / rows);
                            kept[at] = before;
                            kept[at + comptime!(TILE_PIXELS)] = share;
                            if comptime!(few) {
                                #[unroll]
                                for channel in 0..channels {
                                    kept[at + (channel + 2) * comptime!(TILE_PIXELS)] =
                                        own[comptime!(p * channels) + channel];
                                }
                            }
                        }
                        #[unroll(few)]
                        for channel in 0..channels {
                            sums[comptime!(p * channels) + channel] +=
                                before.abs() * own[comptime!(p * channels) + channel];
                        }
                        // A pixel that finished in this bucket becomes negative here; one that had finished stays.
                        transmittance[p] = select(before >= 0.0, before * through[p], before);
                    }
                    bucket += comptime!(BUCKET as u32);
                }
                place += count;
            }
            sync_cube();
        }

        if comptime!(keep) {
            #[unroll]
            for p in 0..pixels {
                behind[tile as usize * comptime!(TILE_PIXELS) + in_tile + comptime!(p % rows * TILE + p / rows)] =
                    transmittance[p].abs();
            }
            if UNIT_POS == 0 {
                passed[tile as usize] = (place + comptime!(BUCKET as u32 - 1)) / comptime!(BUCKET as u32);
            }
        }
        let plane = (frame.width * frame.height) as usize;
        #[unroll]
        for p in 0..pixels {
            let column = first_column + comptime!((p / rows) as u32);
            let row = first_row + comptime!((p % rows) as u32);
            if column < frame.width && row < frame.height {
                let pixel = (row * frame.width + column) as usize;
                let left = transmittance[p].abs();
                #[unroll(few)]
                for channel in 0..comptime!(shape.features) {
                    planes[channel * plane + pixel] =
                        sums[comptime!(p * channels) + channel] + left * background[channel];
                }
                planes[comptime!(shape.features) * plane + pixel] = 1.0 - left;
                if comptime!(shape.depth) {
                    planes[comptime!(shape.features + 1) * plane + pixel] =
                        sums[comptime!(p * channels + shape.features)];
                }
            }
        }
    }
}

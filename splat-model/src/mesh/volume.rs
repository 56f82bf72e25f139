//! The signed distance field, in blocks of voxels.

use std::collections::HashMap;

use glam::{DVec3, IVec3, Vec3};
use rayon::prelude::*;
use splat_op::Intrinsics;

use super::{DepthPicture, Mesh, MeshError, MeshOptions, surface};
use crate::quantile::quantile;

/// Voxels along a side of a block. A voxel is a point: those of the block `b` along an axis are at `(8 b + i) voxel`.
pub(super) const SIDE: usize = 8;
const VOXELS: usize = SIDE * SIDE * SIDE;

/// Depth that makes blocks ends at this many times the median, where a pixel is as many times as wide as there.
const FAR: f64 = 2.0;

/// Of so many pixels of the surveyed views one counts.
const SAMPLED: usize = 7;

/// Blocks of all views, at most, for each of the surveyed ones.
const UNSURVEYED: f64 = 2.5;

/// Side of the squares of which the deepest pixel is kept, px.
const TILE: usize = 16;

/// Smallest voxel, of the depth that makes blocks: coordinates of voxels then fit an i32, also far from the origin.
const SMALLEST: f64 = 1e-6;

/// A point of the field.
#[derive(Clone, Copy, Default)]
pub(super) struct Voxel {
    /// Mean distance in front of the surface, truncations.
    pub distance: f32,
    /// Sum of weights; 0 where no view has looked.
    pub weight: f32,
    /// Sum of weighted colours near the surface, and of their weights.
    pub colour: [f32; 4],
}

struct Block {
    at: [i32; 3],
    voxels: Box<[Voxel; VOXELS]>,
}

/// A truncated signed distance field that grows with the pictures added to it.
pub struct Volume {
    /// Side of a voxel, scene units.
    pub(super) voxel: f64,
    /// Depth beyond which pixels make no blocks, scene units.
    far: f64,
    pub(super) options: MeshOptions,
    blocks: Vec<Block>,
    /// Indices of the blocks by their coordinates.
    pub(super) places: HashMap<[i32; 3], usize>,
}

impl Volume {
    /// An empty volume for pictures like these, which are not added: their depths tell the size of a voxel where the options do not, and how
    /// far surfaces reach.
    ///
    /// # Errors
    /// If an option is out of range, or no picture shows a surface.
    pub fn for_pictures(pictures: &[DepthPicture], options: &MeshOptions) -> Result<Self, MeshError> {
        let check = |field, value: f64, is_valid: bool, expected| match is_valid && value.is_finite() {
            true => Ok(()),
            false => Err(MeshError::Option { field, found: value.to_string(), expected }),
        };
        check("truncation", options.truncation, options.truncation >= 2.0, "at least 2 voxels")?;
        let median = |of: fn(f64, f64) -> f64| {
            let seen =
                pictures.iter().flat_map(|picture| picture.depth.iter().map(|depth| (depth, picture.intrinsics.fx)));
            let seen = seen.step_by(SAMPLED).filter(|(depth, _)| **depth > 0.0);
            let mut values: Vec<f64> = seen.map(|(depth, focal)| of(f64::from(*depth), focal)).collect();
            quantile(&mut values, 0.5).ok_or(MeshError::Empty { components: 0, min: options.min_component })
        };
        let (far, width) = (FAR * median(|depth, _| depth)?, median(|depth, focal| depth / focal)?);
        let (voxel, blocks, places) = (options.voxel.unwrap_or(width), Vec::new(), HashMap::new());
        check("voxel", voxel, voxel >= SMALLEST * far, "a millionth of the scene's depth or more, scene units")?;
        let mut volume = Self { voxel, far, options: *options, blocks, places };
        if options.voxel.is_none() {
            let mut wanted: Vec<[i32; 3]> = pictures.iter().flat_map(|picture| volume.wanted(picture)).collect();
            wanted.par_sort_unstable();
            wanted.dedup();
            // The number of blocks falls with the square of their side.
            let excess = UNSURVEYED * wanted.len() as f64 / volume.room() as f64;
            volume.voxel = width * excess.max(1.0).sqrt();
        }
        Ok(volume)
    }

    /// An empty volume whose voxels are half as large again.
    pub(super) fn coarser(&self) -> Self {
        let (voxel, blocks, places) = (1.5 * self.voxel, Vec::new(), HashMap::new());
        Self { voxel, far: self.far, options: self.options, blocks, places }
    }

    /// Scene units.
    fn truncation(&self) -> f64 {
        self.options.truncation * self.voxel
    }

    /// Number of blocks that fit the memory.
    fn room(&self) -> usize {
        self.options.memory / size_of::<[Voxel; VOXELS]>()
    }

    /// Adds what a picture shows.
    ///
    /// # Errors
    /// If the voxels need more memory than the options allow; the volume is then as it was.
    pub fn add(&mut self, picture: &DepthPicture) -> Result<(), MeshError> {
        let mut new = self.wanted(picture);
        new.retain(|at| !self.places.contains_key(at));
        if self.blocks.len() + new.len() > self.room() {
            return Err(MeshError::Memory { voxel: self.voxel, mib: self.options.memory >> 20 });
        }
        for at in new {
            self.places.insert(at, self.blocks.len());
            self.blocks.push(Block { at, voxels: Box::new([Voxel::default(); VOXELS]) });
        }
        let view = View::new(picture, self.voxel, self.truncation());
        self.blocks.par_iter_mut().for_each(|block| view.add_to(block));
        Ok(())
    }

    /// Extracts the surface.
    ///
    /// # Errors
    /// If there is none, or none large enough.
    pub fn mesh(&self) -> Result<Mesh, MeshError> {
        surface::of(self)
    }

    /// The blocks, sorted, that lie within the truncation of a picture's surface.
    fn wanted(&self, picture: &DepthPicture) -> Vec<[i32; 3]> {
        let Intrinsics { width, fx, fy, cx, cy, .. } = picture.intrinsics;
        let world_from_cam = picture.cam_from_world.inverse();
        let side = SIDE as f64 * self.voxel;
        // Neither two rays nor two places on one are further apart than half a block.
        let stride = (0.5 * side * fx.min(fy) / self.far).clamp(1.0, SIDE as f64) as usize;
        let steps = (2.0 * self.truncation() / side).ceil() as i32;
        let of_row = |row: usize| {
            let mut found = Vec::new();
            for column in (0..width).step_by(stride) {
                let depth = f64::from(picture.depth[row * width + column]);
                if !(depth > 0.0 && depth <= self.far) {
                    continue;
                }
                let ray = DVec3::new((column as f64 + 0.5 - cx) / fx, (row as f64 + 0.5 - cy) / fy, 1.0);
                found.extend((-steps..=steps).map(|step| {
                    let depth = depth + f64::from(step) / f64::from(steps) * self.truncation();
                    (world_from_cam.transform_point3(depth * ray) / side).floor().as_ivec3().to_array()
                }));
            }
            found.sort_unstable();
            found.dedup();
            found
        };
        let rows: Vec<usize> = (0..picture.intrinsics.height).step_by(stride).collect();
        let mut found = rows.into_par_iter().map(of_row).collect::<Vec<_>>().concat();
        found.sort_unstable();
        found.dedup();
        found
    }

    /// The voxels of the block at a position.
    pub(super) fn block(&self, at: [i32; 3]) -> Option<&[Voxel; VOXELS]> {
        self.places.get(&at).map(|&place| &*self.blocks[place].voxels)
    }
}

/// A picture as the voxels need it.
struct View<'a> {
    picture: &'a DepthPicture,
    voxel: f64,
    truncation: f32,
    /// Focal lengths and principal point, px; the latter from the centre of the first pixel.
    focal: [f32; 2],
    principal: [f32; 2],
    /// Of each square of the picture the largest depth.
    deepest: Vec<f32>,
    tiles_x: usize,
}

impl<'a> View<'a> {
    fn new(picture: &'a DepthPicture, voxel: f64, truncation: f64) -> Self {
        let Intrinsics { width, height, fx, fy, cx, cy, .. } = picture.intrinsics;
        let tiles_x = width.div_ceil(TILE);
        let mut deepest = vec![0.0_f32; tiles_x * height.div_ceil(TILE)];
        for (i, depth) in picture.depth.iter().enumerate() {
            let tile = &mut deepest[i / width / TILE * tiles_x + i % width / TILE];
            *tile = tile.max(*depth);
        }
        let (focal, principal) = ([fx as f32, fy as f32], [(cx - 0.5) as f32, (cy - 0.5) as f32]);
        Self { picture, voxel, truncation: truncation as f32, focal, principal, deepest, tiles_x }
    }

    /// Whether the picture may show something of a ball, camera frame, or of the space before it.
    fn may_see(&self, centre: Vec3, radius: f32) -> bool {
        let (near, far) = (centre.z - radius, centre.z + radius);
        if !(near > 0.0) {
            return far > 0.0;
        }
        let size = [self.tiles_x, self.deepest.len() / self.tiles_x];
        let tiles = [0, 1].map(|axis| {
            let [low, high] = [centre[axis] - radius, centre[axis] + radius];
            let [low, high] = [low / if low < 0.0 { near } else { far }, high / if high > 0.0 { near } else { far }];
            let tile = |slope: f32| (self.focal[axis] * slope + self.principal[axis]) / TILE as f32;
            // A pixel more on either side; casts clamp.
            (tile(low) - 0.1).max(0.0) as usize..((tile(high) + 1.2).max(0.0) as usize).min(size[axis])
        });
        let [columns, rows] = tiles;
        let deepest =
            |row: usize| self.deepest[row * self.tiles_x..][columns.clone()].iter().copied().fold(0.0, f32::max);
        !columns.is_empty() && rows.into_iter().any(|row| near < deepest(row) + self.truncation)
    }

    fn add_to(&self, block: &mut Block) {
        let pose = &self.picture.cam_from_world;
        let corner = pose.transform_point3((SIDE as i32 * IVec3::from(block.at)).as_dvec3() * self.voxel).as_vec3();
        let [x, y, z] = [0, 1, 2].map(|axis| (pose.matrix3.col(axis) * self.voxel).as_vec3());
        let half = 0.5 * (SIDE - 1) as f32;
        if !self.may_see(corner + half * (x + y + z), half * 3.0_f32.sqrt() * self.voxel as f32) {
            return;
        }
        for (i, row) in block.voxels.as_chunks_mut::<SIDE>().0.iter_mut().enumerate() {
            let start = corner + (i % SIDE) as f32 * y + (i / SIDE) as f32 * z;
            for (i, voxel) in row.iter_mut().enumerate() {
                self.add(start + i as f32 * x, voxel);
            }
        }
    }

    /// Adds what the picture shows at a place, camera frame.
    #[inline]
    fn add(&self, at: Vec3, voxel: &mut Voxel) {
        let Intrinsics { width, height, .. } = self.picture.intrinsics;
        let [u, v] = [0, 1].map(|axis| self.focal[axis] * at[axis] / at.z + self.principal[axis]);
        let within = at.z > 0.0 && u >= 0.0 && v >= 0.0 && u < (width - 1) as f32 && v < (height - 1) as f32;
        if !within {
            return;
        }
        let (column, row) = (u as usize, v as usize);
        let (right, down) = (u - column as f32, v - row as f32);
        let pixel = row * width + column;
        let depth = &self.picture.depth;
        let [a, b, c, d] = [depth[pixel], depth[pixel + 1], depth[pixel + width], depth[pixel + width + 1]];
        let (nearest, farthest) = (a.min(b).min(c.min(d)), a.max(b).max(c.max(d)));
        if !(nearest > 0.0) {
            return;
        }
        // Between two surfaces neither is known to be there.
        let jumps = farthest - nearest > self.truncation;
        let (upper, lower) = (a + right * (b - a), c + right * (d - c));
        let surface = if jumps { nearest } else { upper + down * (lower - upper) };
        let distance = (surface - at.z) / self.truncation;
        if !(distance > if jumps { 1.0 } else { -1.0 }) {
            return;
        }
        let weight = 1.0 / (at.z * at.z);
        voxel.weight += weight;
        voxel.distance += weight / voxel.weight * (distance.min(1.0) - voxel.distance);
        if distance < 1.0 {
            let [r, g, b] = self.picture.colour[(v + 0.5) as usize * width + (u + 0.5) as usize];
            [r, g, b, 1.0].iter().zip(&mut voxel.colour).for_each(|(value, sum)| *sum += weight * value);
        }
    }
}

//! The way of a tile's pixels through its list, front to back: the forward pass, and the backward pass with the per-pixel sort.
//!
//! The units of a tile load [`NEAR`] Gaussians at a time, each once, and evaluate them from shared memory. In the order of the list a
//! layer is passed as soon as it is found. With the per-pixel sort, a pass through the list finds the [`CHUNK`] layers of each pixel that
//! come next behind its last one, and sorts them in registers. This takes no memory and is exact for a list of any length.

use cubecl::prelude::*;

use super::layer::{RayFrame, RayGaussian, RayInputs, RayPixel, shared_len};
use crate::intersect::TILE_PIXELS;
use crate::project::COLUMNS;

/// Number of Gaussians in shared memory: 9.7 KiB with the columns of a lens.
const NEAR: usize = 128;

/// Number of layers that a unit finds in one pass through the tile's list and sorts in its registers.
const CHUNK: usize = 16;

/// What a unit gathers of its pixel.
#[derive(CubeType)]
pub(super) struct Front {
    /// Whether layers may follow: the pixel is in the picture and not finished.
    open: Array<u32>,
    /// The transmittance behind the layers so far, and the sum of their depths.
    left: Array<f32>,
    /// `[features]`: `Σ w c`.
    pub sums: Array<f32>,
    /// The place of the last layer plus one, zero for none, and the number of layers.
    way: Array<u32>,
}

#[cube]
impl Front {
    pub fn transmittance(&self) -> f32 {
        self.left[0usize]
    }

    pub fn depth(&self) -> f32 {
        self.left[1usize]
    }

    /// The place of the last layer plus one; zero for none.
    pub fn link(&self) -> u32 {
        self.way[0usize]
    }

    pub fn layers(&self) -> u32 {
        self.way[1usize]
    }

    fn is_open(&self) -> bool {
        self.open[0usize] != 0
    }

    /// Passes a layer. With `keep` it is stored in the table, whose entry of the pixel for the first place is at `own`; otherwise it is
    /// added to the sums.
    fn pass(
        &mut self,
        inputs: &RayInputs,
        layer: FoundLayer,
        table: &mut [u32],
        own: usize,
        view: &RayFrame,
        #[comptime] keep: bool,
    ) {
        let before = self.left[0usize];
        let behind = fma(-layer.alpha, before, before);
        let open = behind > view.frame.transmittance_min;
        self.open[0usize] = select(open, 1u32, 0u32);
        if open {
            if comptime!(keep) {
                let at = own + layer.place as usize * comptime!(2 * TILE_PIXELS);
                table[at] = u32::reinterpret(before);
                table[at + 1] = self.way[0usize];
                self.way[0usize] = layer.place + 1;
                self.way[1usize] += 1u32;
            } else {
                let weight = layer.alpha * before;
                let gaussian = layer.gaussian as usize;
                let channels = comptime!(view.shape.features);
                for channel in 0..channels {
                    self.sums[channel] += weight * inputs.features[gaussian * channels + channel];
                }
                if comptime!(view.shape.depth) {
                    let mut depth = layer.key;
                    if comptime!(!view.exact) {
                        depth = inputs.projected[gaussian * comptime!(COLUMNS) + 5];
                    }
                    self.left[1usize] += weight * depth;
                }
            }
            self.left[0usize] = behind;
        }
    }
}

/// A layer of a pixel.
#[derive(CubeType, Clone, Copy)]
#[expand(derive(Clone, Copy))]
struct FoundLayer {
    key: f32,
    gaussian: u32,
    /// Place in the tile's list.
    place: u32,
    alpha: f32,
}

/// Takes the units of a tile through its `places` places from `first` on. `open` says whether a pixel is in the picture; `table`, `own` and
/// `keep` are those of [`Front::pass`]. All units of a cube have to call it together. No list and no keys make the way endless: it ends at the last
/// place or, with the per-pixel sort, when as many layers were found as there are places.
#[cube]
pub(super) fn front_to_back(
    inputs: &RayInputs,
    first: u32,
    places: u32,
    pixel: &RayPixel,
    open: bool,
    table: &mut [u32],
    own: usize,
    view: &RayFrame,
    #[comptime] keep: bool,
) -> Front {
    let features = comptime!(if keep { 1 } else { view.shape.features });
    let mut front = Front {
        open: Array::<u32>::new(1usize),
        left: Array::<f32>::new(2usize),
        sums: Array::<f32>::new(features),
        way: Array::<u32>::new(2usize),
    };
    front.open[0usize] = select(open, 1u32, 0u32);
    front.left[0usize] = 1.0f32;
    front.left[1usize] = 0.0f32;
    front.way[0usize] = 0u32;
    front.way[1usize] = 0u32;
    for channel in 0..features {
        front.sums[channel] = 0.0f32;
    }
    let mut near = Shared::<[f32]>::new_slice(comptime!(NEAR * shared_len(inputs.rays.is_some())));
    let mut gaussians = Shared::<[u32]>::new_slice(comptime!(NEAR));
    let mut anybody = Shared::<[u32]>::new_slice(1usize);
    let mut next = NextLayers::new();
    let mut found = 0u32;
    // DirectX wants a barrier between the reading of `places` and a branch with barriers.
    sync_cube();
    let mut running = places > 0;
    while running {
        let mut count = 0u32;
        let mut start = 0u32;
        let mut passing = true;
        while passing {
            let here = min(places - start, comptime!(NEAR as u32));
            if UNIT_POS < here {
                let gaussian = inputs.lists.gaussian(first + start + UNIT_POS);
                RayGaussian::load(inputs, gaussian as usize, view).store(&mut near, UNIT_POS as usize, inputs);
                gaussians[UNIT_POS as usize] = gaussian;
            }
            if UNIT_POS == 0 {
                anybody[0usize] = 0u32;
            }
            sync_cube();

            let mut i = 0u32;
            let mut going = front.is_open();
            while going {
                let seen = RayGaussian::stored(&near, i as usize, inputs).at(pixel, view);
                if seen.alpha > 0.0 {
                    let layer = FoundLayer {
                        key: seen.key,
                        gaussian: gaussians[i as usize],
                        place: start + i,
                        alpha: seen.alpha,
                    };
                    if comptime!(view.per_pixel) {
                        count = next.offer(count, layer);
                    } else {
                        front.pass(inputs, layer, table, own, view, keep);
                    }
                }
                i += 1;
                going = i < here && front.is_open();
            }
            if front.is_open() {
                anybody[0usize] = 1u32;
            }
            sync_cube();

            start += here;
            passing = anybody[0usize] != 0 && start < places;
            sync_cube();
        }
        if comptime!(view.per_pixel) {
            let mut i = 0u32;
            while i < count {
                front.pass(inputs, next.layer(i), table, own, view, keep);
                i = select(front.is_open(), i + 1, count);
            }
            next.leave(count);
            found += count;
            if count < comptime!(CHUNK as u32) || found >= places {
                front.open[0usize] = 0u32;
            }
            if UNIT_POS == 0 {
                anybody[0usize] = 0u32;
            }
            sync_cube();

            if front.is_open() {
                anybody[0usize] = 1u32;
            }
            sync_cube();

            running = anybody[0usize] != 0;
            sync_cube();
        } else {
            running = false;
        }
    }
    front
}

/// The layers of a pixel that come next behind its last one, in the order of their keys and then of their places.
#[derive(CubeType)]
struct NextLayers {
    keys: Array<f32>,
    gaussians: Array<u32>,
    places: Array<u32>,
    alphas: Array<f32>,
    /// Whether there is a last layer, and its place; its key.
    last: Array<u32>,
    last_key: Array<f32>,
}

/// Whether a layer is in front of another.
#[cube]
fn in_front(key: f32, place: u32, other_key: f32, other: u32) -> bool {
    key < other_key || (key == other_key && place < other)
}

#[cube]
impl NextLayers {
    fn new() -> NextLayers {
        let mut last = Array::<u32>::new(2usize);
        last[0usize] = 0u32;
        last[1usize] = 0u32;
        let mut last_key = Array::<f32>::new(1usize);
        last_key[0usize] = 0.0f32;
        NextLayers {
            keys: Array::<f32>::new(comptime!(CHUNK)),
            gaussians: Array::<u32>::new(comptime!(CHUNK)),
            places: Array::<u32>::new(comptime!(CHUNK)),
            alphas: Array::<f32>::new(comptime!(CHUNK)),
            last,
            last_key,
        }
    }

    fn put(&mut self, at: u32, layer: FoundLayer) {
        self.keys[at as usize] = layer.key;
        self.gaussians[at as usize] = layer.gaussian;
        self.places[at as usize] = layer.place;
        self.alphas[at as usize] = layer.alpha;
    }

    fn layer(&self, at: u32) -> FoundLayer {
        FoundLayer {
            key: self.keys[at as usize],
            gaussian: self.gaussians[at as usize],
            place: self.places[at as usize],
            alpha: self.alphas[at as usize],
        }
    }

    /// Makes the last of `count` layers the one behind which the next ones come.
    fn leave(&mut self, count: u32) {
        if count > 0 {
            self.last[0usize] = 1u32;
            self.last[1usize] = self.places[(count - 1) as usize];
            self.last_key[0usize] = self.keys[(count - 1) as usize];
        }
    }

    /// Inserts a layer into `count` sorted ones if it comes behind the last one, and returns the new number. If there is no room, the
    /// last of them is dropped.
    fn offer(&mut self, count: u32, layer: FoundLayer) -> u32 {
        let full = count == comptime!(CHUNK as u32);
        let behind = in_front(self.last_key[0usize], self.last[1usize], layer.key, layer.place);
        let mut room = self.last[0usize] == 0 || behind;
        let mut now = count;
        if room && full {
            let at = count - 1;
            room = in_front(layer.key, layer.place, self.keys[at as usize], self.places[at as usize]);
        }
        if room {
            let mut at = select(full, count - 1, count);
            now = at + 1;
            let mut moving = at > 0;
            while moving {
                let other = at - 1;
                moving = in_front(layer.key, layer.place, self.keys[other as usize], self.places[other as usize]);
                if moving {
                    let passed = self.layer(other);
                    self.put(at, passed);
                    at = other;
                    moving = at > 0;
                }
            }
            self.put(at, layer);
        }
        now
    }
}

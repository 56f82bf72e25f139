//! The layers of a vector of pixels, put in the order of each pixel.

use fearless_simd::prelude::*;

use crate::rasterize::tile::{lanes, len, store};
use crate::simd::real::Real;

/// A bit for each pixel of a vector.
pub(super) type Mask<S, F> = <<F as Real>::Block<S> as SimdBase<S>>::Mask;

/// Layers in slots, front to back in each lane. A slot has `PARTS` numbers for each lane: the sort key, the alpha, and what moves
/// with the layer. A lane that does not see the layer of a slot holds a hole: an alpha of zero and the key of the slot before, so
/// that the keys of a lane never fall.
#[derive(Default)]
pub(super) struct LayerSlots<F, const PARTS: usize> {
    values: Vec<F>,
    count: usize,
    /// Number of slots in order, from the first on.
    sorted: usize,
    /// Number of slots that layers have passed on their way.
    steps: usize,
    /// Whether layers stay without order until [`Self::finish`].
    unsorted: bool,
}

/// Number of slots that a layer may pass on average before the rest is appended and sorted at the end. Insertion alone would
/// take a time that grows with the square of a long list in no order.
const STEPS: usize = 64;

impl<F: Real, const PARTS: usize> LayerSlots<F, PARTS> {
    /// Removes all layers and makes room for as many as `layers`.
    pub fn clear<S: Simd>(&mut self, layers: usize) {
        (self.count, self.sorted, self.steps, self.unsorted) = (0, 0, 0, false);
        // The slot behind the last is written too.
        let needed = (layers + 1) * PARTS * len::<S, F>();
        if self.values.len() < needed {
            self.values.resize(2 * needed, F::ZERO);
        }
    }

    /// Number of slots.
    pub fn count(&self) -> usize {
        self.count
    }

    /// Number of slots that are known to be in order.
    pub fn sorted(&self) -> usize {
        if self.unsorted { 0 } else { self.sorted }
    }

    #[inline(always)]
    pub fn get<S: Simd>(&self, simd: S, slot: usize) -> [F::Block<S>; PARTS] {
        let values = &self.values[slot * PARTS * len::<S, F>()..][..PARTS * len::<S, F>()];
        let mut layer = [F::Block::<S>::splat(simd, F::ZERO); PARTS];
        for (part, value) in layer.iter_mut().enumerate() {
            *value = lanes::<S, F>(simd, values, part * len::<S, F>());
        }
        layer
    }

    #[inline(always)]
    pub fn put<S: Simd>(&mut self, slot: usize, layer: [F::Block<S>; PARTS]) {
        let values = &mut self.values[slot * PARTS * len::<S, F>()..][..PARTS * len::<S, F>()];
        for (part, value) in layer.into_iter().enumerate() {
            store(value, values, part * len::<S, F>());
        }
    }

    /// Returns one of the numbers of a slot's lanes.
    #[inline(always)]
    pub fn part<S: Simd>(&self, simd: S, slot: usize, part: usize) -> F::Block<S> {
        lanes::<S, F>(simd, &self.values, (slot * PARTS + part) * len::<S, F>())
    }

    /// Replaces one of the numbers of a slot's lanes.
    #[inline(always)]
    pub fn put_part<S: Simd>(&mut self, slot: usize, part: usize, value: F::Block<S>) {
        store(value, &mut self.values, (slot * PARTS + part) * len::<S, F>());
    }

    /// Appends a layer, with an alpha above zero where it `shows`, if it shows anywhere. A branch on that would be mispredicted too
    /// often. It is in order after [`Self::sort`].
    #[inline(always)]
    pub fn push<S: Simd>(&mut self, layer: [F::Block<S>; PARTS], shows: Mask<S, F>) {
        self.put::<S>(self.count, layer);
        self.count += usize::from(shows.any_true());
    }

    /// Brings the layers that were appended behind the layers with keys that are not larger. Layers come in the order of their centres,
    /// which is nearly that of each pixel, so that the way is short.
    ///
    /// Some are appended before any is sorted: whether a layer moves is often mispredicted, and is known sooner from a stored key.
    #[inline(always)]
    pub fn sort<S: Simd>(&mut self, simd: S) {
        let lowest = F::Block::<S>::splat(simd, -F::MAX);
        // The largest key so far, which the slot before has.
        let mut last = if self.sorted > 0 { self.key(simd, self.sorted - 1) } else { lowest };
        while self.sorted < self.count && !self.unsorted {
            let at = self.sorted;
            let shows = self.part::<S>(simd, at, 1).simd_gt(F::Block::<S>::splat(simd, F::ZERO));
            let key = shows.select(self.key(simd, at), last);
            self.put_part::<S>(at, 0, key);
            let moves = key.simd_lt(last);
            if moves.any_true() {
                self.unsorted = self.steps > STEPS * at;
                if !self.unsorted {
                    self.bring_forward::<S>(simd, at, moves);
                }
            }
            last = last.max(key);
            self.sorted += 1;
        }
    }

    /// Brings the layer at `from` to its place in the lanes where it `moves`.
    #[inline(always)]
    fn bring_forward<S: Simd>(&mut self, simd: S, from: usize, mut moves: Mask<S, F>) {
        let (mut at, layer) = (from, self.get::<S>(simd, from));
        // What belongs in the slot `at`: the layer where it moves, and elsewhere what was there.
        let mut own = layer;
        while at > 0 && moves.any_true() {
            let mut ahead = self.get::<S>(simd, at - 1);
            for (own, ahead) in own.iter_mut().zip(&mut ahead) {
                let (mine, other) = (*own, *ahead);
                *own = moves.select(other, mine);
                *ahead = moves.select(mine, other);
            }
            self.put::<S>(at, own);
            own = ahead;
            at -= 1;
            self.steps += 1;
            if at > 0 {
                moves &= layer[0].simd_lt(self.key(simd, at - 1));
            }
        }
        self.put::<S>(at, own);
    }

    /// Ends the insertions: sorts the rest, and all layers of each lane, stably, if too many slots were passed.
    #[inline(always)]
    pub fn finish<S: Simd>(&mut self, simd: S) {
        self.sort::<S>(simd);
        if self.unsorted {
            self.sort_lanes(len::<S, F>());
        }
    }

    /// Sorts the layers of each of so many lanes.
    fn sort_lanes(&mut self, lanes: usize) {
        let (mut order, mut column) = (Vec::new(), Vec::new());
        for lane in 0..lanes {
            let at = |slot: usize, part: usize| (slot * PARTS + part) * lanes + lane;
            order.clear();
            let shown = (0..self.count).filter(|&slot| self.values[at(slot, 1)] > F::ZERO);
            order.extend(shown.map(|slot| (self.values[at(slot, 0)], slot)));
            order.sort_by(|a, b| a.0.partial_cmp(&b.0).unwrap_or(std::cmp::Ordering::Equal));
            column.clear();
            column.extend(order.iter().map(|&(_, slot)| std::array::from_fn(|part| self.values[at(slot, part)])));
            column.resize(self.count, [F::ZERO; PARTS]);
            for (slot, layer) in column.iter().enumerate() {
                for (part, value) in layer.iter().enumerate() {
                    self.values[at(slot, part)] = *value;
                }
            }
        }
        self.unsorted = false;
    }

    #[inline(always)]
    fn key<S: Simd>(&self, simd: S, slot: usize) -> F::Block<S> {
        self.part::<S>(simd, slot, 0)
    }
}

/// The different numbers among the lanes of a slot's ids.
pub(super) struct Ids<S: Simd, F: Real> {
    ids: F::Block<S>,
    /// A bit for each lane that is not done.
    left: u64,
}

impl<S: Simd, F: Real> Ids<S, F> {
    /// Goes through the numbers of the lanes where `shows`.
    #[inline(always)]
    pub fn new(ids: F::Block<S>, shows: Mask<S, F>) -> Self {
        Self { ids, left: shows.to_bitmask() }
    }

    /// Returns the next number and the lanes that have it.
    #[inline(always)]
    pub fn next(&mut self) -> Option<(usize, Mask<S, F>)> {
        if self.left == 0 {
            return None;
        }
        let id = self.ids[self.left.trailing_zeros() as usize];
        let same = self.ids.simd_eq(F::Block::<S>::splat(self.ids.token(), id));
        self.left &= !same.to_bitmask();
        Some((id.to_index(), same))
    }
}

#[cfg(test)]
mod tests {
    use fearless_simd::{Level, dispatch};

    use super::*;
    use crate::testing::random::Random;

    const LAYERS: usize = 700;

    /// Sorts layers with these keys, `[layer][lane]`, of which a lane sees those with a positive one. Returns the layers of each
    /// lane, front to back, and the number of steps.
    #[inline(always)]
    fn sorted_layers<S: Simd>(simd: S, keys: &[Vec<f32>]) -> (Vec<Vec<usize>>, usize) {
        let mut slots = LayerSlots::<f32, 3>::default();
        slots.clear::<S>(keys.len());
        let zero = <f32 as Real>::Block::<S>::splat(simd, 0.0);
        for (i, keys) in keys.iter().enumerate() {
            let key = <f32 as Real>::Block::<S>::from_slice(simd, keys);
            let shows = key.simd_gt(zero);
            let alpha = shows.select(<f32 as Real>::Block::<S>::splat(simd, 0.5), zero);
            let id = <f32 as Real>::Block::<S>::splat(simd, f32::from_index(i));
            slots.push::<S>([key, alpha, id], shows);
            if i % 7 == 0 {
                slots.sort::<S>(simd);
            }
        }
        slots.finish::<S>(simd);
        let mut found = vec![Vec::new(); len::<S, f32>()];
        for slot in 0..slots.count() {
            let [_, alpha, id] = slots.get::<S>(simd, slot);
            for (lane, found) in found.iter_mut().enumerate().filter(|(lane, _)| alpha[*lane] > 0.0) {
                found.push(id[lane].to_index());
            }
        }
        (found, slots.steps)
    }

    /// Layers nearly in order, in reverse, and in no order; equal keys keep the order in which they came.
    #[test]
    fn every_lane_has_its_own_order_however_layers_come() {
        let mut random = Random::new(3);
        let mut random = |low: f64, high: f64| random.between(low, high) as f32;
        let near = |i: usize, random: &mut dyn FnMut(f64, f64) -> f32| 1.0 + i as f32 + random(-3.0, 3.0);
        for (name, spread) in [("near", 0), ("reverse", 1), ("none", 2)] {
            let mut key = |i: usize| match spread {
                _ if random(0.0, 1.0) < 0.3 => -1.0,
                0 => near(i, &mut random).max(0.5).floor() + 0.5,
                1 => (LAYERS - i) as f32,
                _ => random(1.0, 100.0).floor(),
            };
            let lanes = dispatch!(Level::new(), simd => lanes_of(simd));
            let keys: Vec<Vec<f32>> = (0..LAYERS).map(|i| (0..lanes).map(|_| key(i)).collect()).collect();
            let (found, steps) = dispatch!(Level::new(), simd => sorted_layers(simd, &keys));
            for (lane, found) in found.iter().enumerate() {
                let mut expected: Vec<usize> = (0..LAYERS).filter(|&i| keys[i][lane] > 0.0).collect();
                expected.sort_by(|&a, &b| keys[a][lane].total_cmp(&keys[b][lane]));
                assert_eq!(*found, expected, "{name}, lane {lane}");
            }
            assert!(steps <= (STEPS + 1) * LAYERS, "{name}: {steps} steps");
            assert_eq!(steps > STEPS * 100, spread > 0, "{name}: {steps} steps");
        }
    }

    #[inline(always)]
    fn lanes_of<S: Simd>(_: S) -> usize {
        len::<S, f32>()
    }
}

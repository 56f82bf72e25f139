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
}

impl<F: Real, const PARTS: usize> LayerSlots<F, PARTS> {
    pub fn clear(&mut self) {
        self.count = 0;
    }

    /// Number of slots.
    pub fn count(&self) -> usize {
        self.count
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

    /// Appends a layer if it shows anywhere. A branch on that would be mispredicted too often.
    #[inline(always)]
    pub fn push<S: Simd>(&mut self, layer: [F::Block<S>; PARTS], shows: Mask<S, F>) {
        let needed = (self.count + 1) * PARTS * len::<S, F>();
        if self.values.len() < needed {
            self.values.resize(2 * needed, F::ZERO);
        }
        self.put::<S>(self.count, layer);
        self.count += usize::from(shows.any_true());
    }

    /// Inserts a layer, where `shows`, behind the layers with keys that are not larger. Layers come in the order of their centres,
    /// which is nearly that of each pixel, so that the way is short.
    #[inline(always)]
    pub fn insert<S: Simd>(&mut self, mut layer: [F::Block<S>; PARTS], shows: Mask<S, F>) {
        let simd = layer[0].token();
        let mut at = self.count;
        let last = if at > 0 { self.key(simd, at - 1) } else { F::Block::<S>::splat(simd, -F::MAX) };
        layer[0] = shows.select(layer[0], last);
        let mut moves = layer[0].simd_lt(last);
        self.push::<S>(layer, shows);
        if !moves.any_true() {
            return;
        }
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
            if at > 0 {
                moves &= layer[0].simd_lt(self.key(simd, at - 1));
            }
        }
        self.put::<S>(at, own);
    }

    #[inline(always)]
    fn key<S: Simd>(&self, simd: S, slot: usize) -> F::Block<S> {
        lanes::<S, F>(simd, &self.values, slot * PARTS * len::<S, F>())
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

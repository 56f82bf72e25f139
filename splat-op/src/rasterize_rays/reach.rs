//! Which blocks of a tile may see which of its Gaussians, in the CPU twin.

use crate::intersect::PixelBox;
use crate::rasterize::footprint::BLOCKS;
use crate::rasterize::tile::BLOCK;

/// The source of what blocks may see.
#[derive(Clone, Copy)]
pub(super) enum Reach<'a> {
    /// The boxes of all Gaussians.
    Boxes(&'a [PixelBox]),
    /// By place in the tile's list, a bit for each block that sees the Gaussian.
    Blocks(&'a [u16]),
}

/// The Gaussians that each block of a tile may see.
#[derive(Default)]
pub(super) struct BlockLists {
    /// A bit for each block that may see the Gaussian, by index among the tile's Gaussians.
    pub blocks: Vec<u16>,
    /// For each block the indices of its Gaussians, in ascending order.
    lists: [Vec<u32>; BLOCKS],
    /// Number of Gaussians in each of `lists`.
    ends: [usize; BLOCKS],
}

impl BlockLists {
    /// Lists the Gaussians of `self.blocks` by block.
    #[inline(always)]
    pub fn fill(&mut self) {
        let Self { blocks, lists, ends } = self;
        for (block, (list, end)) in lists.iter_mut().zip(ends).enumerate() {
            if list.len() < blocks.len() {
                list.resize(2 * blocks.len(), 0);
            }
            // A branch on whether the block sees a Gaussian would be mispredicted too often.
            *end = 0;
            for (i, blocks) in blocks.iter().enumerate() {
                list[*end] = i as u32;
                *end += usize::from(blocks >> block & 1);
            }
        }
    }

    /// Returns the indices of the Gaussians that the vector of pixels at `place` may see.
    #[inline(always)]
    pub fn list(&self, place: usize) -> &[u32] {
        &self.lists[place / BLOCK][..self.ends[place / BLOCK]]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::random::Random;

    #[test]
    fn a_list_has_the_gaussians_with_the_bit_of_its_block() {
        let mut random = Random::new(5);
        let mut lists = BlockLists::default();
        for count in [3, 200, 40] {
            lists.blocks = (0..count).map(|_| random.between(0.0, 65536.0) as u16).collect();
            lists.fill();
            for block in 0..BLOCKS {
                let expected: Vec<u32> = (0..count).filter(|&i| lists.blocks[i as usize] >> block & 1 == 1).collect();
                assert_eq!(lists.list(block * BLOCK), expected);
            }
        }
    }
}

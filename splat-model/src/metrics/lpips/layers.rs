//! Tables of the networks, and what follows from them: the number of features of a picture, and their receptive fields.
//!
//! The tables are those of torchvision's `alexnet` and `vgg16` up to the last feature that LPIPS uses. The number of a layer is
//! its index in torchvision's `features`, where ReLUs and pools count too.

use std::ops::Range;

/// Number of taps, and so of slices, of either network.
pub const TAPS: usize = 5;

/// A layer of a network: a square window in pixels of the previous layer, and what is done with it.
#[derive(Clone, Copy, Debug)]
pub struct NetworkLayer {
    /// The number and the channels of a convolution, which has a bias and is followed by a ReLU. None for the maximum over the
    /// window, which does not extend beyond the border.
    pub convolution: Option<(usize, usize)>,
    pub side: usize,
    pub stride: usize,
    /// Zeros around the picture.
    pub padding: usize,
}

/// The network whose features are compared.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Net {
    /// AlexNet, which the authors of LPIPS recommend for scores.
    Alex,
    /// VGG16, which papers on Gaussian splatting quote.
    Vgg,
}

/// The layers between two taps. The features after the last layer are compared.
pub type LayerSlice = &'static [NetworkLayer];

const fn conv(number: usize, channels: usize, side: usize, stride: usize, padding: usize) -> NetworkLayer {
    NetworkLayer { convolution: Some((number, channels)), side, stride, padding }
}

const fn pool(side: usize, stride: usize) -> NetworkLayer {
    NetworkLayer { convolution: None, side, stride, padding: 0 }
}

const ALEX: [LayerSlice; TAPS] = [
    &[conv(0, 64, 11, 4, 2)],
    &[pool(3, 2), conv(3, 192, 5, 1, 2)],
    &[pool(3, 2), conv(6, 384, 3, 1, 1)],
    &[conv(8, 256, 3, 1, 1)],
    &[conv(10, 256, 3, 1, 1)],
];

const VGG: [LayerSlice; TAPS] = [
    &[conv(0, 64, 3, 1, 1), conv(2, 64, 3, 1, 1)],
    &[pool(2, 2), conv(5, 128, 3, 1, 1), conv(7, 128, 3, 1, 1)],
    &[pool(2, 2), conv(10, 256, 3, 1, 1), conv(12, 256, 3, 1, 1), conv(14, 256, 3, 1, 1)],
    &[pool(2, 2), conv(17, 512, 3, 1, 1), conv(19, 512, 3, 1, 1), conv(21, 512, 3, 1, 1)],
    &[pool(2, 2), conv(24, 512, 3, 1, 1), conv(26, 512, 3, 1, 1), conv(28, 512, 3, 1, 1)],
];

impl Net {
    /// Name of the network, as in `lpips.LPIPS(net=…)`.
    pub fn name(self) -> &'static str {
        match self {
            Self::Alex => "alex",
            Self::Vgg => "vgg",
        }
    }

    /// The layers up to each of the compared features.
    pub fn slices(self) -> [LayerSlice; TAPS] {
        match self {
            Self::Alex => ALEX,
            Self::Vgg => VGG,
        }
    }

    /// The shortest side of a picture that has features at every tap, px.
    pub fn least_side(self) -> usize {
        (1..).find(|side| self.features(*side).is_some()).expect("no table makes a picture shorter without end")
    }

    /// Number of features along a side of `side` pixels, by tap; `None` if a tap has none.
    pub fn features(self, side: usize) -> Option<[usize; TAPS]> {
        let mut length = side;
        let mut features = [0; TAPS];
        for (slice, features) in self.slices().into_iter().zip(&mut features) {
            for &NetworkLayer { side, stride, padding, .. } in slice {
                length = (length + 2 * padding).checked_sub(side)? / stride + 1;
            }
            *features = length;
        }
        Some(features)
    }

    /// The receptive field of a feature, by tap.
    pub fn views(self) -> [ReceptiveField; TAPS] {
        let mut view = ReceptiveField { stride: 1, before: 0, after: 0 };
        self.slices().map(|slice| {
            for &NetworkLayer { side, stride, padding, .. } in slice {
                view.before += view.stride * padding;
                view.after += view.stride * (side - 1 - padding);
                view.stride *= stride;
            }
            view
        })
    }
}

/// Receptive field along either side of a picture: feature `i` depends on the pixels from `i · stride − before` to
/// `i · stride + after`, both included. Pixels outside the picture are zeros, in the first layer or between layers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ReceptiveField {
    pub stride: usize,
    pub before: usize,
    pub after: usize,
}

/// A part of a side, px.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SidePart {
    /// The pixels whose features belong to the part: the features of every tap for which `i · stride` lies here.
    pub core: Range<usize>,
    /// The pixels that these features depend on. The start is a multiple of every stride, so that features keep their positions.
    pub seen: Range<usize>,
    /// Whether this is the last part, whose features extend to the end of the side.
    pub is_last: bool,
}

impl SidePart {
    /// The range of features that belong to the part, among the `length` features that a tap with this stride has for `seen`.
    pub fn wanted(&self, stride: usize, length: usize) -> Range<usize> {
        let local = |at: usize| (at / stride - self.seen.start / stride).min(length);
        local(self.core.start)..if self.is_last { length } else { local(self.core.end) }
    }
}

/// Cuts a side into parts of at most `most` pixels. Each part includes the receptive fields of its features, so the network
/// computes the same features for the part as for the whole picture. Every feature belongs to exactly one part.
///
/// # Panics
/// If `most` leaves no room for a core between its margins.
pub fn parts(net: Net, side: usize, most: usize) -> Vec<SidePart> {
    if side <= most {
        return vec![SidePart { core: 0..side, seen: 0..side, is_last: true }];
    }
    let views = net.views();
    let grid = views[TAPS - 1].stride;
    let reach =
        |of: fn(&ReceptiveField) -> usize| views.iter().map(of).max().unwrap_or_default().next_multiple_of(grid);
    let (before, after) = (reach(|view| view.before), reach(|view| view.after));
    let room = most.checked_sub(before + after).map_or(0, |room| room / grid * grid);
    assert!(room > 0, "parts of {most} px leave no room for a core between margins of {before} + {after} px");
    let core = side.div_ceil(side.div_ceil(room)).next_multiple_of(grid);
    let starts = (0..side).step_by(core);
    let part = |start: usize| {
        let end = (start + core).min(side);
        SidePart { core: start..end, seen: start.saturating_sub(before)..(end + after).min(side), is_last: end == side }
    };
    starts.map(part).collect()
}

#[cfg(test)]
mod tests;

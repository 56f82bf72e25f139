//! Numbers of intersections on their way from a GPU. A view whose lists have an expected length does not wait for its own number: a later
//! call reads it, if it has come in, for the expectations of views to come and for the count of views whose lists were too short.

use std::future::{Future, ready};
use std::ops::Deref;
use std::pin::Pin;
use std::sync::{Mutex, PoisonError};
use std::task::{Context, Poll, Waker};

use cubecl::server::ServerError;

use super::expected::remember;
use crate::counters::{count_read, count_truncated};
use crate::gpu::{Buffer, Gpu};

type Read = Result<(usize, u64), ServerError>;

/// The numbers of a view's Gaussians that have intersections, and of its intersections, when the device has counted them.
pub(super) struct Sizes(Pin<Box<dyn Future<Output = Read> + Send>>);

impl Sizes {
    /// Asks the device for `visible`, one number, and `sums`, `[chunks, 2]`: the intersections of each chunk of Gaussians.
    pub fn ask(gpu: &Gpu, visible: &Buffer<u32>, sums: &Buffer<u32>, chunks: usize) -> Self {
        let (client, handles) = (gpu.client.clone(), vec![visible.handle.clone(), sums.handle.clone()]);
        let read = async move { client.read_async(handles).await.map(|read| numbers(&read, chunks)) };
        let mut sizes = Self(Box::pin(read));
        // The first poll gives the copy to the device, before what is launched next.
        if let Poll::Ready(read) = sizes.poll() {
            sizes.0 = Box::pin(ready(read));
        }
        sizes
    }

    /// Returns the numbers if they have come in.
    fn poll(&mut self) -> Poll<Read> {
        self.0.as_mut().poll(&mut Context::from_waker(Waker::noop()))
    }

    /// Waits for the device.
    pub fn wait(self) -> (usize, u64) {
        cubecl::future::block_on(self.0).unwrap_or_else(|error| panic!("{error}"))
    }
}

fn numbers(read: &[impl Deref<Target = [u8]>], chunks: usize) -> (usize, u64) {
    count_read(read.iter().map(|part| part.len() as u64).sum());
    let visible = bytemuck::pod_read_unaligned::<u32>(&read[0][..4]) as usize;
    let sums: Vec<[u32; 2]> = bytemuck::pod_collect_to_vec(&read[1][..8 * chunks]);
    (visible, sums.iter().map(|&[low, high]| u64::from(low) + (u64::from(high) << 16)).sum())
}

/// A view whose lists are written with room for `capacity` intersections.
pub(super) struct PendingView {
    pub sizes: Sizes,
    pub tiles: [usize; 2],
    pub gaussians: usize,
    pub capacity: usize,
}

/// All devices share it.
static PENDING: Mutex<Vec<PendingView>> = Mutex::new(Vec::new());

/// Keeps a view until its numbers have come in.
pub(super) fn keep(view: PendingView) {
    PENDING.lock().unwrap_or_else(PoisonError::into_inner).push(view);
}

/// Reads the numbers that have come in. Never waits for a device.
pub(crate) fn settle() {
    PENDING.lock().unwrap_or_else(PoisonError::into_inner).retain_mut(|view| {
        let Poll::Ready(sizes) = view.sizes.poll() else { return true };
        // A device that failed says so where its results are read.
        if let Ok((_, intersections)) = sizes {
            remember(view.tiles, view.gaussians, intersections);
            count_truncated(u64::from(intersections > view.capacity as u64));
        }
        false
    });
}

//! Parallel loops. Those of rayon are generic over their closures, and each takes as long to compile as a kernel; all loops here share one.

use std::sync::{Mutex, MutexGuard, PoisonError};

use rayon::prelude::*;

/// Calls `task` with each part of the work and its number, in parallel.
pub(crate) fn for_each<T: Send>(parts: impl IntoIterator<Item = T>, task: impl Fn(usize, T) + Sync) {
    let parts = shared(parts);
    run(parts.len(), &|number| {
        let part = lock(&parts[number]).take();
        if let Some(part) = part {
            task(number, part);
        }
    });
}

/// Returns the results of `task` for each part of the work and its number, in the order of the parts.
pub(crate) fn map<T: Send, R: Send>(parts: impl IntoIterator<Item = T>, task: impl Fn(usize, T) -> R + Sync) -> Vec<R> {
    let mut results = Vec::new();
    let parts = shared(parts);
    results.resize_with(parts.len(), || Mutex::new(None));
    run(parts.len(), &|number| {
        let part = lock(&parts[number]).take();
        if let Some(part) = part {
            *lock(&results[number]) = Some(task(number, part));
        }
    });
    let mut all = Vec::with_capacity(results.len());
    for result in results {
        all.extend(result.into_inner().unwrap_or_else(PoisonError::into_inner));
    }
    all
}

/// [`map`] with buffers, which one task after the other reuses.
pub(crate) fn map_with<T: Send, B: Send, R: Send>(
    parts: impl IntoIterator<Item = T>,
    buffers: impl Fn() -> B + Sync,
    task: impl Fn(&mut B, usize, T) -> R + Sync,
) -> Vec<R> {
    let free = Mutex::new(Vec::new());
    map(parts, |number, part| {
        let own = lock(&free).pop();
        let mut own = own.unwrap_or_else(&buffers);
        let result = task(&mut own, number, part);
        lock(&free).push(own);
        result
    })
}

// Loops instead of iterators: these functions are compiled for every loop, and adapters would be most of their code.
fn shared<T>(parts: impl IntoIterator<Item = T>) -> Vec<Mutex<Option<T>>> {
    let parts = parts.into_iter();
    let mut all = Vec::with_capacity(parts.size_hint().0);
    for part in parts {
        all.push(Mutex::new(Some(part)));
    }
    all
}

/// A task that panics ends the whole loop, so that nobody sees what it left.
fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

fn run(count: usize, task: &(dyn Fn(usize) + Sync)) {
    (0..count).into_par_iter().for_each(task);
}

#[cfg(test)]
mod tests;

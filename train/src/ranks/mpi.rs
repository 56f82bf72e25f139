//! Ranks over MPI.
//!
//! A sum goes along the ranks in pieces: each adds its parts to what it receives and sends the result on while the next piece arrives. The
//! last rank has the sum and broadcasts it. A reduction by MPI itself would take less code, but MPI may add in any order.
//!
//! MPI ends all processes when an operation fails, so no operation here returns an error.

use std::sync::{Mutex, OnceLock, PoisonError};

use anyhow::{Context, Result, ensure};
use mpi::Threading;
use mpi::datatype::PartitionMut;
use mpi::environment::Universe;
use mpi::topology::SimpleCommunicator;
use mpi::traits::*;
use splat_model::trainer::ranks::{RankError, Ranks, add};

/// Numbers in a piece of a sum: 1 MiB. Smaller ones cost messages, larger ones leave later ranks without work for longer.
const PIECE: usize = 1 << 18;

/// Numbers in one broadcast, below the largest count of MPI.
const BROADCAST: usize = 1 << 28;

/// The connection of the process, which ends when it is taken out. A static is never dropped, so a panic waits for no other rank.
static UNIVERSE: OnceLock<Mutex<Option<Universe>>> = OnceLock::new();

/// All processes that were started together.
pub struct Mpi(SimpleCommunicator);

impl Mpi {
    /// Connects this process with the `expected` number of others.
    pub fn join(expected: usize) -> Result<Self> {
        let (universe, threads) =
            mpi::initialize_with_threading(Threading::Funneled).context("this process has used MPI before")?;
        ensure!(threads != Threading::Single, "this MPI library does not work in a program of several threads");
        let world = universe.world();
        UNIVERSE.get_or_init(|| Mutex::new(Some(universe)));
        ensure!(
            world.size() as usize == expected,
            "{expected} processes were started together, and MPI found {}: start them with the `mpirun` of the MPI library that \
             `splat` was built with, or with `srun --mpi=pmix`",
            world.size()
        );
        Ok(Self(world))
    }
}

/// Whether this process is connected.
fn is_joined() -> bool {
    UNIVERSE.get().is_some_and(|universe| universe.lock().unwrap_or_else(PoisonError::into_inner).is_some())
}

pub fn own_rank() -> usize {
    if is_joined() { SimpleCommunicator::world().rank() as usize } else { 0 }
}

pub fn abort(code: u8) {
    if is_joined() {
        SimpleCommunicator::world().abort(code.into());
    }
}

pub fn leave() {
    if let Some(universe) = UNIVERSE.get() {
        drop(universe.lock().unwrap_or_else(PoisonError::into_inner).take());
    }
}

impl Ranks for Mpi {
    fn rank(&self) -> usize {
        self.0.rank() as usize
    }

    fn count(&self) -> usize {
        self.0.size() as usize
    }

    fn gather(&self, own: &[u8]) -> Result<Vec<Vec<u8>>, RankError> {
        let mut lengths = vec![0; self.count()];
        self.0.all_gather_into(&(own.len() as i32), &mut lengths[..]);
        let mut at = 0;
        let begin = |length: &i32| {
            at += length;
            at - length
        };
        let begins: Vec<i32> = lengths.iter().map(begin).collect();
        let mut all = vec![0_u8; at as usize];
        self.0.all_gather_varcount_into(own, &mut PartitionMut::new(&mut all[..], &lengths[..], &begins[..]));
        let message = |(&begin, &length): (&i32, &i32)| all[begin as usize..(begin + length) as usize].to_vec();
        Ok(begins.iter().zip(&lengths).map(message).collect())
    }

    fn copy(&self, from: usize, values: &mut [f32]) -> Result<(), RankError> {
        let from = self.0.process_at_rank(from as i32);
        values.chunks_mut(BROADCAST).for_each(|values| from.broadcast_into(values));
        Ok(())
    }

    fn sum(&self, parts: Vec<Vec<f32>>, parts_of: &[usize], count: usize) -> Result<Vec<f32>, RankError> {
        let adding: Vec<usize> = (0..self.count()).filter(|rank| parts_of[*rank] > 0).collect();
        let process = |at: Option<&usize>| at.map(|&rank| self.0.process_at_rank(rank as i32));
        let mut parts = parts.into_iter();
        let mut sum = parts.next().unwrap_or_else(|| vec![0.0; count]);
        if let Some(at) = adding.iter().position(|rank| *rank == self.rank()) {
            let before = process(at.checked_sub(1).and_then(|before| adding.get(before)));
            let next = process(adding.get(at + 1));
            let rest: Vec<Vec<f32>> = parts.collect();
            let mut received = vec![0.0_f32; if before.is_some() { PIECE.min(count) } else { 0 }];
            mpi::request::scope(|scope| {
                let mut sent = Vec::new();
                for (i, piece) in sum.chunks_mut(PIECE).enumerate() {
                    if let Some(before) = &before {
                        let received = &mut received[..piece.len()];
                        before.receive_into(received);
                        // Either order of two summands gives the same.
                        add(piece, received);
                    }
                    let begin = i * PIECE;
                    rest.iter().for_each(|part| add(piece, &part[begin..begin + piece.len()]));
                    let piece: &[f32] = piece;
                    if let Some(next) = &next {
                        sent.push(next.immediate_send(scope, piece));
                    }
                }
                sent.into_iter().for_each(|request| _ = request.wait());
            });
        }
        if let Some(&last) = adding.last() {
            self.copy(last, &mut sum)?;
        }
        Ok(sum)
    }
}

//! Ranks that are threads of one process.

use std::rc::Rc;
use std::sync::mpsc::{Receiver, Sender, channel};
use std::thread;

use super::{RankError, Ranks, add};

/// One rank: channels to and from every other.
pub struct Threads {
    rank: usize,
    to: Vec<Sender<Vec<u8>>>,
    from: Vec<Receiver<Vec<u8>>>,
}

impl Threads {
    fn all(count: usize) -> Vec<Self> {
        let mut ranks: Vec<Self> = (0..count).map(|rank| Self { rank, to: Vec::new(), from: Vec::new() }).collect();
        for from in 0..count {
            for to in 0..count {
                let (sender, receiver) = channel();
                ranks[from].to.push(sender);
                ranks[to].from.push(receiver);
            }
        }
        ranks
    }

    fn send(&self, to: usize, message: &[u8]) -> Result<(), RankError> {
        self.to[to].send(message.to_vec()).map_err(|_| self.lost(to))
    }

    fn receive(&self, from: usize) -> Result<Vec<u8>, RankError> {
        self.from[from].recv().map_err(|_| self.lost(from))
    }

    fn lost(&self, other: usize) -> RankError {
        RankError { rank: self.rank, reason: format!("rank {other} is gone") }
    }
}

impl Ranks for Threads {
    fn rank(&self) -> usize {
        self.rank
    }

    fn count(&self) -> usize {
        self.to.len()
    }

    fn gather(&self, own: &[u8]) -> Result<Vec<Vec<u8>>, RankError> {
        (0..self.count()).try_for_each(|to| self.send(to, own))?;
        (0..self.count()).map(|from| self.receive(from)).collect()
    }

    fn copy(&self, from: usize, values: &mut [f32]) -> Result<(), RankError> {
        if from == self.rank {
            return (0..self.count())
                .filter(|to| *to != from)
                .try_for_each(|to| self.send(to, bytemuck::cast_slice(values)));
        }
        let received = self.receive(from)?;
        assert_eq!(received.len(), size_of_val(values), "all ranks copy as much");
        bytemuck::cast_slice_mut(values).copy_from_slice(&received);
        Ok(())
    }

    fn sum(&self, parts: Vec<Vec<f32>>, parts_of: &[usize], count: usize) -> Result<Vec<f32>, RankError> {
        assert_eq!(parts.len(), parts_of[self.rank], "all ranks know the number of parts");
        let all = self.gather(bytemuck::cast_slice(&parts.concat()))?;
        let all = bytemuck::pod_collect_to_vec::<u8, f32>(&all.concat());
        let mut sum = all[..count].to_vec();
        all[count..].chunks_exact(count).for_each(|part| add(&mut sum, part));
        Ok(sum)
    }
}

/// The results of `count` ranks, each of which runs on a thread of its own.
pub fn together<T: Send>(count: usize, run: impl Fn(Rc<dyn Ranks>) -> T + Sync) -> Vec<T> {
    thread::scope(|scope| {
        let ranks = Threads::all(count).into_iter();
        let run = &run;
        let threads: Vec<_> = ranks.map(|ranks| scope.spawn(move || run(Rc::new(ranks)))).collect();
        threads.into_iter().map(|thread| thread.join().unwrap()).collect()
    })
}

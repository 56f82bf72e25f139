//! Palettes: vector quantisers of the higher harmonics.
//!
//! A palette of 65,536 entries of 45 numbers is too large for k-means over all of them (a million Gaussians would take 6 × 10¹² operations an
//! iteration). Here a tree splits the vectors, each time in the direction of largest variance at the mean, and shares the entries among its halves by
//! their sums of squared differences. k-means then runs from the tree's leaves within its groups of about 64 entries. Nothing is random.

use rayon::prelude::*;

/// Largest number of entries of a group.
const GROUP: usize = 64;

/// Iterations of k-means in a group.
const ITERATIONS: usize = 5;

/// Iterations of the power method for a direction.
const POWER: usize = 4;

/// Largest number of vectors from which a direction is computed.
const SAMPLE: usize = 4_096;

/// A palette and the index of each vector in it.
pub struct Palette {
    /// Entries, each as long as a vector.
    pub entries: Vec<f32>,
    /// Index of the entry of each vector.
    pub labels: Vec<u32>,
}

/// Quantises vectors of `width` finite numbers with at most `most` entries.
pub fn palette(vectors: &[f32], width: usize, most: usize) -> Palette {
    let mut order: Vec<u32> = (0..(vectors.len() / width) as u32).collect();
    let source = Vectors { numbers: vectors, width };
    let groups = source.split(&mut order, most, GROUP);
    let groups: Vec<(Vec<u32>, usize)> =
        groups.into_iter().map(|(members, entries)| (members.to_vec(), entries)).collect();
    let found: Vec<Palette> = groups.par_iter().map(|(members, entries)| source.k_means(members, *entries)).collect();
    let mut all = Palette { entries: Vec::new(), labels: vec![0; vectors.len() / width] };
    for ((members, _), group) in groups.iter().zip(found) {
        let first = (all.entries.len() / width) as u32;
        for (&member, label) in members.iter().zip(group.labels) {
            all.labels[member as usize] = first + label;
        }
        all.entries.extend(group.entries);
    }
    all
}

struct Vectors<'a> {
    numbers: &'a [f32],
    width: usize,
}

impl Vectors<'_> {
    fn of(&self, i: u32) -> &[f32] {
        &self.numbers[self.width * i as usize..self.width * (i as usize + 1)]
    }

    /// Splits members into groups of at most `largest` entries. Returns each with its number of entries.
    fn split<'m>(&self, members: &'m mut [u32], entries: usize, largest: usize) -> Vec<(&'m [u32], usize)> {
        let entries = entries.min(members.len());
        if entries <= largest {
            return if members.is_empty() { Vec::new() } else { vec![(members, entries)] };
        }
        let middle = self.halve(members);
        let (low, high) = members.split_at_mut(middle);
        let (below, above) = rayon::join(|| self.error(low), || self.error(high));
        let share = below / (below + above);
        // Members without differences need one entry, and none needs more entries than it has members.
        let wanted = if share.is_finite() { (share * entries as f64).round() as usize } else { entries / 2 };
        let first = wanted.clamp(1.max(entries.saturating_sub(high.len())), (entries - 1).min(low.len()));
        let second = entries - first;
        let (mut below, above) = rayon::join(|| self.split(low, first, largest), || self.split(high, second, largest));
        below.extend(above);
        below
    }

    /// Reorders members so that those before the returned index, which is neither the first nor the last, are below the mean in the
    /// direction of largest variance.
    fn halve(&self, members: &mut [u32]) -> usize {
        let step = members.len().div_ceil(SAMPLE);
        let sample: Vec<u32> = members.iter().copied().step_by(step).collect();
        let mean = self.mean(&sample);
        let direction = self.direction(&sample, &mean);
        let above = |i: &u32| {
            self.of(*i).iter().zip(&mean).zip(&direction).map(|((x, mean), d)| (x - mean) * d).sum::<f32>() > 0.0
        };
        let (low, high): (Vec<u32>, Vec<u32>) = members.iter().partition(|i| !above(i));
        members[..low.len()].copy_from_slice(&low);
        members[low.len()..].copy_from_slice(&high);
        // Members that are all alike are halved by their number.
        if low.is_empty() || high.is_empty() { members.len() / 2 } else { low.len() }
    }

    fn mean(&self, members: &[u32]) -> Vec<f32> {
        let mut sums = vec![0.0_f64; self.width];
        for &member in members {
            sums.iter_mut().zip(self.of(member)).for_each(|(sum, x)| *sum += f64::from(*x));
        }
        sums.iter().map(|sum| (sum / members.len().max(1) as f64) as f32).collect()
    }

    /// The direction of largest variance, by the power method from the diagonal of the covariance.
    fn direction(&self, members: &[u32], mean: &[f32]) -> Vec<f32> {
        let mut direction = vec![0.0_f32; self.width];
        for &member in members {
            let differences = self.of(member).iter().zip(mean).map(|(x, mean)| x - mean);
            direction.iter_mut().zip(differences).for_each(|(sum, difference)| *sum += difference * difference);
        }
        for _ in 0..POWER {
            let length = direction.iter().map(|d| d * d).sum::<f32>().sqrt();
            direction.iter_mut().for_each(|d| *d /= length.max(f32::MIN_POSITIVE));
            let mut next = vec![0.0_f32; self.width];
            for &member in members {
                let vector = self.of(member);
                let along: f32 = vector.iter().zip(mean).zip(&direction).map(|((x, mean), d)| (x - mean) * d).sum();
                next.iter_mut().zip(vector.iter().zip(mean)).for_each(|(sum, (x, mean))| *sum += along * (x - mean));
            }
            direction = next;
        }
        direction
    }

    fn error(&self, members: &[u32]) -> f64 {
        let mean = self.mean(members);
        members.iter().map(|&member| f64::from(distance(self.of(member), &mean))).sum()
    }

    /// k-means of the members, from the means of the tree's leaves.
    fn k_means(&self, members: &[u32], entries: usize) -> Palette {
        let width = self.width;
        let leaves = &mut members.to_vec();
        let mut palette: Vec<f32> =
            self.split(leaves, entries, 1).iter().flat_map(|(leaf, _)| self.mean(leaf)).collect();
        let mut nearest_of: Vec<(u32, f32)>;
        let mut iteration = 0;
        loop {
            nearest_of = members.iter().map(|&member| nearest(&palette, self.of(member), width)).collect();
            if iteration == ITERATIONS || entries == members.len() {
                break;
            }
            iteration += 1;
            let mut sums = vec![0.0_f64; palette.len()];
            let mut counts = vec![0_u32; entries];
            for (&(label, _), &member) in nearest_of.iter().zip(members) {
                counts[label as usize] += 1;
                let sum = &mut sums[width * label as usize..][..width];
                sum.iter_mut().zip(self.of(member)).for_each(|(sum, x)| *sum += f64::from(*x));
            }
            for entry in 0..entries {
                let (values, sum) = (&mut palette[width * entry..][..width], &sums[width * entry..][..width]);
                if counts[entry] > 0 {
                    values.iter_mut().zip(sum).for_each(|(x, sum)| *x = (sum / f64::from(counts[entry])) as f32);
                    continue;
                }
                // An entry without members goes to the member that is farthest from its own.
                let farthest =
                    (0..members.len()).max_by(|&a, &b| nearest_of[a].1.total_cmp(&nearest_of[b].1).then(b.cmp(&a)));
                if let Some(farthest) = farthest {
                    values.copy_from_slice(self.of(members[farthest]));
                    nearest_of[farthest].1 = 0.0;
                }
            }
        }
        Palette { entries: palette, labels: nearest_of.iter().map(|(label, _)| *label).collect() }
    }
}

/// Index of the entry with the least distance, and that distance.
fn nearest(palette: &[f32], vector: &[f32], width: usize) -> (u32, f32) {
    let mut best = (0, f32::INFINITY);
    for (index, entry) in palette.chunks_exact(width).enumerate() {
        let found = distance(vector, entry);
        if found < best.1 {
            best = (index as u32, found);
        }
    }
    best
}

/// Squared distance, in eight sums that the compiler keeps in lanes.
fn distance(a: &[f32], b: &[f32]) -> f32 {
    let (a_lanes, a_rest) = a.as_chunks::<8>();
    let (b_lanes, b_rest) = b.as_chunks::<8>();
    let mut sums = [0.0_f32; 8];
    for (a, b) in a_lanes.iter().zip(b_lanes) {
        for lane in 0..8 {
            let difference = a[lane] - b[lane];
            sums[lane] += difference * difference;
        }
    }
    let rest = a_rest.iter().zip(b_rest).map(|(a, b)| (a - b) * (a - b));
    sums.iter().sum::<f32>() + rest.sum::<f32>()
}

#[cfg(test)]
mod tests;

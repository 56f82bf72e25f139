//! Growth to expect from refinements by gradient, for the time that a run has left.
//!
//! The statistics of a strategy say how many Gaussians a refinement would copy or split. Long before the first refinement they
//! tell captures apart: after 200 steps the share was between 0.03 on `lego_alpha` and 0.74 on the demo capture, of which the
//! first ended at half and the second at eight times its first Gaussians. What follows was read off five captures in runs of
//! 2,000 steps and the demo capture in one of 7,000: with a share `g` before the first refinement, the second adds about
//! `0.68 g^0.33` of the Gaussians, and each later one 0.8 times the share before. Single refinements had 0.7 to 1.06 times it.

/// Multiple of the opacity at which Gaussians are pruned, below which they are expected to be pruned by the first
/// refinement. Later refinements are so close that what is above the opacity itself mostly stays.
pub(super) const FADING: f64 = 4.0;

/// Factor and power of the second refinement's share.
const SECOND: (f64, f64) = (0.68, 0.33);

/// Share of a later refinement relative to the one before.
const LATER: f64 = 0.8;

/// The expected number of Gaussians after each of the refinements at the steps `later`, at most `most`, for a scene of `count`
/// Gaussians after `refined` refinements, of which the next one would add the share `growth`.
pub(super) fn expected(
    later: impl Iterator<Item = usize>,
    mut refined: usize,
    count: usize,
    mut growth: f64,
    most: usize,
) -> Vec<(usize, usize)> {
    let mut count = count as f64;
    let after = |step| {
        count = (count * (1.0 + growth)).min(most as f64);
        refined += 1;
        let lasting = growth.max(0.0);
        growth = if refined == 1 { SECOND.0 * lasting.powf(SECOND.1) } else { lasting * LATER };
        (step, count as usize)
    };
    later.map(after).collect()
}

/// The same for growth by at most a share of the Gaussians at a time, of which `growth` is due now: in the first half of all
/// refinements each adds this share, and in the second half the share falls in a straight line to nothing.
pub(super) fn expected_by_shares(
    later: &[usize],
    refined: usize,
    count: usize,
    growth: f64,
    most: usize,
) -> Vec<(usize, usize)> {
    let (mut count, all) = (count as f64, (refined + later.len()) as f64);
    let after = |(i, &step): (usize, &usize)| {
        let to_come = 1.0 - (refined + i) as f64 / all;
        count = (count * (1.0 + growth.max(0.0) * (2.0 * to_come).min(1.0))).min(most as f64);
        (step, count as usize)
    };
    later.iter().enumerate().map(after).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Numbers of Gaussians at the start and after each refinement, every 100 steps from 500 on, and the share that the
    /// statistics gave after 200 steps, of runs of 2,000 steps.
    const RUNS: [(&str, f64, [usize; 6]); 5] = [
        ("demo", 0.745, [6_000, 10_281, 16_780, 25_906, 37_421, 50_496]),
        ("fox_small", 0.256, [14_689, 19_112, 27_094, 35_986, 45_460, 54_556]),
        ("bonsai", 0.045, [78_602, 87_553, 107_926, 135_399, 166_973, 200_524]),
        ("statue_wild", 0.075, [11_280, 12_673, 14_931, 17_535, 20_208, 23_195]),
        ("lego_alpha", -0.044, [20_000, 13_529, 11_421, 9_822, 9_360, 9_942]),
    ];

    fn later() -> impl Iterator<Item = usize> {
        (500..1000).step_by(100)
    }

    #[test]
    fn a_tenth_of_a_run_tells_its_growth() {
        for (name, growth, counts) in RUNS {
            let expected = expected(later(), 0, counts[0], growth, 1_000_000);
            assert_eq!(expected.iter().map(|(step, _)| *step).collect::<Vec<_>>(), [500, 600, 700, 800, 900], "{name}");
            let ratio = expected[4].1 as f64 / counts[5] as f64;
            let within = if growth > 0.0 { 0.7..1.25 } else { 0.5..2.0 };
            assert!(within.contains(&ratio), "{name}: {expected:?} for {counts:?}");
        }
    }

    /// `fox_small` in 2,000 steps: 19,543 Gaussians after step 200, 41,858 after step 600, and 53,932 in the end.
    #[test]
    fn shares_are_taken_in_full_and_then_fade() {
        let later: Vec<usize> = (250..1000).step_by(50).collect();
        let expected = expected_by_shares(&later, 3, 19_543, 0.1, 1_000_000);
        assert_eq!((expected.len(), expected[0]), (15, (250, 21_497)));
        for (at, count) in [(7, 41_858.0), (14, 53_932.0)] {
            let ratio = expected[at].1 as f64 / count;
            assert!((0.9..1.1).contains(&ratio), "{expected:?}");
        }
        assert!(expected_by_shares(&later, 3, 1_000, 0.1, 1_200).iter().all(|(_, count)| *count <= 1_200));
        assert!(expected_by_shares(&later, 3, 1_000, -0.1, 1_200).iter().all(|(_, count)| *count == 1_000));
    }

    #[test]
    fn what_fades_is_gone_once_and_the_cap_holds() {
        let fading = expected(later(), 0, 1_000, -0.25, 1_000_000);
        assert_eq!(fading.iter().map(|(_, count)| *count).collect::<Vec<_>>(), [750; 5]);
        assert!(expected(later(), 0, 1_000, 0.5, 1_300).iter().all(|(_, count)| *count == 1_300));
    }
}

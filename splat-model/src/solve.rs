//! Small systems of linear equations.

/// Solves `gram x = moment` for a symmetric positive definite matrix by elimination. `None` if the matrix is singular.
pub(crate) fn solve<const N: usize>(mut gram: [[f64; N]; N], mut moment: [f64; N]) -> Option<[f64; N]> {
    let largest = (0..N).map(|i| gram[i][i]).fold(0.0, f64::max);
    for step in 0..N {
        if !(gram[step][step] > 1e-14 * largest) {
            return None;
        }
        for row in step + 1..N {
            let factor = gram[row][step] / gram[step][step];
            (step..N).for_each(|column| gram[row][column] -= factor * gram[step][column]);
            moment[row] -= factor * moment[step];
        }
    }
    for row in (0..N).rev() {
        let known: f64 = (row + 1..N).map(|column| gram[row][column] * moment[column]).sum();
        moment[row] = (moment[row] - known) / gram[row][row];
    }
    Some(moment)
}

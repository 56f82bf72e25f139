//! Rotations without their largest component, which follows from the other three and the unit length.

/// The index of the largest component of a quaternion, and the other components in their order, in `±√½`. A quaternion and its
/// negative are the same rotation, so the largest component is taken as positive. A quaternion of length zero becomes the
/// identity, if the first component is `w`.
pub(super) fn smallest_three(quaternion: [f32; 4]) -> (usize, [f64; 3]) {
    let q = quaternion.map(f64::from);
    let length = q.iter().map(|value| value * value).sum::<f64>().sqrt();
    let largest = (1..4).fold(0, |largest, i| if q[i].abs() > q[largest].abs() { i } else { largest });
    if !(length > 0.0 && length.is_finite()) {
        return (0, [0.0; 3]);
    }
    let scale = length.copysign(q[largest]).recip();
    (largest, others(largest).map(|i| q[i] * scale))
}

/// The unit quaternion with these components from [`smallest_three`]. Rounding may have made the three longer than one.
pub(super) fn from_smallest_three(largest: usize, three: [f64; 3]) -> [f32; 4] {
    let mut quaternion = [0.0; 4];
    for (i, value) in others(largest).into_iter().zip(three) {
        quaternion[i] = value as f32;
    }
    let square = three.iter().map(|value| value * value).sum::<f64>();
    quaternion[largest] = (1.0 - square).max(0.0).sqrt() as f32;
    quaternion
}

/// The indices of all components except the largest.
fn others(largest: usize) -> [usize; 3] {
    [0, 1, 2].map(|i| i + usize::from(i >= largest))
}

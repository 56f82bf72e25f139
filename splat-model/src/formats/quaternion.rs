//! Rotations without their largest component, which the other three and the length tell.

/// Which component of a quaternion is the largest, and the others in their order, in `±√½`. A quaternion and its negative are
/// the same rotation: the largest is taken as positive. One of length zero is no rotation; it becomes the identity, if the
/// first component is `w`.
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

/// The quaternion of length one that [`smallest_three`] tells of; rounding may have made the three longer than one.
pub(super) fn from_smallest_three(largest: usize, three: [f64; 3]) -> [f32; 4] {
    let mut quaternion = [0.0; 4];
    for (i, value) in others(largest).into_iter().zip(three) {
        quaternion[i] = value as f32;
    }
    let square = three.iter().map(|value| value * value).sum::<f64>();
    quaternion[largest] = (1.0 - square).max(0.0).sqrt() as f32;
    quaternion
}

/// The components but for one.
fn others(largest: usize) -> [usize; 3] {
    [0, 1, 2].map(|i| i + usize::from(i >= largest))
}

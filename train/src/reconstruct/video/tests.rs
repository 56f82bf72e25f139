use super::*;

#[test]
fn the_sharpest_of_each_interval_is_chosen() {
    assert_eq!(sharpest(&[0.1, 0.5, 0.2, 0.9, 0.3, 0.8], 3), [1, 3, 5]);
    assert_eq!(sharpest(&[0.1, 0.5, 0.2, 0.9, 0.3, 0.8, 0.1], 2), [1, 3]);
    assert_eq!(sharpest(&[0.1, 0.2], 9), [0, 1]);
    assert_eq!(sharpest(&[], 9), [0usize; 0]);
}

#[test]
fn pictures_of_a_stream() {
    let mut stream: Vec<u8> = b"P5\n3 2\n255\n".to_vec();
    stream.extend([1, 2, 3, 4, 5, 6]);
    stream.extend(b"P5 1 1 255 \x0a");
    stream.extend(b"P5\n4 4\n255\ncut");
    let mut stream = stream.as_slice();
    assert_eq!(next_picture(&mut stream).unwrap(), Some(([3, 2], vec![1, 2, 3, 4, 5, 6])));
    assert_eq!(next_picture(&mut stream).unwrap(), Some(([1, 1], vec![10])));
    assert_eq!(next_picture(&mut stream).unwrap(), None);
    for bad in [&b"P6\n1 1\n255\nabc"[..], b"P5\n99999999 1\n255\n", b"P5\n1 1\n65535\nab", &[b'x'; 200]] {
        assert!(next_picture(&mut &*bad).is_err());
    }
}

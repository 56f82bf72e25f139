use super::*;

#[test]
fn a_feature_looks_at_what_is_known_of_it() {
    // Araujo et al. 2019, "Computing receptive fields of convolutional neural networks": 195 px for AlexNet's last pool,
    // which is 2 strides of 16 px wider than its last convolution; 212 px for VGG16's, 1 stride wider.
    let widths = |net: Net| net.views().map(|view| view.before + view.after + 1);
    assert_eq!(widths(Net::Alex)[4], 195 - 2 * 16);
    assert_eq!(widths(Net::Vgg), [5, 14, 40, 92, 212 - 16]);
    assert_eq!(Net::Alex.views().map(|view| view.stride), [4, 8, 16, 16, 16]);
    assert_eq!(Net::Vgg.views().map(|view| view.stride), [1, 2, 4, 8, 16]);
}

#[test]
fn sides_have_as_many_features_as_in_torchvision() {
    assert_eq!(Net::Alex.features(224), Some([55, 27, 13, 13, 13]));
    assert_eq!(Net::Vgg.features(224), Some([224, 112, 56, 28, 14]));
    assert_eq!((Net::Alex.least_side(), Net::Vgg.least_side()), (31, 16));
    assert_eq!((Net::Alex.features(30), Net::Vgg.features(15), Net::Vgg.features(0)), (None, None, None));
}

#[test]
fn parts_want_every_feature_once_and_see_what_it_looks_at() {
    for net in [Net::Alex, Net::Vgg] {
        for (side, most) in [(700, 240), (721, 720), (1000, 240), (1007, 256), (3840, 1088), (305, 304)] {
            let parts = parts(net, side, most);
            assert!(parts.len() > 1 && parts.iter().all(|part| part.seen.len() <= most), "{parts:?}");
            let features = net.features(side).unwrap();
            for (view, count) in net.views().into_iter().zip(features) {
                let mut next = 0;
                for part in &parts {
                    let first = part.seen.start / view.stride;
                    assert_eq!(part.seen.start % view.stride, 0);
                    let wanted = part.wanted(view.stride, count - first);
                    assert_eq!(first + wanted.start, next.min(count), "{net:?} {side} {part:?}");
                    next = first + wanted.end;
                    for i in wanted.map(|i| first + i) {
                        let from = (i * view.stride).saturating_sub(view.before);
                        let to = (i * view.stride + view.after).min(side - 1);
                        assert!(part.seen.contains(&from) && part.seen.contains(&to), "{net:?} {side} {part:?} {i}");
                    }
                }
                assert_eq!(next, count, "{net:?} {side}");
            }
        }
    }
}

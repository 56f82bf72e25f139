use base64::Engine;
use base64::prelude::BASE64_STANDARD;
use image::codecs::jpeg::JpegEncoder;
use image::{Rgb, RgbImage};

use super::*;

/// 40 × 27 px with half the colours along each axis, codes of its own, and a restart marker after every two units, by Pillow 13: progressive
/// in ten scans, and sequential.
const BY_PILLOW: [&str; 2] = [
    "/9j/4AAQSkZJRgABAQAAAQABAAD/2wBDAA0JCgsKCA0LCgsODg0PEyAVExISEyccHhcgLikxMC4pLSwzOko+MzZGNywtQFdBRkxOUlNSMj5aYV\
    pQYEpRUk//2wBDAQ4ODhMREyYVFSZPNS01T09PT09PT09PT09PT09PT09PT09PT09PT09PT09PT09PT09PT09PT09PT09PT09PT0//wgARCAAb\
    ACgDASIAAhEBAxEB/8QAGAABAAMBAAAAAAAAAAAAAAAAAgABAwT/xAAXAQADAQAAAAAAAAAAAAAAAAAAAQID/90ABAAC/9oADAMBAAIQAxAAAA\
    Hm3Gjo3Ep//9ARQKWSzP/Rsg5mkuKv/8QAHxAAAgICAgMBAAAAAAAAAAAAAQIDEQASEzMUISIx/9oACAEBAAEFAo4uRggLf//QAGBdU//RlA8Z\
    KWD/0jWj1n//0zTOuryf/9RSWwEl/wD/1QfkWE//1jekPV//1x1n3F//0JPwk83/xAAjEQAABAMJAAAAAAAAAAAAAAAAAQIREiGBAyJBUXGxwd\
    Hw/9oACAEDAQE/AVLU7nr0JlLzmP/Qu5yBnjUf/9GFqcgrKLYf/8QAIREAAQEIAwEAAAAAAAAAAAAAAAECAxESEyFhoRQxQVH/2gAIAQIBAT8B\
    abv3snzs/9CvTtHYr9I+n//RR8mTmSfT/8QAJhAAAgIBAgMJAAAAAAAAAAAAAAECEhEhMRNBgSJRUmJxcpKx4f/aAAgBAQAGPwLLfZiWqtNsn/\
    /Q4mEN4i2+VT//0Y1UU5S5Ij3vU//SxncjA//TquR5baH/1FlKqQ540R//1b132LeI/9ammv6fE//X6kfR/Z//0OiF7z//xAAiEAEAAQMEAgMB\
    AAAAAAAAAAABEQAhUTFBgfBhkaGxweH/2gAIAQEAAT8hKBAXabiDyF4r/9C7tUsEXfn7pCd5BMeM1//RjhkvBs1H4dtlbH7X/9Ia22rbvqplpB\
    173iv/0yDyww/mKAIGAfRr/9SBqhaa2/rSpLo97tiv/9XWg6BtHe50Vgb9zxX/1gCCRm2Eo3c8s1//19ubTPRJTgOSn//Q0XcblL0YBsQDxAV/\
    /9oADAMBAAIAAwAAABD5n//QNf8A/9HcP//EAB8RAQACAgICAwAAAAAAAAAAAAERIQBBMYGRwWFxsf/aAAgBAwEBPxCZ1WPnge81Gyv0ejP/0I\
    hDEUfRvzlizS/R1n//0ZFBuB27ckqMBTrnzOf/xAAeEQACAQQDAQAAAAAAAAAAAAABMQAhQVGBEXHRof/aAAgBAgEBPxApK1Pu0qf1Q1P/0KWS\
    r+QUh0Y7Np//0Si2yLah4gQ1WPJ//8QAHxABAQACAgMBAQEAAAAAAAAAAREhMQBBUWGRcYGh/9oACAEBAAE/EMx9k1wJoKMXHrrJuzn/0C2EgQ\
    0XSxZ6a15dZChmaHh2ySzHP//RmwQgSODHMygQgnuNxt65/9K7YsoOrXy+MAAUJyOiMIClwV0I6SZMUL//02MpICZv8KKHTN4jEc2SEWx6Gn85\
    /9RIUYBLFvcs+Z/XXb2UUKwyIYTeNMh//9XMCYCAHvWnXu6rwu1ZSMqBSy4AYwBubz//1sUVRqIh8Tmbm3VdI/TDz//XTNq2+tp6dPWtcaRikC\
    CgOuvWuf/QTnMCvlV+s+Y1ySKKBBIA/Gc//9k=",
    "/9j/4AAQSkZJRgABAQAAAQABAAD/2wBDABALDA4MChAODQ4SERATGCgaGBYWGDEjJR0oOjM9PDkzODdASFxOQERXRTc4UG1RV19iZ2hnPk1xeX\
    BkeFxlZ2P/2wBDARESEhgVGC8aGi9jQjhCY2NjY2NjY2NjY2NjY2NjY2NjY2NjY2NjY2NjY2NjY2NjY2NjY2NjY2NjY2NjY2NjY2P/wAARCAAb\
    ACgDASIAAhEBAxEB/8QAFwAAAwEAAAAAAAAAAAAAAAAAAAIDBP/EAC4QAAIBAgQEBAUFAAAAAAAAAAECAwQRABIhMQUTQWEiUXGRFBUygaEkQl\
    LBwv/EABcBAAMBAAAAAAAAAAAAAAAAAAACAwH/xAAsEQABAgMFBgcBAAAAAAAAAAABAAIRITEDBBITgSIyUWFx0QUUQXKCosHx/90ABAAC/9oA\
    DAMBAAIRAxEAPwDDw/hy10/MlkVaeAXZjtjZFSwy1DziBAqfQJPEzCx/aNtRve2JUXLp+DU65SZZBnCkDxMdF7/yv2xaRYvhOTzS3NszEqB03P\
    fyGwABIFsM+1JcdrlvFUtLV+Iud7j1o0KccUIzVxSIKygKFCi5uepzC/36bebx07U1LJMIoHlckiN4QHtfS3Ruvtpgq+Wz09Icyhh4haxOu1zs\
    CDsRbUaLphplSarWGI3ENmUAWyn/ACDaxB2PnphcyNXfY0SbYkDMS+RqdF//0JcThi+Q04gjhSaaYAlEANrHywYpTrBVVylVYQJOrICLDVSdO1\
    7j7YMHnMgYY1nvFbBkIF0AJDp/UsMklQYleFDBDHlFlJJstz13szew+9I5nmqpKxoldIvp3sSBc2GoIGh66W08NsZ+Es3y6+Zt4Op6ix9xph4i\
    fgAlzYysm/QLmHsdsRde2gkT4VHZBdPGR6F5/Bov/9FoZP05qWgDZ/CiiwAHrtsfz5XLInNjpOfbWfwgkF7dOtvIN2Cg9cSmYycPhDWsY3cgC2\
    ucfjtthK0nkq1zcRRsD3YHMfU2/rERemk1dXiOy3AWxAqIDVxqrSCRaQUqomaVMwC7AFZCB7HBhppXTiaKpsq1OQADQAhRa3ocGFPieVAiM+Y7\
    Jxd8wkgwAkNF/9k=",
];

fn encoded(width: u32, height: u32, quality: u8) -> Vec<u8> {
    let noise = |x: u32, y: u32| (x.wrapping_mul(2_654_435_761) ^ y.wrapping_mul(40_503).rotate_left(7)) >> 13;
    let picture =
        RgbImage::from_fn(width, height, |x, y| Rgb([noise(x, y) as u8, (3 * x + y) as u8, (x * y / 8) as u8]));
    let mut bytes = Vec::new();
    picture.write_with_encoder(JpegEncoder::new_with_quality(&mut bytes, quality)).unwrap();
    bytes
}

/// Pictures of both kinds, with their sizes.
fn whole() -> Vec<(Vec<u8>, [usize; 2])> {
    let by_pillow = BY_PILLOW.map(|text| (BASE64_STANDARD.decode(text).unwrap(), [40, 27]));
    let encoded = [(96, 70, 90), (17, 9, 30), (80, 61, 50)]
        .map(|(width, height, quality)| (encoded(width, height, quality), [width as usize, height as usize]));
    by_pillow.into_iter().chain(encoded).collect()
}

/// Where the data of the first scan begin.
fn data_from(bytes: &[u8]) -> usize {
    bytes.windows(2).position(|pair| pair == [0xff, 0xda]).unwrap() + 14
}

#[test]
fn whole_pictures_pass_with_anything_behind_them() {
    for (bytes, size) in whole() {
        assert_eq!(check(&bytes, size), Ok(()));
        assert_eq!(
            check(&bytes[..bytes.len() - 1], size).is_ok(),
            bytes[..].windows(2).all(|pair| pair != [0xff, 0xc2])
        );
        // Phones append a video, or further pictures.
        for behind in [&b"\0\0\0\x18ftypmp42"[..], &bytes, &[0xff; 9], &[0; 4096]] {
            assert_eq!(check(&[&bytes, behind].concat(), size), Ok(()));
        }
        let (data, end) = bytes.split_at(bytes.len() - 2);
        assert_eq!(check(&[data, &[0xff, 0xff], end].concat(), size), Ok(()), "fill bytes");
        assert_eq!(check(&[data, &[0; 9], end].concat(), size), Ok(()), "a few bytes that belong to nothing");
        assert!(check(&[data, &[0; 90], end].concat(), size).unwrap_err().contains("are wrong after 100%"));
    }
}

#[test]
fn a_cut_is_found_wherever_it_is() {
    for (bytes, size) in whole() {
        for length in data_from(&bytes)..bytes.len() - 3 {
            let message = check(&bytes[..length], size).expect_err(&format!("{length} of {} bytes", bytes.len()));
            assert!(message.contains("cut short"), "{message}");
            // The marker of the end, as some programs append it.
            let ended = check(&[&bytes[..length], &[0xff, 0xd9]].concat(), size);
            assert!(ended.is_err(), "{length} of {} bytes and the end", bytes.len());
        }
    }
    let (bytes, size) = whole().swap_remove(2);
    let message = check(&bytes[..bytes.len() * 3 / 10], size).unwrap_err();
    assert!(message.contains("after 1") || message.contains("after 2"), "the share of the picture: {message}");
}

#[test]
fn a_hole_is_found() {
    for (bytes, size) in whole().into_iter().filter(|(bytes, _)| bytes.len() > 3000) {
        let from = data_from(&bytes);
        let length = (bytes.len() - from) / 3;
        for start in [from + 9, from + length / 2, from + length] {
            let mut spoilt = bytes.clone();
            spoilt[start..start + length].fill(0);
            assert!(check(&spoilt, size).is_err(), "zeros from {start}");
            let lacking = [&bytes[..start], &bytes[start + length..]].concat();
            assert!(check(&lacking, size).is_err(), "nothing from {start}");
        }
    }
}

/// Damage anywhere ends in a verdict, and what is not understood is left to the decoder.
#[test]
fn nothing_panics() {
    for (bytes, size) in whole().into_iter().take(2) {
        assert_eq!(check(&bytes, [size[0] + 1, size[1]]), Ok(()), "another size");
        for at in 0..bytes.len() {
            for value in [0, 0xff, bytes[at] ^ 0x10, bytes[at].wrapping_add(1)] {
                let mut spoilt = bytes.clone();
                spoilt[at] = value;
                let _ = check(&spoilt, size);
            }
        }
    }
    for bytes in [&b""[..], b"\xff", b"\xff\xd8", b"\xff\xd8\xff\xda", b"\xff\xd8\xff\xd9"] {
        let _ = check(bytes, [8, 8]);
    }
}

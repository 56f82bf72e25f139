//! The reader of photographs, on JPEG: its decoder is another project's, and the check that its data are whole is ours.

use std::fs;
use std::path::PathBuf;

use base64::Engine;
use base64::prelude::BASE64_STANDARD;
use splat_model::capture::{View, image};
use splat_op::Intrinsics;

use super::engine::{FuzzTarget, folder};
use super::targets::{judge_message, shape};

/// 40 × 27 px with restart markers, progressive and sequential, as in `splat-model/src/capture/image/jpeg/tests.rs`.
const WHOLE: [&str; 2] = [
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

pub struct Pictures {
    folder: PathBuf,
    view: View,
}

impl Pictures {
    pub fn new(name: &str) -> Self {
        let folder = folder(name);
        let (name, image_path) = ("photo.jpg".to_owned(), folder.join("photo.jpg"));
        let intrinsics = Intrinsics::centred(40, 27, 30.0);
        Self { view: View { name, image_path, intrinsics, cam_from_world: Default::default() }, folder }
    }
}

impl FuzzTarget for Pictures {
    fn name(&self) -> &'static str {
        "pictures"
    }

    fn seeds(&self) -> Vec<Vec<u8>> {
        let whole = WHOLE.map(|text| BASE64_STANDARD.decode(text).expect("written here"));
        // A phone's video behind the picture, and a picture without the marker of its end.
        let followed = [&whole[1][..], b"\0\0\0\x18ftypmp42\0\0\0\0"].concat();
        let open = whole[1][..whole[1].len() - 2].to_vec();
        whole.into_iter().chain([followed, open]).collect()
    }

    fn words(&self) -> &'static [&'static str] {
        // Bytes above 127 cannot be written here; splitting keeps those of the seeds whole.
        &["\0", "\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0", "\u{1}", "?", "ply\n", "Exif\0\0", "\u{8}\0\u{1b}\0(\u{3}"]
    }

    fn split(&self, input: &[u8]) -> Vec<Vec<u8>> {
        // Each segment begins with 255 and its marker.
        let mut fields: Vec<Vec<u8>> = Vec::new();
        for (at, &byte) in input.iter().enumerate() {
            let begins = byte == 255 && input.get(at + 1).is_some_and(|&next| next != 0);
            match fields.last_mut().filter(|_| !begins) {
                Some(field) => field.push(byte),
                None => fields.push(vec![byte]),
            }
        }
        fields
    }

    fn place(&mut self, input: &[u8]) {
        fs::write(&self.view.image_path, input).expect("the target folder can be written to");
    }

    fn read(&mut self) -> Result<String, String> {
        match image::load(&self.view, None) {
            Ok(photo) if photo.rgb.len() != 3 * 40 * 27 => Err(format!("{} values", photo.rgb.len())),
            Ok(photo) => Ok(format!("accepted: alpha {}", photo.alpha.is_some())),
            Err(error) => {
                let message = error.to_string();
                judge_message(&message, &self.folder)?;
                Ok(shape(&message, &self.folder))
            }
        }
    }
}

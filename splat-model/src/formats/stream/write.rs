//! The files of [`super::convert`].

use std::fs::File;
use std::io::{self, BufWriter};
use std::path::Path;

use super::{ConvertOptions, Fit, Moved, SceneReader, Stop};
use crate::formats::{FormatError, SceneFile, compressed, gltf, spz};
use crate::gaussians::GaussianRows;
use crate::ply;
use crate::replace::replace;

pub(super) fn write_ply(from: &mut SceneReader, fit: &mut Fit, to: &Path) -> Result<(), FormatError> {
    let ((all, _), world, sh_degree) = (from.size(), from.about.world(), fit.sh_degree);
    let begin = |out: &mut BufWriter<File>| ply::write_header(out, all, sh_degree, world);
    write_rows(from, fit, (to, all), begin, |(), out, rows| ply::write_rows(out, rows))
}

pub(super) fn write_glb(
    from: &mut SceneReader,
    fit: &mut Fit,
    to: &Path,
    options: &ConvertOptions,
) -> Result<(), FormatError> {
    let mut outline = gltf::Outline::new(fit.sh_degree);
    from.rewind()?;
    fit.each(from, |rows| {
        outline.add(rows);
        Ok(())
    })
    .map_err(Stop::format)?;
    let about = SceneFile { antialiased: from.about.antialiased || options.antialiased, ..from.about.clone() };
    let begin = |out: &mut BufWriter<File>| outline.begin_binary(out, &about);
    write_rows(from, fit, (to, outline.count), begin, |pieces, out, rows| pieces.put(out, rows))
}

/// Writes a file of so many rows: what `begin` writes, and then what `put` writes of each part of them.
fn write_rows<T>(
    from: &mut SceneReader,
    fit: &mut Fit,
    (to, count): (&Path, usize),
    begin: impl FnOnce(&mut BufWriter<File>) -> io::Result<T>,
    put: impl Fn(&mut T, &mut BufWriter<File>, &GaussianRows) -> io::Result<()>,
) -> Result<(), FormatError> {
    from.rewind()?;
    let mut failed = None;
    let written = replace(to, |out| {
        let (mut state, mut passed, mut usable) = (begin(out)?, 0, 0);
        let all = fit.each(from, |rows| {
            passed += rows.len();
            usable += rows.len() - rows.unusable();
            // Places are for so many rows.
            if passed <= count { put(&mut state, out, rows).map_err(Stop::Io) } else { Ok(()) }
        });
        let all = all.and_then(|()| if passed == count { Ok(()) } else { Err(Stop::Format(from.changed())) });
        let left = || ply::check_left(to, usable, from.size().0).map_err(|error| Stop::Format(error.into()));
        let all = all.and_then(|()| left());
        all.map_err(|stop| match stop {
            Stop::Io(error) => error,
            Stop::Format(error) => {
                failed = Some(error);
                io::ErrorKind::Other.into()
            }
        })
    });
    // An input that cannot be read is the cause.
    failed.map_or(Ok(()), Err)?;
    written.map_err(|refused| FormatError::refused(to, refused))
}

/// Returns the place of each row that the file holds.
pub(super) fn write_compressed(from: &mut SceneReader, fit: &mut Fit, to: &Path) -> Result<Vec<u32>, FormatError> {
    let geometry = fit.geometry_of(from)?;
    let count = geometry.len();
    ply::check_left(to, count, from.size().0)?;
    let places = compressed::arranged(&geometry.means, &geometry.sh_dc, (0..count as u32).collect());
    let mut file = compressed::PackedFile::of(&places, &geometry, fit.sh_degree);
    drop(geometry);
    let mut place_of_row = vec![0; count];
    for (place, row) in places.iter().enumerate() {
        if let Some(row) = row {
            place_of_row[*row as usize] = place as u32;
        }
    }
    let mut next = 0;
    from.rewind()?;
    fit.each(from, |rows| {
        let Some(own) = place_of_row.get(next..next + rows.len()) else { return Ok(()) };
        next += rows.len();
        own.iter().enumerate().for_each(|(row, place)| file.put(*place as usize, rows, row));
        Ok(())
    })
    .map_err(Stop::format)?;
    places.iter().enumerate().filter(|(_, row)| row.is_none()).for_each(|(place, _)| file.put_hidden(place));
    if next != count {
        return Err(from.changed());
    }
    file.write(to, from.about.world())?;
    Ok(place_of_row)
}

pub(super) fn write_spz(
    from: &mut SceneReader,
    fit: &mut Fit,
    to: &Path,
    options: &ConvertOptions,
) -> Result<(), FormatError> {
    let mut geometry = fit.geometry_of(from)?;
    ply::check_left(to, geometry.len(), from.size().0)?;
    let moved = spz::bring_within_reach(&mut geometry);
    let mut sections = spz::PackedSections::new(fit.sh_degree, spz::farthest(&geometry.means), options.spz);
    fit.moved = moved
        .into_iter()
        .map(|row| Moved { row, mean: geometry.means[row], log_scales: geometry.log_scales[row] })
        .collect();
    drop(geometry);
    from.rewind()?;
    fit.each(from, |rows| {
        sections.add(rows);
        Ok(())
    })
    .map_err(Stop::format)?;
    sections.write(to, from.about.antialiased || options.antialiased)
}

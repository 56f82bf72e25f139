use std::collections::BTreeMap;
use std::sync::Mutex;

use super::*;
use crate::capture::CaptureError;
use crate::gaussians::values_of;
use crate::trainer::testing::{HEIGHT, WIDTH, photos};

impl Views {
    /// Number of prepared photographs in the cache.
    pub fn kept(&self) -> usize {
        self.views.iter().filter(|view| view.truth.is_some()).count()
    }

    /// Number of packed photographs in the cache.
    fn kept_packed(&self) -> usize {
        self.views.iter().filter(|view| view.packed.is_some()).count()
    }

    /// Sets the remaining size of the cache, bytes.
    pub fn leave_room(&mut self, bytes: usize) {
        self.cache_left = bytes;
    }
}

fn photographs(photos: Vec<Photo>) -> Vec<Photograph> {
    photos.into_iter().map(Photograph::from).collect()
}

#[test]
fn pictures_are_not_reduced_to_nothing() {
    let size = |width, height, divisor| reduced_size(&Intrinsics::centred(width, height, 50.0), divisor);
    assert_eq!(size(270, 480, 1), None);
    assert_eq!(size(270, 480, 2), Some([135, 240]));
    assert_eq!(size(271, 481, 2), Some([136, 241]));
    assert_eq!(size(270, 480, 16), Some([34, 60]));
    assert_eq!(size(100, 480, 16), Some([50, 240]));
    assert_eq!(size(63, 480, 2), None);
}

#[test]
fn a_view_follows_the_size_of_the_run() {
    let mut photos = photos([0.0; 3]);
    for photo in &mut photos {
        *photo = photo.resized(8 * WIDTH, 8 * HEIGHT);
    }
    let [full_width, full_height] = [8 * WIDTH, 8 * HEIGHT];
    let mut views = Views::new(photographs(photos), [0.0; 3], 64, &Device::flex());
    let size = |views: &mut Views| {
        let (camera, truth) = views.prepare(0, None).unwrap();
        let [height, width, _] = truth.image().dims();
        assert_eq!([camera.intrinsics.width, camera.intrinsics.height], [width, height]);
        (width, height, camera.intrinsics.fx)
    };
    let (width, height, focal) = size(&mut views);
    assert_eq!([width, height], [full_width, full_height]);
    views.reduce(2);
    let half = size(&mut views);
    assert_eq!(half, (full_width / 2, full_height / 2, focal / 2.0));
    assert_eq!(size(&mut views), half, "the prepared photograph is another");
    views.reduce(1);
    assert_eq!(size(&mut views), (width, height, focal));
}

#[test]
fn photographs_that_do_not_fit_prepared_are_packed() {
    let shown = |views: &mut Views| -> Vec<f32> {
        let pictures = (0..views.len()).flat_map(|view| values_of(views.prepare(view, None).unwrap().1.image()));
        pictures.collect()
    };
    let all = |cache: usize, packs: bool| {
        let mut views = Views::new(photographs(photos([0.2; 3])), [0.2; 3], 0, &Device::flex());
        (views.cache, views.cache_left, views.packs) = (cache, cache, packs);
        let first = shown(&mut views);
        let left = views.cache_left;
        assert_eq!(shown(&mut views), first, "a kept photograph is another");
        assert_eq!(views.cache_left, left, "a photograph is counted twice");
        (first, views.kept(), views.kept_packed())
    };
    let count = photos([0.2; 3]).len();
    let (prepared, packed) = (count * 3 * PREPARED * WIDTH * HEIGHT, PackedPhoto::PIXEL * WIDTH * HEIGHT);
    let (expected, kept, kept_packed) = all(prepared, true);
    assert_eq!((kept, kept_packed), (count, 0));
    for (cache, packs, kept) in
        [(prepared - 1, true, (0, count)), (2 * packed + 1, true, (0, 2)), (packed, false, (0, 0))]
    {
        let (found, prepared, packed) = all(cache, packs);
        assert_eq!((prepared, packed), kept, "{cache} bytes");
        assert!(found.iter().zip(&expected).all(|(a, b)| (a - b).abs() <= f32::EPSILON), "{cache} bytes");
    }
}

#[test]
fn room_is_given_back_when_the_size_changes() {
    let mut views = Views::new(photographs(photos([0.0; 3])), [0.0; 3], 1, &Device::flex());
    let room = views.cache_left;
    views.prepare(0, None).unwrap();
    assert!(views.cache_left < room && views.views[0].truth.is_some());
    views.reduce(2);
    assert!(views.cache_left == room && views.views[0].truth.is_none());
}

/// Photographs that are not kept in memory, and a count of how often each was decoded.
fn forgetful(photos: &[Photo]) -> (Vec<Photograph>, Arc<Mutex<BTreeMap<String, usize>>>) {
    let counts = Arc::new(Mutex::new(BTreeMap::new()));
    let one = |photo: &Photo| {
        let (again, counts) = (photo.clone(), Arc::clone(&counts));
        Photograph::read_later(photo.into(), &Arc::default(), move || {
            *counts.lock().unwrap().entry(again.name.clone()).or_insert(0) += 1;
            Ok(again.clone())
        })
    };
    (photos.iter().map(one).collect(), counts)
}

#[test]
fn what_is_let_go_is_decoded_in_time_and_once_a_step() {
    let photos = photos([0.0; 3]);
    for cache in [0, 64] {
        let (forgetful, counts) = forgetful(&photos);
        let mut kept = Views::new(photographs(photos.clone()), [0.0; 3], 0, &Device::flex());
        let mut views = Views::new(forgetful, [0.0; 3], cache, &Device::flex());
        for divisor in [1, 2] {
            views.reduce(divisor);
            kept.reduce(divisor);
            for order in [[0, 1, 2, 3], [1, 3, 0, 2]] {
                for (at, &view) in order.iter().enumerate() {
                    views.expect(order[at..].iter().copied());
                    let shown = |views: &mut Views| values_of(views.prepare(view, None).unwrap().1.image());
                    assert_eq!(shown(&mut views), shown(&mut kept));
                    assert!(views.excluded(view).unwrap().is_none());
                }
            }
        }
        let held = views.views.iter().filter(|view| view.photo.is_some()).count();
        assert!(held <= 1, "{held} photographs are in memory");
        // Prepared photographs are decoded once for each size, the others at each visit.
        let expected = if cache > 0 { 2 } else { 4 };
        assert!(counts.lock().unwrap().values().all(|count| *count == expected), "{counts:?}");
    }
}

#[test]
fn a_picture_that_has_gone_is_an_error() {
    let photo = photos([0.0; 3]).remove(0);
    let gone = || CaptureError::Changed { name: "a".into() };
    let lost = Photograph::read_later((&photo).into(), &Arc::default(), move || Err(gone()));
    let mut views = Views::new(vec![lost], [0.0; 3], 64, &Device::flex());
    assert!(views.prepare(0, None).is_err());
    views.expect([0]);
    assert!(views.prepare(0, None).is_err());
    // A second request tries again.
    assert!(views.prepare(0, None).is_err());
}

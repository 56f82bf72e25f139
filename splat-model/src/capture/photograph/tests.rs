use std::sync::atomic::{AtomicUsize, Ordering};

use super::*;
use crate::trainer::testing::photos;

#[test]
fn what_is_not_kept_is_decoded_each_time() {
    let photo = photos([0.0; 3]).remove(0);
    let count = Arc::new(AtomicUsize::new(0));
    let (again, counted) = (photo.clone(), Arc::clone(&count));
    let read = Photograph::read_later((&photo).into(), &Arc::default(), move || {
        counted.fetch_add(1, Ordering::Relaxed);
        Ok(again.clone())
    });
    assert_eq!(count.load(Ordering::Relaxed), 0);
    for _ in 0..2 {
        assert_eq!(read.pixels().unwrap().rgb, photo.rgb);
    }
    assert_eq!(count.load(Ordering::Relaxed), 2);
    assert_eq!(read.bytes(), photo.rgb.len());
    let kept = Photograph::from(photo.clone());
    assert!(kept.is_kept() && !read.is_kept());
    assert!(Arc::ptr_eq(&kept.pixels().unwrap(), &kept.pixels().unwrap()));
}

#[test]
fn what_is_read_later_is_kept_while_there_is_room() {
    let photo = photos([0.0; 3]).remove(0);
    let count = Arc::new(AtomicUsize::new(0));
    let room = Arc::new(AtomicUsize::new(photo.rgb.len() + 1));
    let later = || {
        let (again, counted) = (photo.clone(), Arc::clone(&count));
        let Photo { name, intrinsics, cam_from_world, .. } = photo.clone();
        let facts = PhotographFacts { name, intrinsics, cam_from_world, has_alpha: false, has_mask: false };
        Photograph::read_later(facts, &room, move || {
            counted.fetch_add(1, Ordering::Relaxed);
            Ok(again.clone())
        })
    };
    let (first, second) = (later(), later());
    assert!(!first.is_kept() && count.load(Ordering::Relaxed) == 0);
    for (photograph, reads, is_kept) in [(&first, 1, true), (&second, 2, false)] {
        count.store(0, Ordering::Relaxed);
        (0..2).for_each(|_| assert_eq!(photograph.pixels().unwrap().rgb, photo.rgb));
        assert_eq!((count.load(Ordering::Relaxed), photograph.is_kept()), (reads, is_kept));
    }
    assert_eq!(room.load(Ordering::Relaxed), 1);
    let third = later();
    third.keep(&Arc::new(photo.clone()));
    assert!(!third.is_kept(), "there is no room");
    room.store(photo.rgb.len(), Ordering::Relaxed);
    third.keep(&Arc::new(photo.clone()));
    assert!(third.is_kept() && third.pixels().unwrap().rgb == photo.rgb);
}

#[test]
fn a_picture_that_has_changed_is_refused() {
    let photo = photos([0.0; 3]).remove(0);
    let smaller = photo.resized(16, 12);
    let changed = Photograph::read_later((&photo).into(), &Arc::default(), move || Ok(smaller.clone()));
    let error = changed.pixels().unwrap_err().to_string();
    assert!(error.contains(&photo.name) && error.contains("changed"), "{error}");
    let masked = Photo { mask: Some(vec![true; photo.rgb.len() / 3]), ..photo.clone() };
    let changed = Photograph::read_later((&photo).into(), &Arc::default(), move || Ok(masked.clone()));
    assert!(changed.pixels().is_err());
}

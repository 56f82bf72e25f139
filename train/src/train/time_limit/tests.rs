use super::*;

#[test]
fn times_are_read_as_people_write_them() {
    let seconds = |text: &str| parse_time(text).map(|time| time.as_secs_f64());
    for (text, expected) in [("60s", 60.0), ("10min", 600.0), ("1h 30m", 5400.0), ("500ms", 0.5)] {
        assert_eq!(seconds(text), Ok(expected), "{text}");
    }
    for text in ["", "60", "0s", "-1s", "soon", "99999999999999999999y"] {
        assert!(seconds(text).unwrap_err().contains("such as 60s"), "{text}");
    }
}

#[test]
fn a_time_is_saved_as_it_is_written() {
    let time = parse_time("1h 30m").unwrap();
    assert_eq!(parse_time(&time.to_string()), Ok(time));
}

use super::*;

#[test]
fn the_high_water_mark_is_read() {
    assert_eq!(peak_of("VmPeak:\t  9 kB\nVmHWM:\t  157286 kB\nVmRSS:\t 5 kB\n"), Some(153.6));
    assert_eq!(peak_of("VmHWM:\t many kB\n"), None);
    assert_eq!(peak_of(""), None);
}

use super::*;

#[test]
fn every_part_is_used_once_and_results_are_in_order() {
    let mut numbers = vec![0; 1000];
    for_each(numbers.chunks_mut(7), |number, part| part.iter_mut().for_each(|value| *value += number));
    assert!(numbers.iter().enumerate().all(|(i, value)| *value == i / 7));
    let parts: Vec<String> = (0..300).map(|i| i.to_string()).collect();
    let found = map_with(parts, Vec::new, |buffer: &mut Vec<usize>, number, part| {
        buffer.push(number);
        (number, part, buffer.len())
    });
    assert!(found.iter().enumerate().all(|(i, (number, part, _))| *number == i && *part == i.to_string()));
    // Tasks one after the other share a buffer: there are no more of them than threads.
    let fresh = found.iter().filter(|(.., uses)| *uses == 1).count();
    assert!(fresh <= rayon::current_num_threads() + 1, "{fresh} buffers");
}

use super::*;
use crate::testing::gpu::gpus;

#[test]
fn values_are_scaled_in_place() {
    for (form, gpu) in gpus() {
        let values: Vec<f32> = (0..1000).map(|i| i as f32 - 400.5).collect();
        let buffer = Buffer::from_slice(&gpu, &values);
        launch_scale(&gpu, &buffer, &Buffer::from_slice(&gpu, &[-0.75]));
        let expected: Vec<f32> = values.iter().map(|value| -0.75 * value).collect();
        assert_eq!(buffer.read(&gpu), expected, "{form}");
        launch_scale(&gpu, &Buffer::new(&gpu, 0), &buffer);
    }
}

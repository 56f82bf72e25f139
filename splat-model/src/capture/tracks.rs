//! Tracks: the observations of sparse points in photographs.

/// One observation of a point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Observation {
    /// Index into [`Capture::views`](super::Capture::views).
    pub view: usize,
    /// Position in the picture, px at the size of the file; finite.
    pub at_px: [f32; 2],
}

/// Observations and reprojection error of each point, in the order of the point cloud.
///
/// Tracks are evidence and may be incomplete: an element that names a photograph or keypoint that the model lacks is dropped.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Tracks {
    observations: Vec<Observation>,
    /// End of each point's observations.
    ends: Vec<usize>,
    stated_errors_px: Vec<Option<f32>>,
}

impl Tracks {
    /// Adds the next point: its observations and the file's reprojection error, px.
    pub fn push(&mut self, observations: impl IntoIterator<Item = Observation>, stated_error_px: f64) {
        let is_finite = |observation: &Observation| observation.at_px.iter().all(|px| px.is_finite());
        self.observations.extend(observations.into_iter().filter(is_finite));
        self.ends.push(self.observations.len());
        // COLMAP writes −1 for an unmeasured error.
        let measured = stated_error_px.is_finite() && stated_error_px >= 0.0;
        self.stated_errors_px.push(measured.then_some(stated_error_px as f32));
    }

    /// The tracks of some points, in this order, in the views that have a place among others.
    pub(super) fn picked(&self, points: impl IntoIterator<Item = usize>, place: &[Option<usize>]) -> Self {
        let mut picked = Self::default();
        for point in points {
            let placed =
                self.of(point).iter().filter_map(|seen| Some(Observation { view: place[seen.view]?, ..*seen }));
            picked.push(placed, self.stated_error_px(point).map_or(-1.0, f64::from));
        }
        picked
    }

    /// The tracks with each observation replaced.
    pub(super) fn moved(self, to: impl Fn(&Observation) -> Observation) -> Self {
        Self { observations: self.observations.iter().map(to).collect(), ..self }
    }

    /// The observations of a point of the cloud; empty for an index out of range.
    pub fn of(&self, point: usize) -> &[Observation] {
        let Some(&end) = self.ends.get(point) else { return &[] };
        let start = if point == 0 { 0 } else { self.ends[point - 1] };
        &self.observations[start..end]
    }

    /// The mean reprojection error that the file states for a point, px.
    pub fn stated_error_px(&self, point: usize) -> Option<f32> {
        self.stated_errors_px.get(point).copied().flatten()
    }

    /// All observations of all points.
    pub fn observations(&self) -> usize {
        self.observations.len()
    }
}

#[cfg(test)]
mod tests;

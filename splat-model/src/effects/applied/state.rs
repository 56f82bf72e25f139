//! What the effects of a run have to keep.

use burn::tensor::Device;

use super::Applied;
use crate::state::{State, StateError};

impl Applied {
    /// What each has learnt.
    ///
    /// # Errors
    /// None that is to be expected.
    pub fn save(&self) -> Result<State, StateError> {
        // What is known of depths does not change.
        let Self { smoothing, poses, optics, behind, exposure, grids, depths: _ } = self;
        let mut state = State::default();
        let mut keep = |name: &str, save: &dyn Fn(&mut State) -> Result<(), StateError>| -> Result<(), StateError> {
            let mut part = State::default();
            save(&mut part)?;
            state.put_part(name, part);
            Ok(())
        };
        if let Some(smoothing) = smoothing {
            keep("smoothing", &|part| smoothing.save(part))?;
        }
        if let Some(poses) = poses {
            keep("poses", &|part| poses.save(part))?;
        }
        if let Some(optics) = optics {
            keep("optics", &|part| optics.save(part))?;
        }
        if let Some(behind) = behind {
            keep("behind", &|part| behind.save(part))?;
        }
        if let Some(exposure) = exposure {
            keep("exposure", &|part| exposure.save(part))?;
        }
        if let Some(grids) = grids {
            keep("grids", &|part| grids.save(part))?;
        }
        Ok(state)
    }

    /// Goes on from what the same effects had learnt.
    ///
    /// # Errors
    /// If something is missing, of another shape, or of an effect that is not on.
    pub fn load(&mut self, mut from: State, device: &Device) -> Result<(), StateError> {
        let Self { smoothing, poses, optics, behind, exposure, grids, depths: _ } = self;
        let mut part = |name: &str, load: &mut dyn FnMut(&mut State) -> Result<(), StateError>| {
            let mut part = from.take_part(name);
            load(&mut part)?;
            part.finish()
        };
        if let Some(smoothing) = smoothing {
            part("smoothing", &mut |part| smoothing.load(part, device))?;
        }
        if let Some(poses) = poses {
            part("poses", &mut |part| poses.load(part))?;
        }
        if let Some(optics) = optics {
            part("optics", &mut |part| optics.load(part))?;
        }
        if let Some(behind) = behind {
            part("behind", &mut |part| behind.load(part))?;
        }
        if let Some(exposure) = exposure {
            part("exposure", &mut |part| exposure.load(part))?;
        }
        if let Some(grids) = grids {
            part("grids", &mut |part| grids.load(part))?;
        }
        from.finish()
    }
}

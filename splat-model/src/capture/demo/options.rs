//! What is asked of the demo capture.

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

use super::DemoError;

/// What the demo capture holds: its size, and which effects its photographs show. Without effects every photograph is a sharp,
/// opaque pinhole's view of a matte scene at one exposure, and the model that is written is exact.
///
/// Each effect is a switch. They are independent: any of them combine, and each then has the same magnitude, except for two
/// pairs that are refused: `lens` with `fisheye`, as a photograph is taken through one lens, and `far` with `alpha`, which
/// would make transparent what `far` moves away. Every eighth photograph by name is *held out* (see
/// [`DemoOptions::held_out`]): what spoils single photographs (`graded`, `masks`, `poses`, `motion`, `defocus`) leaves it alone, as it
/// is what a scene's quality is judged by.
///
/// With `poses`, `motion`, `rolling` or `defocus`, a file `truth.json` says what was done to each photograph; see [`super::write`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct DemoOptions {
    /// Width of the pictures, 16 to 4096 px.
    pub width: usize,
    /// Height of the pictures, 16 to 4096 px.
    pub height: usize,
    /// How many pictures, 2 to 9999.
    pub views: usize,
    /// How many sparse points, at most 1,000,000.
    pub points: usize,
    /// One sphere reflects its surroundings and the sun, and all else but ground and sky has a soft highlight, so that colours
    /// depend on the view.
    pub glossy: bool,
    /// Each photograph has its own exposure and white balance: a gain per channel on its light, up to
    /// [`DemoOptions::EXPOSURE_STOPS`] either way.
    pub exposure: bool,
    /// Each photograph that is not held out is processed as phones do, place by place: its light is multiplied by a gain per channel
    /// that grows across the picture, to about [`DemoOptions::GRADE_STOPS`] in a corner, and as much less in the opposite one; and
    /// its stored values are raised to a power that grows in another direction, see [`DemoOptions::GRADE_TONE`].
    pub graded: bool,
    /// The photographs are taken through a lens of COLMAP's model `OPENCV`, a barrel that is a little out of line, which moves
    /// the corners by up to [`DemoOptions::LENS_SHARE`] of the width.
    pub lens: bool,
    /// The photographs are taken through an equidistant fisheye (`OPENCV_FISHEYE` without coefficients) that sees
    /// [`DemoOptions::FISHEYE_FOV_DEG`] along the longer side of the picture.
    pub fisheye: bool,
    /// In each photograph that is not held out, [`DemoOptions::MASKED_PLACES`] bright discs cover places of the scene, other
    /// places in other colours each time; `masks/<name>` is black there and up to [`DemoOptions::MASK_MARGIN_PX`] around them.
    pub masks: bool,
    /// The ground and the sky are transparent in the photographs, which have straight alpha; no sparse point lies there. Objects
    /// and platform are lit as ever.
    pub alpha: bool,
    /// A third of the photographs is taken from [`DemoOptions::ZOOM_NEAR`] of the usual distance to what they look at, and a
    /// third from [`DemoOptions::ZOOM_FAR`] times as far, with the same focal length. Of three held-out photographs in
    /// succession each is of another third. The ground and the sky reach five times as far, to hold the cameras.
    pub zoom: bool,
    /// The poses in the model are wrong, except those of held-out photographs: turned by [`DemoOptions::POSE_ANGLE_DEG`] about
    /// a random axis and moved by [`DemoOptions::POSE_SHARE`] of the scene's extent (that of the cameras, see
    /// [`scene_extent`](crate::optim::scene_extent)) in a random direction. Points and tracks are exact.
    pub poses: bool,
    /// Beyond the ground lies a landscape with a sky, [`DemoOptions::FAR_RADIUS`] away, instead of a sky at 8 scene units. The
    /// cameras stand lower, so that all of them see it.
    pub far: bool,
    /// Two of every five photographs that are not held out are taken by a camera that moves: things at the distance of what it
    /// looks at are smeared over [`DemoOptions::MOTION_SHARE`] of the width, in a direction of its own. Half of that the
    /// camera moves on a straight line, half it turns, both steadily; its pose is that of the middle of the exposure.
    pub motion: bool,
    /// The cameras of photographs that are not held out move in the same manner while its picture is read from the first row to the last, by
    /// [`DemoOptions::ROLLING_SHARE`] of the width; each row is exposed at its own time. Its pose is that of the middle row, and
    /// the tracks say where the pictures show the points.
    pub rolling: bool,
    /// The photographs that are not held out are taken through a thin lens with an aperture of
    /// [`DemoOptions::APERTURE_RADIUS`], focused at [`DemoOptions::FOCUS_SHARE`] of the distance to what they look at, so that
    /// the far side of the platform, and from low down the near one too, has circles of confusion of 4 to 12 px at a width of
    /// 240 px.
    pub defocus: bool,
    /// Each photograph has an exact depth map, `depth/<name>`; see [`super::write`].
    pub depth: bool,
    /// Varies the cameras, the choice of points, and what each effect draws by lot.
    pub seed: u64,
}

impl DemoOptions {
    /// 48 photographs of 240 × 180 px, no effects.
    pub const PLAIN: Self = Self {
        width: 240,
        height: 180,
        views: 48,
        points: 6000,
        glossy: false,
        exposure: false,
        graded: false,
        lens: false,
        fisheye: false,
        masks: false,
        alpha: false,
        zoom: false,
        poses: false,
        far: false,
        motion: false,
        rolling: false,
        defocus: false,
        depth: false,
        seed: 0,
    };

    /// Stops of light by which gains differ from one at most.
    pub const EXPOSURE_STOPS: f64 = 0.75;
    /// Stops of light by which a corner of a graded photograph is brighter, on average over the photographs; half as much to one and a
    /// half times as much for each channel of each.
    pub const GRADE_STOPS: f64 = 1.0;
    /// Powers to which stored values are raised are two to the powers −this to this, from corner to corner.
    pub const GRADE_TONE: f64 = 0.75;
    /// By how much of the width the lens moves the corner that it moves most, about, in pictures of 4 to 3.
    pub const LENS_SHARE: f64 = 0.04;
    /// What the fisheye sees along the longer side of a picture, degrees.
    pub const FISHEYE_FOV_DEG: f64 = 120.0;
    /// Discs that cover the scene in a photograph.
    pub const MASKED_PLACES: usize = 4;
    /// Their diameters, least and largest, by the width of the picture.
    pub const MASKED_SIZE: [f64; 2] = [0.15, 0.35];
    /// How far around a disc pixels are excluded, px, from their middles: more than the half diagonal of a pixel, so that no
    /// pixel that shows some of the disc counts.
    pub const MASK_MARGIN_PX: f64 = 1.5;
    /// The distance of near photographs, by the usual one.
    pub const ZOOM_NEAR: f64 = 1.0 / 3.0;
    /// The distance of far photographs, by the usual one.
    pub const ZOOM_FAR: f64 = 3.5;
    /// Angle by which poses are wrong, degrees.
    pub const POSE_ANGLE_DEG: f64 = 1.0;
    /// Distance by which poses are wrong, by the scene's extent.
    pub const POSE_SHARE: f64 = 0.01;
    /// Radius of the landscape and its sky, scene units: a hundred times the usual distance of the cameras.
    pub const FAR_RADIUS: f64 = 450.0;
    /// Length of the smear, by the width of the picture: 12 px at 240 px.
    pub const MOTION_SHARE: f64 = 0.05;
    /// What the camera's motion moves from the first row to the last, by the width of the picture: 12 px at 240 px.
    pub const ROLLING_SHARE: f64 = 0.05;
    /// Radius of the aperture, scene units.
    pub const APERTURE_RADIUS: f64 = 0.16;
    /// Distance of the plane in focus, by that of what a photograph looks at.
    pub const FOCUS_SHARE: f64 = 0.81;
    /// Scene units per level of a depth map.
    pub const DEPTH_SCALE: f64 = 0.001;
    /// Every so many photographs, from the first on, one is held out: the split that [`Split::every`](crate::capture::Split)
    /// makes by default.
    pub const HELD_OUT_EVERY: usize = 8;

    /// Whether a photograph, by its index, is one to judge a scene by and not to train on.
    pub const fn held_out(view: usize) -> bool {
        view.is_multiple_of(Self::HELD_OUT_EVERY)
    }

    /// A stream of random numbers; those of different streams have nothing to do with each other, so that no effect changes
    /// what another draws.
    pub(super) fn random(&self, stream: Stream) -> ChaCha8Rng {
        let mut random = ChaCha8Rng::seed_from_u64(self.seed);
        random.set_stream(stream as u64);
        random
    }

    /// Whether `truth.json` is written.
    pub(super) fn has_truth(&self) -> bool {
        self.poses || self.motion || self.rolling || self.defocus
    }

    pub(super) fn check(&self) -> Result<(), DemoError> {
        let within = |field, found: usize, low: usize, high: usize, expected| match found >= low && found <= high {
            true => Ok(()),
            false => Err(DemoError::Option { field, found, expected }),
        };
        within("width", self.width, 16, 4096, "16 to 4096 px")?;
        within("height", self.height, 16, 4096, "16 to 4096 px")?;
        within("views", self.views, 2, 9999, "2 to 9999")?;
        within("points", self.points, 0, 1_000_000, "at most 1,000,000")?;
        let apart = |pair: [(&'static str, bool); 2], reason| match pair {
            [(first, true), (second, true)] => Err(DemoError::Conflict { first, second, reason }),
            _ => Ok(()),
        };
        apart([("lens", self.lens), ("fisheye", self.fisheye)], "a photograph is taken through one lens")?;
        apart([("far", self.far), ("alpha", self.alpha)], "the surroundings cannot be far away and transparent")
    }
}

impl Default for DemoOptions {
    fn default() -> Self {
        Self::PLAIN
    }
}

/// Who draws random numbers.
#[derive(Clone, Copy, Debug)]
pub(super) enum Stream {
    Cameras = 0,
    Points = 1,
    Exposures = 2,
    Discs = 3,
    Poses = 4,
    Motion = 5,
    Rolling = 6,
    Grades = 7,
}

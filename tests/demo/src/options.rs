//! Options of the demo capture.

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use serde::Serialize;

use super::DemoError;

/// The size of the demo capture, and the effects that its photographs show. Without effects every photograph is a sharp,
/// opaque pinhole view of a matte scene at one exposure, and the written model is exact.
///
/// Each effect is a switch. Effects are independent: they combine freely and keep their magnitude, except for two
/// pairs that are refused: `lens` with `fisheye`, because a photograph has one lens, and `far` with `alpha`, which
/// would make transparent what `far` moves away. Every eighth photograph by name is *held out* (see
/// [`DemoOptions::held_out`]): effects that spoil single photographs (`graded`, `masks`, `poses`, `motion`) spare it, because it
/// measures a scene's quality.
///
/// As options of a command line these are the switches; who reads them sets the sizes and the seed.
///
/// With `poses`, `motion` or `rolling`, a file `truth.json` says what was done to each photograph; see [`super::write`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, clap::Args)]
pub struct DemoOptions {
    /// Width of the pictures, 16 to 4096 px.
    #[arg(skip = Self::PLAIN.width)]
    pub width: usize,
    /// Height of the pictures, 16 to 4096 px.
    #[arg(skip = Self::PLAIN.height)]
    pub height: usize,
    /// Number of pictures, 2 to 9999.
    #[arg(skip = Self::PLAIN.views)]
    pub views: usize,
    /// Number of sparse points, at most 1,000,000.
    #[arg(skip = Self::PLAIN.points)]
    pub points: usize,
    /// One sphere reflects its surroundings and the sun, and all else but ground and sky has a soft highlight, so that colours
    /// depend on the view.
    #[arg(long, help = "Make one object a mirror, and give all others a glossy coat")]
    pub glossy: bool,
    /// Each photograph has its own exposure and white balance: a gain per channel on its light, up to
    /// [`DemoOptions::EXPOSURE_STOPS`] either way.
    #[arg(long, help = "Give each photograph its own exposure and white balance")]
    pub exposure: bool,
    /// Each photograph that is not held out is processed as phones do, place by place: its light is multiplied by a gain per channel
    /// that grows across the picture, to about [`DemoOptions::GRADE_STOPS`] in a corner, and as much less in the opposite one; and
    /// its stored values are raised to a power that grows in another direction, see [`DemoOptions::GRADE_TONE`].
    #[arg(long, help = "Vary brightness, white balance and tone across each training photograph, as phones do")]
    pub graded: bool,
    /// The photographs are taken through a lens of COLMAP's model `OPENCV`, a barrel that is a little out of line, which moves
    /// the corners by up to [`DemoOptions::LENS_SHARE`] of the width.
    #[arg(long, help = "Use a lens that bends straight lines (OPENCV): corners move by 4% of the width")]
    pub lens: bool,
    /// The photographs are taken through an equidistant fisheye (`OPENCV_FISHEYE` without coefficients) that sees
    /// [`DemoOptions::FISHEYE_FOV_DEG`] along the longer side of the picture.
    #[arg(long, help = "Use an equidistant fisheye lens (OPENCV_FISHEYE) of 120 degrees; not with --lens")]
    pub fisheye: bool,
    /// In each photograph that is not held out, [`DemoOptions::MASKED_PLACES`] bright discs cover places of the scene, other
    /// places in other colours each time; `masks/<name>` is black there and up to [`DemoOptions::MASK_MARGIN_PX`] around them.
    #[arg(
        long,
        help = "Cover four places of each training photograph with bright discs, and write masks that exclude them"
    )]
    pub masks: bool,
    /// The ground and the sky are transparent in the photographs, which have straight alpha; no sparse point lies there. Objects
    /// and platform keep their lighting.
    #[arg(long, help = "Make the ground and the sky transparent; not with --far")]
    pub alpha: bool,
    /// A third of the photographs is taken from [`DemoOptions::ZOOM_NEAR`] of the usual distance to what they look at, and a
    /// third from [`DemoOptions::ZOOM_FAR`] times as far, with the same focal length. Of three held-out photographs in
    /// succession each is of another third. The ground and the sky reach five times as far, to hold the cameras.
    #[arg(
        long,
        help = "Take a third of the photographs from a third of the distance, and a third from 3.5 times as far"
    )]
    pub zoom: bool,
    /// The poses in the model are wrong, except those of held-out photographs: turned by [`DemoOptions::POSE_ANGLE_DEG`] about
    /// a random axis and moved by [`DemoOptions::POSE_SHARE`] of the scene's extent (that of the cameras, see
    /// [`scene_extent`](splat_model::optim::scene_extent)) in a random direction. Points and tracks are exact.
    #[arg(long, help = "Perturb the poses of the training photographs: by 1 degree and 1% of the scene extent")]
    pub poses: bool,
    /// Beyond the ground lies a landscape with a sky, [`DemoOptions::FAR_RADIUS`] away, instead of a sky at 8 scene units. The
    /// cameras stand lower, so that all of them see it.
    #[arg(
        long,
        help = "Surround the scene with a landscape and a sky, a hundred times as far away as the cameras, which are placed \
                lower to see it"
    )]
    pub far: bool,
    /// Two of every five photographs that are not held out are taken by a camera that moves: things at the distance of what it
    /// looks at are smeared over [`DemoOptions::MOTION_SHARE`] of the width, in a direction of its own. Half of that the
    /// camera moves on a straight line, half it turns, both steadily; its pose is that of the middle of the exposure.
    #[arg(
        long,
        help = "Move the camera during the exposure of two fifths of the training photographs, by 5% of the width"
    )]
    pub motion: bool,
    /// The cameras of photographs that are not held out move in the same manner while its picture is read from the first row to the last, by
    /// [`DemoOptions::ROLLING_SHARE`] of the width; each row is exposed at its own time. Its pose is that of the middle row, and
    /// the tracks say where the pictures show the points.
    #[arg(
        long,
        help = "Move the camera while the rows of each training photograph are read out one after the other, by 5% of the width"
    )]
    pub rolling: bool,
    /// Each photograph has an exact depth map, `depth/<name>`; see [`super::write`].
    #[arg(long, help = "Write an exact depth map for each photograph: 16-bit PNG, 0.001 scene units a level")]
    pub depth: bool,
    /// A town of 400 m instead of the still life, in metres, z up: streets every 100 m, houses around courtyards, trees. Four of
    /// five photographs are taken from the streets, one from above the roofs. It excludes all effects.
    #[arg(
        long,
        help = "Photograph a town of 400 m instead: streets, houses that hide each other, trees; without effects. For captures \
                that are trained in blocks"
    )]
    pub town: bool,
    /// Varies the cameras, the choice of points, and what each effect draws by lot.
    #[arg(skip)]
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
        depth: false,
        town: false,
        seed: 0,
    };

    /// The town: 240 photographs of 160 × 120 px, a street photograph every 21 m.
    pub const TOWN: Self = Self { town: true, width: 160, height: 120, views: 240, points: 20_000, ..Self::PLAIN };

    /// Largest deviation of a gain from one, stops of light.
    pub const EXPOSURE_STOPS: f64 = 0.75;
    /// Stops of light by which a corner of a graded photograph is brighter, on average over the photographs; half as much to one and a
    /// half times as much for each channel of each.
    pub const GRADE_STOPS: f64 = 1.0;
    /// Exponent range of the tone curve: stored values are raised to 2^(−this) in one corner and 2^this in the opposite one.
    pub const GRADE_TONE: f64 = 0.75;
    /// Approximate displacement of the most displaced corner, as a share of the width, in 4:3 pictures.
    pub const LENS_SHARE: f64 = 0.04;
    /// Field of view of the fisheye along the longer side of a picture, degrees.
    pub const FISHEYE_FOV_DEG: f64 = 120.0;
    /// Discs that cover the scene in a photograph.
    pub const MASKED_PLACES: usize = 4;
    /// Smallest and largest diameter of the discs, as a share of the width.
    pub const MASKED_SIZE: [f64; 2] = [0.15, 0.35];
    /// Width of the excluded margin around a disc, px, measured to pixel centres: more than half a pixel's diagonal, so that no
    /// pixel that shows part of the disc counts.
    pub const MASK_MARGIN_PX: f64 = 1.5;
    /// Distance of near photographs relative to the usual one.
    pub const ZOOM_NEAR: f64 = 1.0 / 3.0;
    /// Distance of far photographs relative to the usual one.
    pub const ZOOM_FAR: f64 = 3.5;
    /// Error of the poses' rotation, degrees.
    pub const POSE_ANGLE_DEG: f64 = 1.0;
    /// Error of the poses' position, as a share of the scene's extent.
    pub const POSE_SHARE: f64 = 0.01;
    /// Radius of the landscape and its sky, scene units: a hundred times the usual distance of the cameras.
    pub const FAR_RADIUS: f64 = 450.0;
    /// Length of the motion blur as a share of the width: 12 px at 240 px.
    pub const MOTION_SHARE: f64 = 0.05;
    /// Displacement from the first row to the last as a share of the width: 12 px at 240 px.
    pub const ROLLING_SHARE: f64 = 0.05;
    /// Scene units per level of a depth map.
    pub const DEPTH_SCALE: f64 = 0.001;
    /// Interval of held-out photographs, starting with the first: the split that [`Split::every`](splat_model::capture::Split)
    /// makes by default.
    pub const HELD_OUT_EVERY: usize = 8;

    /// Whether the photograph of an index is held out for testing.
    pub const fn held_out(view: usize) -> bool {
        view.is_multiple_of(Self::HELD_OUT_EVERY)
    }

    /// A stream of random numbers. Streams are independent, so that no effect changes
    /// the draws of another.
    pub(super) fn random(&self, stream: Stream) -> ChaCha8Rng {
        let mut random = ChaCha8Rng::seed_from_u64(self.seed);
        random.set_stream(stream as u64);
        random
    }

    /// Whether `truth.json` is written.
    pub(super) fn has_truth(&self) -> bool {
        self.poses || self.motion || self.rolling
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
        let effects = [
            ("glossy", self.glossy),
            ("exposure", self.exposure),
            ("graded", self.graded),
            ("lens", self.lens),
            ("fisheye", self.fisheye),
            ("masks", self.masks),
            ("alpha", self.alpha),
            ("zoom", self.zoom),
            ("poses", self.poses),
            ("far", self.far),
            ("motion", self.motion),
            ("rolling", self.rolling),
            ("depth", self.depth),
        ];
        for effect in effects {
            apart([("town", self.town), effect], "the town has plain photographs")?;
        }
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
    Town = 8,
}

//! Albedo of the town's surfaces, linear RGB, as a function of the position in the world, m. No feature is finer than 0.3 m,
//! about 1.2 px at 25 m in the default pictures.

use glam::{DVec2, DVec3};

use super::super::texture::{edge, lattice, mix, rough, smoothstep, srgb};
use super::{BETWEEN_STREETS, HALF, HALF_STREET};

/// Half of the width of the transition between two colours, m.
const SOFT: f64 = 0.15;

/// Who painted a thing.
#[derive(Clone, Copy, Debug)]
pub(super) enum Paint {
    /// Walls with windows, and a roof.
    House {
        seed: i64,
    },
    Trunk,
    /// Leaves.
    Crown {
        seed: i64,
    },
}

const WALLS: [u32; 8] = [0xd9c7a3, 0xc98f6b, 0xe3d9c8, 0xb5b8b1, 0xc7a97a, 0x9fb0b8, 0xd8b2a0, 0xa8664e];
const ROOFS: [u32; 4] = [0x9c4f3a, 0x6d4238, 0x5b5f66, 0x84603f];

impl Paint {
    /// The colour at a position with this unit normal.
    pub fn colour(self, position: DVec3, normal: DVec3) -> DVec3 {
        match self {
            Self::House { seed } if normal.z > 0.1 => roof(seed, position),
            Self::House { seed } => wall(seed, position, normal),
            Self::Trunk => srgb(0x5a4632) * (0.7 + 0.5 * rough(2.0 * position)),
            Self::Crown { seed } => {
                let leaf = rough(1.6 * position + DVec3::splat(seed as f64 % 97.0));
                mix([srgb(0x27451f), srgb(0x83a050)], smoothstep(0.25, 0.75, leaf))
            }
        }
    }
}

/// A number from 0 to 1 that a house draws.
fn drawn(seed: i64, what: i64) -> f64 {
    lattice(seed, what, 17)
}

fn chosen(palette: &[u32], share: f64) -> DVec3 {
    // `share` may be 1.
    srgb(palette[((share * palette.len() as f64) as usize).min(palette.len() - 1)])
}

fn roof(seed: i64, p: DVec3) -> DVec3 {
    let rows = 0.5 + 0.5 * (std::f64::consts::TAU * p.z / 1.2).sin();
    chosen(&ROOFS, drawn(seed, 1)) * (0.55 + 0.2 * rows + 0.6 * rough(0.9 * p))
}

fn wall(seed: i64, p: DVec3, normal: DVec3) -> DVec3 {
    let along = if normal.x.abs() > normal.y.abs() { p.y } else { p.x };
    let (wide, tall) = (2.4 + drawn(seed, 2), 3.2);
    let at = DVec2::new(along / wide + drawn(seed, 3), (p.z - 0.4) / tall);
    let cell = at.floor();
    let from_middle = (at - cell - 0.5) * DVec2::new(wide, tall);
    let outside = (from_middle.abs() - DVec2::new(0.3 * wide, 0.9)).max_element();
    let plaster = chosen(&WALLS, drawn(seed, 4)) * (0.65 + 0.6 * rough(0.45 * p + DVec3::splat(drawn(seed, 5))));
    let frame = mix([srgb(0xf0ece2), srgb(0x4b5a50)], smoothstep(0.45, 0.55, drawn(seed, 6)));
    let glass = mix([srgb(0x1d2a38), srgb(0x7d95a6)], lattice(cell.x as i64, cell.y as i64, seed));
    let framed = plaster.lerp(frame, edge(0.3 - outside, SOFT));
    let window = framed.lerp(glass, edge(-outside, SOFT));
    window.lerp(srgb(0x77726a) * (0.7 + 0.5 * rough(1.2 * p)), edge(0.9 - p.z, SOFT))
}

/// The ground: carriageways with dashes, pavements, lawns, and fields beyond the town.
pub(super) fn ground(p: DVec3) -> DVec3 {
    let from_middle = |x: f64| (x - BETWEEN_STREETS * (x / BETWEEN_STREETS).round()).abs();
    let (x, y) = (from_middle(p.x), from_middle(p.y));
    let beyond = p.truncate().abs().max_element() - HALF - HALF_STREET;
    if beyond > SOFT {
        let plot = lattice((p.x / 45.0).floor() as i64, (p.y / 45.0).floor() as i64, 3);
        let furrows = 0.75 + 0.5 * rough(DVec3::new(0.25 * p.x, 0.08 * p.y, 4.0));
        return mix([srgb(0x6d8a3f), srgb(0xc2ab66)], plot) * furrows;
    }
    let lawn = mix([srgb(0x47702f), srgb(0x94a650)], smoothstep(0.25, 0.75, rough(0.5 * p)));
    let slab = lattice((p.x / 1.5).floor() as i64, (p.y / 1.5).floor() as i64, 5);
    let pavement = mix([srgb(0x9d978c), srgb(0xbab2a4)], slab) * (0.8 + 0.3 * rough(0.8 * p));
    let asphalt = srgb(0x55565a) * (0.7 + 0.6 * rough(0.6 * p));
    // The nearest street's middle, and the position along it.
    let (across, along) = if x < y { (x, p.y) } else { (y, p.x) };
    let dash = edge(0.25 - across, SOFT) * edge(1.5 - (along.rem_euclid(7.0) - 3.5).abs(), SOFT);
    let crossing = x.max(y) < HALF_STREET;
    let road = asphalt.lerp(srgb(0xe8e6df), if crossing { 0.0 } else { dash });
    road.lerp(pavement, edge(across - 5.0, SOFT)).lerp(lawn, edge(across - HALF_STREET, SOFT))
}

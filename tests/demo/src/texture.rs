//! Procedural textures: the albedo of a surface, linear RGB, as a function of the position in the
//! object's frame. No feature is finer than about 0.05 scene units, some 3 px in the default pictures, so that
//! the photographs can resolve them.

use std::f64::consts::{PI, TAU};

use glam::{DVec2, DVec3};

/// Width of the transition between two colours, scene units.
const SOFT: f64 = 0.014;

/// A pattern.
#[derive(Clone, Copy, Debug)]
pub(super) enum Texture {
    /// Wood in rings around an axis beside the object, seen on the platform.
    Wood,
    /// Stone tiles that turn to grass further out.
    Garden,
    /// Square checks of `side` on each face.
    Checks { side: f64, colours: [DVec3; 2] },
    /// Continents and clouds.
    Planet,
    /// Stripes that wind around the z axis, `turns_per_unit` of them per unit of height.
    Helix { stripes: f64, turns_per_unit: f64, colours: [DVec3; 2] },
    /// All hues around the z axis, in `segments` pieces with light seams.
    Rainbow { segments: f64 },
    /// Stripes that wind around the tube of a torus of this `major` radius.
    Twist { major: f64, stripes: f64, colours: [DVec3; 2] },
    /// Dots in the directions of a dodecahedron's and an icosahedron's corners.
    Dots { colours: [DVec3; 2] },
    /// Veins in stone.
    Marble { scale: f64, colours: [DVec3; 2] },
    /// The sky with clouds and hills below; a colour of light, not of a surface.
    Sky,
    /// As `Sky`, with more detail, and with fields and woods below the horizon.
    Vista,
}

impl Texture {
    /// The colour at a position in the object's frame, with the unit normal in the same frame.
    pub fn colour(&self, position: DVec3, normal: DVec3) -> DVec3 {
        match *self {
            Texture::Wood => wood(position),
            Texture::Garden => garden(position),
            Texture::Checks { side, colours } => checks(face_coordinates(position, normal), side, colours),
            Texture::Planet => planet(position),
            Texture::Helix { stripes, turns_per_unit, colours } => {
                let angle = position.y.atan2(position.x);
                // On the caps the stripes end in a disc of a single colour.
                let wave = if normal.z.abs() > 0.5 {
                    1.0
                } else {
                    (stripes * angle + TAU * turns_per_unit * position.z).sin()
                };
                mix(colours, edge(wave, 0.25))
            }
            Texture::Rainbow { segments } => rainbow(position, segments),
            Texture::Twist { major, stripes, colours } => {
                let around_tube = position.z.atan2(position.truncate().length() - major);
                let around_axis = position.y.atan2(position.x);
                mix(colours, edge((stripes * around_axis + 2.0 * around_tube).sin(), 0.25))
            }
            Texture::Dots { colours } => dots(position.normalize_or_zero(), colours),
            Texture::Marble { scale, colours } => marble(scale * position, colours),
            Texture::Sky => sky(position.normalize_or_zero()),
            Texture::Vista => vista(position.normalize_or_zero()),
        }
    }
}

/// Linear RGB of a display-referred colour `0xRRGGBB`, gamma 2.
///
/// A square instead of the power 2.2 makes it a constant, because textures name colours for every sample.
pub(super) const fn srgb(hex: u32) -> DVec3 {
    const fn channel(byte: u32) -> f64 {
        let display = (byte & 0xff) as f64 / 255.0;
        display * display
    }
    DVec3::new(channel(hex >> 16), channel(hex >> 8), channel(hex))
}

pub(super) fn mix(colours: [DVec3; 2], share: f64) -> DVec3 {
    colours[0].lerp(colours[1], share)
}

/// 0 to 1 as `value` goes from `low` to `high`, flat at both ends.
pub(super) fn smoothstep(low: f64, high: f64, value: f64) -> f64 {
    let x = ((value - low) / (high - low)).clamp(0.0, 1.0);
    x * x * (3.0 - 2.0 * x)
}

/// A soft step at zero.
pub(super) fn edge(value: f64, width: f64) -> f64 {
    smoothstep(-width, width, value)
}

/// A number from 0 to 1 for each corner of the lattice.
pub(super) fn lattice(x: i64, y: i64, z: i64) -> f64 {
    let mut bits = (x as u64).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    bits ^= (y as u64).wrapping_mul(0xc2b2_ae3d_27d4_eb4f);
    bits ^= (z as u64).wrapping_mul(0x1656_67b1_9e37_79f9);
    // The finaliser of SplitMix64 (Steele, Lea and Flood 2014).
    bits = (bits ^ (bits >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    bits = (bits ^ (bits >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    (bits ^ (bits >> 31)) as f64 / u64::MAX as f64
}

/// Smooth noise from 0 to 1 whose features are one unit large.
fn noise(p: DVec3) -> f64 {
    let cell = p.floor();
    let f = p - cell;
    let w = f * f * f * (f * (6.0 * f - 15.0) + 10.0);
    let (x, y, z) = (cell.x as i64, cell.y as i64, cell.z as i64);
    let along_x = |dy, dz| {
        let (a, b) = (lattice(x, y + dy, z + dz), lattice(x + 1, y + dy, z + dz));
        a + w.x * (b - a)
    };
    let along_y = |dz| {
        let (a, b) = (along_x(0, dz), along_x(1, dz));
        a + w.y * (b - a)
    };
    let (a, b) = (along_y(0), along_y(1));
    a + w.z * (b - a)
}

/// Two octaves of [`noise`].
pub(super) fn rough(p: DVec3) -> f64 {
    // The odd factor and the shift keep the lattices of the octaves apart.
    (2.0 * noise(p) + noise(2.03 * p + DVec3::splat(17.3))) / 3.0
}

fn wood(p: DVec3) -> DVec3 {
    let bend = 0.35 * noise(1.3 * p) + 0.08 * noise(4.0 * p);
    let from_pith = (p.truncate() - DVec2::new(-0.7, 2.9)).length() + bend;
    let ring = (TAU * 4.0 * from_pith).sin();
    let grain = noise(DVec3::new(6.0 * p.x, 6.0 * p.y, 2.0));
    let timber = mix([srgb(0xb98552), srgb(0x8a5a30)], smoothstep(-0.6, 1.0, ring));
    let rim = edge(p.truncate().length() - 1.86, 2.0 * SOFT);
    (timber * (0.82 + 0.3 * grain)).lerp(srgb(0x5d3a20), rim)
}

fn garden(p: DVec3) -> DVec3 {
    let shore = p.truncate().length() + 0.5 * noise(1.5 * p);
    match smoothstep(3.55, 3.7, shore) {
        // Noise is slow, and most points lie clearly on one side.
        0.0 => tiles(p),
        1.0 => meadow(p),
        share => tiles(p).lerp(meadow(p), share),
    }
}

fn meadow(p: DVec3) -> DVec3 {
    mix([srgb(0x4c7a34), srgb(0x8da648)], smoothstep(0.25, 0.75, rough(1.6 * p)))
}

fn tiles(p: DVec3) -> DVec3 {
    const SIDE: f64 = 0.55;
    let cell = (p.truncate() / SIDE).floor();
    let tone = lattice(cell.x as i64, cell.y as i64, 7);
    let from_middle = (p.truncate() - SIDE * (cell + 0.5)).abs().max_element();
    let joint = edge(from_middle - 0.5 * SIDE + 0.025, 2.0 * SOFT);
    let stone = mix([srgb(0xb9aa96), srgb(0x8f98a6)], tone) * (0.75 + 0.5 * rough(5.0 * p));
    stone.lerp(srgb(0x57524c), joint)
}

/// Coordinates on the face of a box or the cap of a cylinder.
fn face_coordinates(p: DVec3, normal: DVec3) -> DVec2 {
    let n = normal.abs();
    if n.x >= n.y && n.x >= n.z {
        DVec2::new(p.y, p.z)
    } else if n.y >= n.z {
        DVec2::new(p.x, p.z)
    } else {
        DVec2::new(p.x, p.y)
    }
}

fn checks(p: DVec2, side: f64, colours: [DVec3; 2]) -> DVec3 {
    // Distance to the nearest line of each family, with a sign that alternates from check to check.
    let wave = |x: f64| ((x / side + 0.5).rem_euclid(2.0) - 1.0).abs() - 0.5;
    let (x, y) = (edge(wave(p.x) * side, SOFT), edge(wave(p.y) * side, SOFT));
    mix(colours, x + y - 2.0 * x * y)
}

fn planet(p: DVec3) -> DVec3 {
    let height = rough(4.2 * p + DVec3::new(3.1, 0.4, 5.2));
    let sea = mix([srgb(0x123f7c), srgb(0x2a86b8)], smoothstep(0.3, 0.5, height));
    let land = mix([srgb(0x6fa04a), srgb(0xc9a35c)], smoothstep(0.54, 0.68, height));
    let ground = sea.lerp(land, smoothstep(0.49, 0.515, height));
    let cloud = rough(DVec3::new(5.0, 5.0, 9.0) * p + DVec3::splat(40.0));
    ground.lerp(srgb(0xf4f4f0), 0.9 * smoothstep(0.58, 0.68, cloud))
}

fn rainbow(p: DVec3, segments: f64) -> DVec3 {
    const HUES: [u32; 6] = [0xd8323c, 0xf08a24, 0xf2cf3a, 0x3fa65a, 0x2f78c4, 0x7d4bab];
    let turn = segments * (p.y.atan2(p.x) / TAU + 0.5);
    let piece = turn.floor();
    let hue = srgb(HUES[(piece as usize) % HUES.len()]);
    let from_seam = 0.5 - (turn - piece - 0.5).abs();
    let seam = edge(0.09 - from_seam, 0.035);
    hue.lerp(srgb(0xf6efe2), seam)
}

fn dots(direction: DVec3, colours: [DVec3; 2]) -> DVec3 {
    let golden = 0.5 * (1.0 + 5.0_f64.sqrt());
    // By symmetry only the corners with positive coordinates need comparing.
    let a = direction.abs();
    let corner = |x: f64, y: f64, z: f64| a.dot(DVec3::new(x, y, z).normalize());
    let large = corner(0.0, 1.0, golden).max(corner(1.0, golden, 0.0)).max(corner(golden, 0.0, 1.0));
    let small = corner(0.0, 1.0 / golden, golden)
        .max(corner(1.0 / golden, golden, 0.0))
        .max(corner(golden, 0.0, 1.0 / golden))
        .max(corner(1.0, 1.0, 1.0));
    let dot = |cosine: f64, radius_rad: f64| edge(radius_rad - cosine.min(1.0).acos(), 0.04);
    mix(colours, dot(large, 0.27).max(dot(small, 0.15)))
}

fn marble(p: DVec3, colours: [DVec3; 2]) -> DVec3 {
    let warp = 2.2 * rough(p);
    let vein = (PI * (p.x + 0.6 * p.y + 0.8 * p.z + 2.0 * warp)).sin();
    mix(colours, smoothstep(-0.7, 0.9, vein))
}

fn sky(direction: DVec3) -> DVec3 {
    let near = ridge(direction, 0.03, 11.0);
    let hill = srgb(0x5f8063);
    if near == 1.0 {
        return hill;
    }
    let far = ridge(direction, 0.10, 3.0);
    air(direction).lerp(srgb(0x8fa7b8), far).lerp(hill, near)
}

fn clear_air(direction: DVec3) -> DVec3 {
    mix([srgb(0xe6d3b8), srgb(0x2b7fce)], smoothstep(-0.05, 0.5, direction.z))
}

fn air(direction: DVec3) -> DVec3 {
    let clear = clear_air(direction);
    let cloud = rough(DVec3::new(3.0, 3.0, 7.0) * direction);
    clear.lerp(srgb(0xfbf7f0), 0.85 * smoothstep(0.47, 0.68, cloud))
}

/// No feature is finer than a fortieth of a radian, some 6 px in the default pictures.
fn vista(direction: DVec3) -> DVec3 {
    let land = smoothstep(0.02, -0.02, direction.z);
    let shade = 0.55 + 0.45 * rough(18.0 * direction);
    let field = mix([srgb(0x8a9a4b), srgb(0xd3b872)], smoothstep(0.4, 0.6, noise(9.0 * direction)));
    let wood = smoothstep(0.52, 0.62, rough(13.0 * direction + DVec3::splat(5.0)));
    let hills = ridge(direction, 0.10, 3.0).max(ridge(direction, 0.03, 11.0));
    let ground = srgb(0x7f95a0).lerp(field.lerp(srgb(0x2f5a3a), wood), land) * shade;
    clear_air(direction).lerp(ground, land.max(hills))
}

/// Sine of the elevation from which on [`Texture::Vista`] shows nothing but air: the crest of its highest hill.
pub(super) const VISTA_CREST: f64 = 0.2;

/// 1 below the crest of hills whose mean height is `height` (sine of the elevation), 0 above.
fn ridge(direction: DVec3, height: f64, seed: f64) -> f64 {
    const SWING: f64 = 0.16;
    if direction.z > height + 0.5 * SWING + 0.01 {
        return 0.0;
    }
    let along = direction.truncate().normalize_or_zero();
    edge(height + SWING * (rough((3.0 * along).extend(seed)) - 0.5) - direction.z, 0.006)
}

#[cfg(test)]
mod tests {
    use super::*;

    const ALL: [Texture; 11] = [
        Texture::Wood,
        Texture::Garden,
        Texture::Checks { side: 0.2, colours: [DVec3::ZERO, DVec3::ONE] },
        Texture::Planet,
        Texture::Helix { stripes: 2.0, turns_per_unit: 2.0, colours: [DVec3::ZERO, DVec3::ONE] },
        Texture::Rainbow { segments: 12.0 },
        Texture::Twist { major: 0.4, stripes: 6.0, colours: [DVec3::ZERO, DVec3::ONE] },
        Texture::Dots { colours: [DVec3::ZERO, DVec3::ONE] },
        Texture::Marble { scale: 3.0, colours: [DVec3::ZERO, DVec3::ONE] },
        Texture::Sky,
        Texture::Vista,
    ];

    #[test]
    fn a_surface_never_gives_back_more_than_it_gets() {
        for texture in ALL {
            for i in 0..2000 {
                let i = f64::from(i);
                let position = 3.0 * DVec3::new((1.1 * i).sin(), (1.7 * i).cos(), (0.3 * i).sin());
                let colour = texture.colour(position, position.normalize());
                assert!(colour.min_element() >= 0.0 && colour.max_element() <= 1.0, "{texture:?} {colour}");
            }
        }
    }

    #[test]
    fn checks_alternate() {
        let colours = [DVec3::ZERO, DVec3::ONE];
        let at = |x: f64, y: f64| checks(DVec2::new(x, y), 0.2, colours);
        assert_eq!(at(0.0, 0.0), at(0.2, 0.2));
        assert_eq!(at(0.0, 0.0), at(-0.2, 0.2));
        assert_eq!(at(0.0, 0.0), DVec3::ONE - at(0.2, 0.0));
        assert!((at(0.1, 0.0) - DVec3::splat(0.5)).length() < 1e-9, "half way across the line");
    }

    #[test]
    fn noise_is_continuous_across_cells() {
        let along = |x: f64| noise(DVec3::new(x, 0.3, -0.7));
        assert!((along(1.0 - 1e-9) - along(1.0 + 1e-9)).abs() < 1e-6);
        assert!((along(-1e-9) - along(1e-9)).abs() < 1e-6);
    }
}

use std::collections::HashMap;
use std::f64::consts::TAU;

use burn::tensor::Device;
use glam::{DAffine3, DMat3, DQuat, DVec2, DVec3, Vec3};
use splat_demo::{self as demo, DemoOptions, SurfaceSample, Surfaces};
use splat_op::CameraModel;

use super::*;
use crate::capture::Capture;
use crate::gaussians::{DC, GaussianRows, Gaussians};

/// The judge's cameras: 24 views of the still life, 3,000 px of its objects each.
const DEMO: DemoOptions = DemoOptions { width: 160, height: 120, views: 24, points: 100, ..DemoOptions::PLAIN };

/// Distance within which a sample counts as covered, scene units; a voxel is 0.03.
const TOLERANCE: f64 = 0.03;

fn demo_cameras(options: &DemoOptions) -> Vec<(Intrinsics, DAffine3)> {
    let folder = tempfile::tempdir().unwrap();
    demo::write(folder.path(), options).unwrap();
    let capture = Capture::load(folder.path()).unwrap();
    capture.views.iter().map(|view| (view.intrinsics, view.cam_from_world)).collect()
}

/// The true depth of a view.
fn true_picture(surfaces: &Surfaces, &(intrinsics, cam_from_world): &(Intrinsics, DAffine3)) -> DepthPicture {
    let seen = surfaces.seen(&intrinsics, &cam_from_world);
    let depth = |sample: &Option<SurfaceSample>| {
        sample.map_or(0.0, |sample| cam_from_world.transform_point3(sample.position).z as f32)
    };
    let colour = vec![[0.2, 0.4, 0.6]; seen.len()];
    DepthPicture { intrinsics, cam_from_world, depth: seen.iter().map(depth).collect(), colour }
}

/// Every third pixel of all views.
fn samples(surfaces: &Surfaces, cameras: &[(Intrinsics, DAffine3)]) -> Vec<SurfaceSample> {
    cameras.iter().flat_map(|(camera, pose)| surfaces.seen(camera, pose).into_iter().step_by(3).flatten()).collect()
}

fn judged(mesh: &Mesh, surfaces: &Surfaces, cameras: &[(Intrinsics, DAffine3)]) -> demo::MeshError {
    let error = surfaces.error(&mesh.positions, &mesh.normals, &samples(surfaces, cameras), TOLERANCE);
    eprintln!("{} vertices, {} triangles: {error:?}", mesh.positions.len(), mesh.triangles.len());
    error
}

fn push(rows: &mut GaussianRows, mean: Vec3, rotation: DQuat, log_scales: [f32; 3], colour: f32) {
    rows.means.push(mean.to_array());
    rows.rotations.push([rotation.w, rotation.x, rotation.y, rotation.z].map(|value| value as f32));
    rows.log_scales.push(log_scales);
    rows.logit_opacities.push(4.0);
    rows.sh_dc.push([(f64::from(colour - 0.5) / DC) as f32; 3]);
}

/// Flat Gaussians on the true surfaces, a few hundredths apart.
fn laid(surfaces: &Surfaces, cameras: &[(Intrinsics, DAffine3)]) -> GaussianRows {
    let mut rows = GaussianRows::default();
    let mut taken = std::collections::BTreeSet::new();
    for SurfaceSample { position, normal, .. } in samples(surfaces, cameras) {
        if taken.insert((position / 0.03).floor().as_ivec3().to_array()) {
            let rotation = DQuat::from_rotation_arc(DVec3::Z, normal);
            push(&mut rows, position.as_vec3(), rotation, [-3.7, -3.7, -7.0], 0.5);
        }
    }
    rows
}

/// Cameras around the origin at a distance of 4.
fn around(count: usize) -> Vec<(Intrinsics, DAffine3)> {
    let camera = |i: usize| {
        let (turn, height) = (TAU * 0.618 * i as f64, 1.9 * (i as f64 + 0.5) / count as f64 - 0.95);
        let centre = 4.0
            * DVec3::new(
                (1.0 - height * height).sqrt() * turn.cos(),
                (1.0 - height * height).sqrt() * turn.sin(),
                height,
            );
        let forward = -centre.normalize();
        let right = forward.cross(DVec3::Z).normalize();
        let world_from_cam = DMat3::from_cols(right, forward.cross(right), forward);
        let pose = DAffine3::from_mat3_translation(world_from_cam, centre).inverse();
        (Intrinsics::centred(96, 96, 120.0), pose)
    };
    (0..count).map(camera).collect()
}

/// A view of the ball of radius 1 at the origin, and of nothing else.
fn ball_picture(&(intrinsics, cam_from_world): &(Intrinsics, DAffine3)) -> DepthPicture {
    let centre = cam_from_world.translation;
    let depth = |i: usize| {
        let px = DVec2::new((i % intrinsics.width) as f64 + 0.5, (i / intrinsics.width) as f64 + 0.5);
        let ray = intrinsics.cam_from_px(px).normalize();
        let along = ray.dot(centre);
        let half = 1.0 - (centre.length_squared() - along * along);
        if half > 0.0 { (ray.z * (along - half.sqrt())) as f32 } else { 0.0 }
    };
    let pixels = intrinsics.width * intrinsics.height;
    let colour = vec![[1.0, 0.5, 0.25]; pixels];
    DepthPicture { intrinsics, cam_from_world, depth: (0..pixels).map(depth).collect(), colour }
}

fn ball(views: usize, options: &MeshOptions) -> Mesh {
    let pictures: Vec<DepthPicture> = around(views).iter().map(ball_picture).collect();
    let mut volume = Volume::for_pictures(&pictures, options).unwrap();
    pictures.iter().for_each(|picture| volume.add(picture).unwrap());
    volume.mesh().unwrap()
}

/// How often each edge is gone through in a direction, less the other direction; without those of zero.
fn open_edges(mesh: &Mesh) -> usize {
    let mut edges: HashMap<[u32; 2], i32> = HashMap::new();
    for &[a, b, c] in &mesh.triangles {
        for [from, to] in [[a, b], [b, c], [c, a]] {
            *edges.entry([from.min(to), from.max(to)]).or_default() += if from < to { 1 } else { -1 };
        }
    }
    edges.values().filter(|&&times| times != 0).count()
}

fn volume_of(mesh: &Mesh) -> f64 {
    let corner = |i: u32| DVec3::from_array(mesh.positions[i as usize].map(f64::from));
    let of = |[a, b, c]: &[u32; 3]| corner(*a).dot(corner(*b).cross(corner(*c))) / 6.0;
    mesh.triangles.iter().map(of).sum()
}

#[test]
fn a_ball_has_its_size_its_normals_and_its_colour() {
    let mesh = ball(20, &MeshOptions { voxel: Some(0.06), ..MeshOptions::default() });
    let radius = |position: &[f32; 3]| Vec3::from(*position).length();
    let worst = mesh.positions.iter().map(|position| (radius(position) - 1.0).abs()).fold(0.0, f32::max);
    assert!(worst < 0.02, "{worst}");
    let normals = mesh.positions.iter().zip(&mesh.normals);
    let least = normals.map(|(at, normal)| Vec3::from(*at).normalize().dot(Vec3::from(*normal))).fold(1.0, f32::min);
    assert!(least > 0.97, "{least}");
    assert!((volume_of(&mesh) / (TAU * 2.0 / 3.0) - 1.0).abs() < 0.02, "{}", volume_of(&mesh));
    let colour = |found: &[f32; 3]| (0..3).all(|channel| (found[channel] - [1.0, 0.5, 0.25][channel]).abs() < 1e-5);
    assert!(mesh.colours.iter().all(colour));
    assert_eq!(open_edges(&mesh), 0, "all sides are seen");
}

/// Seen from above alone the surface ends at the rim, or is closed; nothing else is added.
#[test]
fn unseen_sides_are_open_or_closed() {
    let open = MeshOptions { voxel: Some(0.06), ..MeshOptions::default() };
    let pictures: Vec<DepthPicture> = around(20)[14..].iter().map(ball_picture).collect();
    let of = |options: &MeshOptions| {
        let mut volume = Volume::for_pictures(&pictures, options).unwrap();
        pictures.iter().for_each(|picture| volume.add(picture).unwrap());
        volume.mesh().unwrap()
    };
    let (open, closed) = (of(&open), of(&MeshOptions { watertight: true, ..open }));
    assert!(open_edges(&open) > 20, "{}", open_edges(&open));
    assert_eq!(open_edges(&closed), 0);
    assert!(closed.triangles.len() > open.triangles.len() && volume_of(&closed) > 0.1, "{}", volume_of(&closed));
    // Seen all round, the inside of what is closed is full.
    let full = ball(20, &MeshOptions { voxel: Some(0.06), watertight: true, ..MeshOptions::default() });
    assert!(
        (volume_of(&full) / (TAU * 2.0 / 3.0) - 1.0).abs() < 0.02 && open_edges(&full) == 0,
        "{}",
        volume_of(&full)
    );
}

#[test]
fn any_number_of_threads_gives_the_same_mesh() {
    let with = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| ball(8, &MeshOptions { watertight: true, ..MeshOptions::default() }))
    };
    assert!(with(1) == with(3));
}

#[test]
fn true_depth_gives_the_true_surface() {
    let (surfaces, cameras) = (Surfaces::of(&DEMO), demo_cameras(&DEMO));
    let pictures: Vec<DepthPicture> = cameras.iter().map(|camera| true_picture(&surfaces, camera)).collect();
    let mut volume = Volume::for_pictures(&pictures, &MeshOptions::default()).unwrap();
    pictures.iter().for_each(|picture| volume.add(picture).unwrap());
    let error = judged(&volume.mesh().unwrap(), &surfaces, &cameras);
    assert!(error.distance <= 0.0018 && error.completeness >= 0.99 && error.normal_deg <= 5.5, "{error:?}");
}

#[test]
fn splats_on_the_true_surface_give_it() {
    let (surfaces, cameras) = (Surfaces::of(&DEMO), demo_cameras(&DEMO));
    let splats = Gaussians::from_rows(&laid(&surfaces, &cameras), &Device::flex()).unwrap().splats();
    let mesh = of_splats(&splats, &cameras, &RenderOptions::standard(), &MeshOptions::default(), || ()).unwrap();
    let error = judged(&mesh, &surfaces, &cameras);
    assert!(error.distance <= 0.022 && error.completeness >= 0.94 && error.normal_deg <= 7.0, "{error:?}");
}

#[test]
fn small_components_are_dropped() {
    let centre = DVec3::new(0.0, 0.0, 1.5);
    let picture = |camera: &(Intrinsics, DAffine3)| {
        // A ball of a quarter of the radius: what a camera sees that is as much nearer to it.
        let small = (camera.0, DAffine3 { translation: 4.0 * camera.1.transform_point3(centre), ..camera.1 });
        let (mut picture, small) = (ball_picture(camera), ball_picture(&small));
        for (depth, small) in picture.depth.iter_mut().zip(small.depth) {
            *depth = if small > 0.0 && !(*depth > 0.0 && *depth < 0.25 * small) { 0.25 * small } else { *depth };
        }
        picture
    };
    let pictures: Vec<DepthPicture> = around(20).iter().map(picture).collect();
    let of = |min_component: usize| {
        let options = MeshOptions { voxel: Some(0.06), min_component, ..MeshOptions::default() };
        let mut volume = Volume::for_pictures(&pictures, &options).unwrap();
        pictures.iter().for_each(|picture| volume.add(picture).unwrap());
        volume.mesh()
    };
    let (all, large) = (of(0).unwrap(), of(2_000).unwrap());
    let highest = |mesh: &Mesh| mesh.positions.iter().map(|position| position[2]).fold(f32::MIN, f32::max);
    assert!(highest(&all) > 1.7 && highest(&large) < 1.05, "{} {}", highest(&all), highest(&large));
    assert!(large.triangles.iter().flatten().all(|&vertex| (vertex as usize) < large.positions.len()));
    assert_eq!((large.positions.len(), large.normals.len()), (large.colours.len(), large.colours.len()));
    let error = of(1_000_000).unwrap_err().to_string();
    assert!(error.contains("fewer than 1000000 triangles") && error.contains("`--min-component`"), "{error}");
}

#[test]
fn what_cannot_be_done_is_said() {
    let pictures: Vec<DepthPicture> = around(3).iter().map(ball_picture).collect();
    let with = |options: MeshOptions| {
        let mut volume = Volume::for_pictures(&pictures, &options)?;
        pictures.iter().try_for_each(|picture| volume.add(picture))?;
        volume.mesh()
    };
    let usual = MeshOptions::default();
    for (options, parts) in [
        (MeshOptions { voxel: Some(0.0), ..usual }, ["`voxel` is 0", "a millionth"]),
        (MeshOptions { voxel: Some(f64::NAN), ..usual }, ["`voxel` is NaN", "a millionth"]),
        (MeshOptions { voxel: Some(-1.0), ..usual }, ["`voxel` is -1", "a millionth"]),
        (MeshOptions { truncation: 1.0, ..usual }, ["`truncation` is 1", "at least 2"]),
        (MeshOptions { voxel: Some(0.001), memory: 64 << 20, ..usual }, ["more than 64 MiB", "--voxel"]),
        (MeshOptions { voxel: Some(1e-12), ..usual }, ["`voxel` is 0.000000000001", "a millionth"]),
        (MeshOptions { voxel: Some(100.0), ..usual }, ["no surface", "--voxel"]),
    ] {
        let error = with(options).unwrap_err().to_string();
        assert!(parts.iter().all(|part| error.contains(part)), "{error}");
    }
    // Without a size of voxels the memory decides.
    with(MeshOptions { memory: 4 << 20, ..usual }).unwrap();
    let nothing = DepthPicture { depth: vec![0.0; 96 * 96], ..pictures[0].clone() };
    assert!(matches!(Volume::for_pictures(&[nothing], &usual), Err(MeshError::Empty { components: 0, .. })));
    let mut rows = GaussianRows::default();
    push(&mut rows, Vec3::ZERO, DQuat::IDENTITY, [0.0; 3], 0.8);
    let splats = Gaussians::from_rows(&rows, &Device::flex()).unwrap().splats();
    let (camera, pose) = around(1)[0];
    let parallel = camera.with_lens(CameraModel::Orthographic, [0.0; 8]);
    let error = of_splats(&splats, &[(parallel, pose)], &RenderOptions::standard(), &usual, || ()).unwrap_err();
    assert!(error.to_string().contains("`camera` is Orthographic"), "{error}");
}

"""Makes the captures of docs/CAPTURES.md from their public sources, and takes their checksums.

    python3 -m venv /tmp/captures && /tmp/captures/bin/pip install pycolmap==4.2.1 pillow==13.0.0 numpy==2.2.6
    /tmp/captures/bin/python tests/captures/make.py fox instant-ngp/data/nerf/fox OUT     # fox_small, fox_colmap, fox_distorted
    /tmp/captures/bin/python tests/captures/make.py bonsai 360_v2/bonsai OUT
    /tmp/captures/bin/python tests/captures/make.py statue_wild STATUE_OF_LIBERTY OUT
    /tmp/captures/bin/python tests/captures/make.py lego_alpha nerf_synthetic/lego OUT

`make.py sums OUT` prints a checksum for each capture below a folder. `make.py fox SOURCE OUT --model SPARSE` takes a structure-
from-motion model instead of computing one.
"""

import argparse
import hashlib
import json
import shutil
import struct
import tempfile
from pathlib import Path

import numpy as np
import pycolmap
from PIL import Image

LANCZOS = Image.Resampling.LANCZOS

# The photos of the fox, by number; the source has some more.
FOX = """1 2 3 4 6 7 8 9 12 14 18 19 21 22 25 26 27 29 30 31 33 34 35 39 42 44 45 46 49 52 54 72 73 74 76 77 78 81 84 85 89 90 94 97
103 105 107 108 110 115"""

# Where refinement of the fox's camera begins: that of the source's transforms.json, its principal point, which stays, in whole pixels.
FOX_SIZE = (1080, 1920)
FOX_CAMERA = [1375.52, 1374.49, 554.0, 965.0, 0.0578421, -0.0805099, -0.000980296, 0.00015575]

# The photos of bonsai, by the number in their names, and their size.
BONSAI = range(5605, 5857)
BONSAI_SIZE = (799, 532)

LEGO_SIZE = (400, 400)


def structure(photos, names, mode, reader):
    """The largest model that COLMAP finds in photos; with one seed and one thread, so that a second run gives the same."""
    with tempfile.TemporaryDirectory() as folder:
        database, models = Path(folder) / "database.db", Path(folder) / "models"
        models.mkdir()
        extraction = pycolmap.FeatureExtractionOptions()
        extraction.num_threads = 1
        matching = pycolmap.FeatureMatchingOptions()
        matching.num_threads = 1
        mapping = pycolmap.IncrementalPipelineOptions()
        mapping.num_threads, mapping.random_seed = 1, 0
        pycolmap.set_random_seed(0)
        pycolmap.extract_features(database, photos, names, mode, reader, extraction, pycolmap.Device.cpu)
        pycolmap.match_exhaustive(database, matching, device=pycolmap.Device.cpu)
        found = pycolmap.incremental_mapping(database, photos, models, mapping)
        return max(found.values(), key=lambda model: model.num_reg_images())


def write_model(model, folder, text=False):
    folder.mkdir(parents=True)
    model.write_text(folder) if text else model.write_binary(folder)


def resize(source, target, size, quality):
    """A photo at another size, its colour at half resolution as Pillow has it."""
    target.parent.mkdir(parents=True, exist_ok=True)
    Image.open(source).resize(size, LANCZOS).save(target, quality=quality)


def undistort(model, photos, out, side_px):
    """Pinhole photos of at most `side_px`, with the model that belongs to them."""
    with tempfile.TemporaryDirectory() as folder:
        sparse, work = Path(folder) / "sparse", Path(folder) / "out"
        write_model(model, sparse)
        work.mkdir()
        options = pycolmap.UndistortCameraOptions()
        options.max_image_size = side_px
        pycolmap.undistort_images(work, sparse, photos, undistort_options=options, jpeg_quality=95)
        shutil.copytree(work / "images", out / "images")
        pinhole = pycolmap.Reconstruction(work / "sparse")
        pinhole.update_point_3d_errors()
        write_model(pinhole, out / "sparse/0")


def rescaled(model, size):
    """A copy for photos of another size; all its cameras get that size."""
    model = pycolmap.Reconstruction(model)
    factors = {}
    for number, camera in model.cameras.items():
        factors[number] = np.array([size[0] / camera.width, size[1] / camera.height])
        camera.rescale(*size)
    for image in model.images.values():
        for point in image.points2D:
            point.xy = point.xy * factors[image.camera_id]
    # A model without tracks keeps the errors that it states.
    if model.compute_num_observations() > 0:
        model.update_point_3d_errors()
    return model


def fox(source, out, model_folder):
    photos = source / "images"
    names = [f"{int(number):04}.jpg" for number in FOX.split()]
    size = Image.open(photos / names[0]).size
    if model_folder is None:
        reader = pycolmap.ImageReaderOptions()
        reader.camera_model = "OPENCV"
        scale = [size[0] / FOX_SIZE[0], size[1] / FOX_SIZE[1]] * 2 + [1.0] * 4
        reader.camera_params = ",".join(str(value * factor) for value, factor in zip(FOX_CAMERA, scale))
        model = structure(photos, names, pycolmap.CameraMode.SINGLE, reader)
    else:
        model = rescaled(pycolmap.Reconstruction(model_folder), size)
    print(model.summary())

    distorted = (405, 720)
    write_model(rescaled(model, distorted), out / "fox_distorted/sparse/0")
    for name in names:
        resize(photos / name, out / "fox_distorted/images" / name, distorted, 93)
    undistort(model, photos, out / "fox_colmap", 960)
    undistort(model, photos, out / "fox_small", 480)
    write_model(pycolmap.Reconstruction(out / "fox_small/sparse/0"), out / "fox_small/sparse_txt/0", text=True)


def bonsai(source, out):
    """The archive's own model, scaled; without keypoints, whose place in the file says that there are none."""
    target = out / "bonsai"
    model = rescaled(pycolmap.Reconstruction(source / "sparse/0"), BONSAI_SIZE)
    names = {f"DSCF{number}.JPG" for number in BONSAI}
    images = sorted((i for i in model.images.values() if i.name in names), key=lambda image: image.image_id)
    sparse = target / "sparse/0"
    sparse.mkdir(parents=True)
    with open(sparse / "cameras.bin", "wb") as file:
        file.write(struct.pack("<Q", len(model.cameras)))
        for number, camera in model.cameras.items():
            head = (number, camera.model.value, camera.width, camera.height)
            file.write(struct.pack("<iiQQ", *head) + np.asarray(camera.params, "<f8").tobytes())
    with open(sparse / "images.bin", "wb") as file:
        file.write(struct.pack("<Q", len(images)))
        for image in images:
            pose = image.cam_from_world()
            x, y, z, w = pose.rotation.quat
            file.write(struct.pack("<i7di", image.image_id, w, x, y, z, *pose.translation, image.camera_id))
            file.write(image.name.encode() + b"\0" + struct.pack("<Q", 0))
    with open(sparse / "points3D.bin", "wb") as file:
        file.write(struct.pack("<Q", len(model.points3D)))
        for number, point in sorted(model.points3D.items()):
            file.write(struct.pack("<Q3d3BdQ", number, *point.xyz, *point.color, point.error, 0))
    for image in images:
        resize(source / "images" / image.name, target / "images" / image.name, BONSAI_SIZE, 89)


def statue_wild(source, out):
    """A camera for each photo. Masks are only resized: undistortion moves little in photos of so long a focal length."""
    photos, masks = source / "images", source / "masks"
    names = sorted(path.name for path in photos.iterdir())
    reader = pycolmap.ImageReaderOptions()
    reader.camera_model = "SIMPLE_RADIAL"
    model = structure(photos, names, pycolmap.CameraMode.PER_IMAGE, reader)
    print(model.summary())
    target = out / "statue_wild"
    undistort(model, photos, target, 960)
    (target / "masks").mkdir()
    for path in (target / "images").iterdir():
        mask = Image.open(masks / f"{path.stem}.png").convert("L")
        mask.resize(Image.open(path).size, Image.Resampling.NEAREST).save(target / "masks" / f"{path.stem}.png")


def lego_alpha(source, out):
    """The source's training photos at half size; every eighth of them, by number, is for tests."""
    target = out / "lego_alpha"
    transforms = json.loads((source / "transforms_train.json").read_text())
    number = lambda frame: int(frame["file_path"].rsplit("_", 1)[1])
    frames = sorted(transforms["frames"], key=number)
    parts = {"train": [f for f in frames if number(f) % 8 != 7], "test": [f for f in frames if number(f) % 8 == 7]}
    for part, chosen in parts.items():
        (target / part).mkdir(parents=True)
        for frame in chosen:
            name = f"r_{number(frame)}"
            # Pillow multiplies colour by alpha before it resizes and divides after.
            Image.open(source / "train" / f"{name}.png").resize(LEGO_SIZE, LANCZOS).save(target / part / f"{name}.png")
        listed = [frame | {"file_path": f"./{part}/r_{number(frame)}"} for frame in chosen]
        text = json.dumps(transforms | {"frames": listed}, indent=1)
        (target / f"transforms_{part}.json").write_text(text)


def checksum(folder):
    """SHA-256 of the lines `SHA-256 of a file, two blanks, its path in the folder` in order of the paths, as `sha256sum` prints them."""
    paths = sorted((path.relative_to(folder).as_posix(), path) for path in folder.rglob("*") if path.is_file())
    lines = [f"{hashlib.sha256(path.read_bytes()).hexdigest()}  {name}\n" for name, path in paths]
    return hashlib.sha256("".join(lines).encode()).hexdigest(), len(lines)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(dest="command", required=True)
    makers = {"fox": fox, "bonsai": bonsai, "statue_wild": statue_wild, "lego_alpha": lego_alpha}
    for name in makers:
        command = commands.add_parser(name)
        command.add_argument("source", type=Path)
        command.add_argument("out", type=Path)
        if name == "fox":
            command.add_argument("--model", type=Path, help="a model of the photos at any size")
    commands.add_parser("sums").add_argument("folder", type=Path)
    options = parser.parse_args()
    if options.command == "sums":
        for folder in sorted(path for path in options.folder.iterdir() if path.is_dir()):
            total, count = checksum(folder)
            print(f"{total}  {folder.name}  {count} files")
    elif options.command == "fox":
        fox(options.source, options.out, options.model)
    else:
        makers[options.command](options.source, options.out)


if __name__ == "__main__":
    main()

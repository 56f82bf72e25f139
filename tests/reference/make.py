"""Makes the reference vectors beside this file: float64 renders with their gradients, for tests/tests/reference.rs.

    python3 -m venv /tmp/reference && /tmp/reference/bin/pip install torch==2.7.1 gsplat==1.5.3 numpy==2.2.6 safetensors==0.4.5 && /tmp/reference/bin/python tests/reference/make.py

No GPU is needed: covariances, projection and spherical harmonics are gsplat's PyTorch functions under autograd. Its function
`accumulate` composites with nerfacc, whose kernels need CUDA and which knows neither thresholds nor a background, so the layers
of a pixel are added here, as a dense sum. README.md states the function.

    make.py --check FOLDER

computes the outputs and gradients of the files of a folder again from their inputs, and prints the largest difference of each.
"""

import argparse
import json
import math
import sys
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import torch
from gsplat.cuda._torch_impl import _fully_fused_projection, _quat_scale_to_covar_preci, _spherical_harmonics
from safetensors import safe_open
from safetensors.numpy import save_file

HERE = Path(__file__).parent

# The floor of the anti-aliasing compensation in gsplat's CUDA code; its PyTorch function has none.
COMPENSATION_MIN = 0.005

# Elements of a matrix of pixels and Gaussians that are held at once.
CHUNK = 4_000_000

PARAMETERS = ["means", "quats", "scales", "opacities", "sh", "viewmat", "background"]
PICTURES = ["image", "alpha", "depth"]

torch.set_num_threads(1)
torch.use_deterministic_algorithms(True)


@dataclass
class Params:
    """What a file states beside its tensors."""

    width: int
    height: int
    sh_degree: int
    camera: str = "pinhole"
    eps2d: float = 0.3
    near: float = 0.01
    alpha_max: float = 0.99
    alpha_min: float = 1 / 255
    t_min: float = 1e-4
    antialias: bool = False


@dataclass
class Kind:
    """A scene drawn from `seed`, and what it has to show."""

    seed: int
    count: int
    params: Params
    # The focal length in widths of the picture.
    focal: float
    # The range of a Gaussian's standard deviations, px at the depth of its centre; their logarithms are uniform.
    scale_px: tuple
    opacity: tuple = (0.2, 0.95)
    # How far outside the picture centres lie, in sizes of the picture.
    outside: float = 0.3
    # Ratio of the longest axis to the others; 1 draws the three axes apart.
    needle: float = 1.0
    depth: tuple = (2.0, 6.0)
    # What must occur in the scene: keys of the counts of `render`.
    shows: tuple = ()


SMOOTH = {"alpha_min": 0.0, "t_min": 0.0}
KINDS = {
    "smooth_sh0": Kind(1, 24, Params(33, 29, 0, **SMOOTH), 1.1, (1.0, 8.0), shows=("behind", "margin")),
    "smooth_sh3": Kind(2, 24, Params(40, 32, 3, **SMOOTH), 1.0, (1.0, 8.0), shows=("behind", "margin")),
    "standard_sh3": Kind(3, 96, Params(56, 40, 3), 0.9, (0.7, 7.0), shows=("behind", "margin", "cut")),
    "standard_dense": Kind(4, 400, Params(64, 40, 2), 1.0, (1.5, 8.0), (0.4, 0.98), 0.2, shows=("margin", "cut", "stopped")),
    "needles": Kind(25, 48, Params(56, 40, 1, **SMOOTH), 1.0, (4.0, 16.0), outside=0.2, needle=1000.0, shows=("margin",)),
    "opaque": Kind(6, 160, Params(56, 40, 1), 1.1, (1.5, 5.0), (0.97, 1.0), 0.1, shows=("saturated", "stopped")),
    "antialias": Kind(7, 200, Params(48, 40, 1, antialias=True), 1.0, (0.1, 4.0), shows=("cut", "behind")),
    "tiny_antialias": Kind(8, 160, Params(40, 40, 1, antialias=True, **SMOOTH), 1.0, (5e-3, 0.6), shows=("floor",)),
}


def scene(kind):
    """The inputs and the weights of the loss: Gaussians in and around the view of a camera that is turned and moved."""
    random = np.random.default_rng(kind.seed)
    between = lambda low, high, *shape: low + (high - low) * random.random(shape)
    count, p = kind.count, kind.params
    fx, fy = kind.focal * p.width, kind.focal * p.width * 1.07
    cx, cy = 0.47 * p.width, 0.54 * p.height

    # In the camera's frame first, within the picture and around it; an eighth of the centres lies behind the camera.
    px = np.stack([between(-kind.outside, 1 + kind.outside, count) * size for size in (p.width, p.height)], axis=1)
    z = between(*kind.depth, count)
    if "behind" in kind.shows:
        z[: count // 8] = between(-1.0, p.near, count // 8)
    in_camera = np.stack([(px[:, 0] - cx) / fx * z, (px[:, 1] - cy) / fy * z, z], axis=1)

    turned = lambda angle, i, j: np.array(
        [[math.cos(angle) if r == c and r in (i, j) else float(r == c) for c in range(3)] for r in range(3)]
    ) + math.sin(angle) * (np.eye(3)[[i]].T @ np.eye(3)[[j]] - np.eye(3)[[j]].T @ np.eye(3)[[i]])
    viewmat = np.eye(4)
    viewmat[:3, :3] = turned(0.3, 0, 1) @ turned(-0.7, 1, 2) @ turned(0.5, 0, 2)
    viewmat[:3, 3] = [0.4, -0.3, 0.8]
    means = (in_camera - viewmat[:3, 3]) @ viewmat[:3, :3]

    low, high = np.log(kind.scale_px)
    if kind.needle > 1.0:
        sizes = np.exp(np.repeat(between(low, high, count, 1), 3, axis=1))
        sizes[:, 1:] /= kind.needle
    else:
        sizes = np.exp(between(low, high, count, 3))
    bases = (p.sh_degree + 1) ** 2
    tensors = {
        "means": means,
        # Of any length but zero.
        "quats": random.normal(size=(count, 4)) * between(0.3, 3.0, count, 1),
        "scales": sizes / fx * np.abs(z)[:, None].clip(0.5),
        "opacities": between(*kind.opacity, count),
        # About a quarter of the colours is below zero, where they are cut.
        "sh": np.concatenate([between(-2.6, 2.0, count, 1, 3), between(-0.6, 0.6, count, bases - 1, 3)], axis=1),
        "viewmat": viewmat,
        "K": np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]]),
        "background": between(0.0, 1.0, 3),
    }
    picture = (p.height, p.width)
    weights = {"w_image": between(-1, 1, *picture, 3), "w_alpha": between(-1, 1, *picture), "w_depth": between(-1, 1, *picture)}
    return tensors | weights


def project(leaves, k, p):
    """Columns of all Gaussians by gsplat's functions, their last one the opacity after compensation."""
    covariances, _ = _quat_scale_to_covar_preci(leaves["quats"], leaves["scales"], True, False)
    _, means2d, depths, conics, compensations = _fully_fused_projection(
        leaves["means"], covariances, leaves["viewmat"][None], k[None], p.width, p.height,
        eps2d=p.eps2d, near_plane=p.near, calc_compensations=True, camera_model=p.camera,
    )  # fmt: skip
    centre = torch.linalg.inv(leaves["viewmat"])[:3, 3]
    colours = _spherical_harmonics(p.sh_degree, leaves["means"] - centre, leaves["sh"]) + 0.5
    opacities = leaves["opacities"]
    if p.antialias:
        opacities = opacities * compensations[0].clamp(min=COMPENSATION_MIN)
    columns = {"means2d": means2d[0], "depths": depths[0], "conics": conics[0], "colors": colours.clamp(min=0.0)}
    return columns | {"opacities": opacities}, compensations[0]


def composite(pixels, c, background, p):
    """`(image, alpha, depth)` of some pixels from columns in order of depth, and counts of what the thresholds did."""
    centres = torch.stack([pixels % p.width, pixels // p.width], dim=1) + 0.5
    d = centres[:, None] - c["means2d"]
    a, b, c2 = c["conics"].unbind(-1)
    power = 0.5 * (a * d[..., 0] ** 2 + c2 * d[..., 1] ** 2) + b * d[..., 0] * d[..., 1]
    raw = c["opacities"] * torch.exp(-power)
    alpha = raw.clamp(max=p.alpha_max)
    drawn = alpha >= p.alpha_min
    alpha = torch.where(drawn, alpha, 0.0)
    kept = torch.cumprod(1.0 - alpha, dim=1) > p.t_min
    alpha = torch.where(kept, alpha, 0.0)
    after = torch.cumprod(1.0 - alpha, dim=1)
    before = torch.cat([torch.ones_like(after[:, :1]), after[:, :-1]], dim=1)
    weights = alpha * before
    image = weights @ c["colors"] + after[:, -1:] * background
    counts = {"cut": (~drawn).any(1), "stopped": (~kept).any(1), "saturated": (drawn & kept & (raw > p.alpha_max)).any(1)}
    return (image, weights.sum(1), weights @ c["depths"]), {what: int(found.sum()) for what, found in counts.items()}


def render(inputs, p):
    """Outputs, loss and gradients of a file from its inputs and weights, and counts of what the scene shows."""
    tensors = {name: torch.from_numpy(np.array(value)) for name, value in inputs.items()}
    leaves = {name: tensors[name].requires_grad_() for name in PARAMETERS}
    columns, compensations = project(leaves, tensors["K"], p)
    front = torch.nonzero(columns["depths"] > p.near)[:, 0]
    order = front[torch.argsort(columns["depths"][front], stable=True)]

    # The graph is cut at the columns, so that a part of the pixels is differentiated at a time.
    cut = {name: column.detach().requires_grad_() for name, column in columns.items()}
    shapes = {"image": (p.height, p.width, 3), "alpha": (p.height, p.width), "depth": (p.height, p.width)}
    pictures = {name: np.zeros(shape) for name, shape in shapes.items()}
    loss, shown = 0.0, {"cut": 0, "stopped": 0, "saturated": 0}
    for pixels in torch.arange(p.width * p.height).split(max(1, CHUNK // max(1, len(order)))):
        found, counts = composite(pixels, {name: c[order] for name, c in cut.items()}, leaves["background"], p)
        part = 0.0
        for name, picture in zip(PICTURES, found):
            flat = pictures[name].reshape(p.width * p.height, -1)
            flat[pixels] = picture.detach().reshape(len(pixels), -1).numpy()
            weights = tensors[f"w_{name}"].reshape(p.width * p.height, -1)[pixels]
            part = part + (weights * picture.reshape(len(pixels), -1)).sum()
        part.backward()
        loss += part.item()
        shown = {what: count + counts[what] for what, count in shown.items()}
    torch.autograd.backward(list(columns.values()), [c.grad for c in cut.values()])

    behind = (columns["depths"] <= p.near).numpy()
    outputs = {f"out_{name}": columns[name].detach().numpy() for name in ["means2d", "depths", "conics", "colors"]}
    for output in outputs.values():
        output[behind] = 0.0
    outputs |= {f"out_{name}": picture for name, picture in pictures.items()} | {"loss": np.array([loss])}
    gradients = {f"g_{name}": leaf.grad.numpy() for name, leaf in leaves.items()} | {"g_means2d": cut["means2d"].grad.numpy()}
    for name, tensor in (outputs | gradients).items():
        assert np.isfinite(tensor).all(), name

    slopes = (leaves["means"] @ leaves["viewmat"][:3, :3].T + leaves["viewmat"][:3, 3])[order].detach().numpy()
    k = inputs["K"]
    px = np.stack([slopes[:, i] / slopes[:, 2] * k[i, i] + k[i, 2] for i in (0, 1)], axis=1)
    size = np.array([p.width, p.height])
    shown["behind"] = int(behind.sum())
    # Where the slopes in the Jacobian are held back.
    shown["margin"] = int(((px < -0.15 * size) | (px > 1.15 * size)).any(1).sum())
    shown["floor"] = int((compensations[order] < COMPENSATION_MIN).sum()) if p.antialias else 0
    return outputs | gradients, shown


def make():
    for name, kind in KINDS.items():
        inputs = scene(kind)
        computed, shown = render(inputs, kind.params)
        missing = [what for what in kind.shows if shown[what] == 0]
        assert not missing, f"{name} does not show {missing}"
        path = HERE / f"{name}.safetensors"
        save_file({n: np.ascontiguousarray(t) for n, t in (inputs | computed).items()}, path, {"params": json.dumps(asdict(kind.params))})
        print(f"{name}: {path.stat().st_size:,} bytes, {shown}")


def check(folder):
    """Each tensor's largest difference, relative to its largest element; rows that are not specified are left out."""
    worst = 0.0
    paths = sorted(folder.glob("*.safetensors"))
    assert paths, f"no .safetensors file in {folder}"
    for path in paths:
        with safe_open(path, "numpy") as file:
            p = Params(**json.loads(file.metadata()["params"]))
            tensors = {name: file.get_tensor(name) for name in file.keys()}
        inputs = [*PARAMETERS, "K", "w_image", "w_alpha", "w_depth"]
        computed, shown = render({name: tensors[name] for name in inputs}, p)
        world = tensors["means"] @ tensors["viewmat"][2, :3] + tensors["viewmat"][2, 3]
        differences = {}
        for name, found in computed.items():
            expected = tensors[name]
            rows = world > p.near if name in ("out_means2d", "out_depths", "out_conics", "out_colors") else slice(None)
            scale = np.abs(expected[rows]).max()
            differences[name] = float(np.abs(found - expected)[rows].max() / (scale if scale > 0.0 else 1.0))
        name = max(differences, key=differences.get)
        worst = max(worst, differences[name])
        print(f"{path.stem}: at most {differences[name]:.1e}, of {name}; {shown}")
    print(f"largest difference: {worst:.1e}")
    return worst


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--check", type=Path, metavar="FOLDER", help="compare with the files of a folder instead")
    parser.add_argument("--tolerance", type=float, default=1e-11, help="largest difference that passes the check")
    options = parser.parse_args()
    if options.check is None:
        make()
    else:
        sys.exit(check(options.check) > options.tolerance)

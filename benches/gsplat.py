#!/usr/bin/env python3
"""Measures gsplat on the scenes and captures that `gpu export FOLDER ...` wrote, and prints splat's times over gsplat's, where
`benches/card.sh run` left a card.json.

Synthetic scenes: a render, and a training step (activation, render, loss, backward pass, Adam), medians in ms. Captures: training with gsplat's
default strategy and the settings of its example `simple_trainer.py`, and the PSNR of held-out photographs. SSIM is by the package `fused_ssim`
where it is installed, and else by convolutions, which take longer.

`benches/card.sh gsplat` runs this. Needs gsplat, PyTorch with CUDA, NumPy and Pillow.
"""

import argparse
import json
import math
import statistics
import time
from pathlib import Path

import numpy as np
import torch
import torch.nn.functional as F
from gsplat import DefaultStrategy, rasterization
from PIL import Image

try:
    from fused_ssim import fused_ssim
except ImportError:
    fused_ssim = None

DEGREE = 3
REST = (DEGREE + 1) ** 2 - 1


def ssim(render, truth):
    """The mean SSIM of two pictures, [H, W, 3], with a Gaussian window of 11 pixels (Wang et al. 2004)."""
    a, b = (picture.permute(2, 0, 1)[None] for picture in (render, truth))
    if fused_ssim is not None:
        return fused_ssim(a, b, padding="valid")
    window = torch.exp(-((torch.arange(11, device=a.device) - 5.0) ** 2) / (2 * 1.5**2))
    window = (window / window.sum()).expand(15, 1, 11)
    planes = torch.cat([a, b, a * a, b * b, a * b], 1)
    blurred = F.conv2d(F.conv2d(planes, window[:, :, None, :], groups=15), window[:, :, :, None], groups=15)
    mean_a, mean_b, aa, bb, ab = blurred.split(3, 1)
    aa, bb, ab = aa - mean_a**2, bb - mean_b**2, ab - mean_a * mean_b
    c1, c2 = 0.01**2, 0.03**2
    index = (2 * mean_a * mean_b + c1) * (2 * ab + c2) / ((mean_a**2 + mean_b**2 + c1) * (aa + bb + c2))
    return index.mean()


def loss_of(render, truth):
    return 0.8 * F.l1_loss(render, truth) + 0.2 * (1 - ssim(render, truth))


def render_of(splats, camera, degree, device):
    """The picture, [H, W, 3], and what the strategy needs. Activates the parameters."""
    fx, fy, cx, cy = camera["lens"]
    width, height = camera["size"]
    pose = torch.tensor(camera["cam_from_world"] + [[0, 0, 0, 1]], dtype=torch.float32, device=device)
    lens = torch.tensor([[fx, 0, cx], [0, fy, cy], [0, 0, 1]], dtype=torch.float32, device=device)
    pictures, _, info = rasterization(
        splats["means"], splats["quats"], torch.exp(splats["scales"]), torch.sigmoid(splats["opacities"]),
        torch.cat([splats["sh0"], splats["shN"]], 1), pose[None], lens[None], width, height, sh_degree=degree, packed=False,
    )  # fmt: skip
    return pictures[0], info


def trainable(values, device):
    return torch.nn.ParameterDict({name: torch.nn.Parameter(value.to(device).contiguous()) for name, value in values.items()})


def optimizers_of(splats, extent):
    rates = {"means": 1.6e-4 * extent, "scales": 5e-3, "quats": 1e-3, "opacities": 5e-2, "sh0": 2.5e-3, "shN": 2.5e-3 / 20}
    fused = splats["means"].is_cuda
    return {name: torch.optim.Adam([{"params": splats[name], "lr": rate, "name": name}], eps=1e-15, fused=fused) for name, rate in rates.items()}


def read_ply(file):
    """The Gaussians of a binary PLY file in the layout of Kerbl et al. 2023."""
    data = file.read_bytes()
    end = data.index(b"end_header\n") + len(b"end_header\n")
    words = [line.split() for line in data[:end].decode().splitlines()]
    count = next(int(line[2]) for line in words if line[:2] == ["element", "vertex"])
    names = [line[2] for line in words if line[0] == "property"]
    rows = torch.from_numpy(np.frombuffer(data, "<f4", count * len(names), end).reshape(count, len(names)).copy())
    columns = lambda *wanted: rows[:, [names.index(name) for name in wanted]]
    rest = columns(*(f"f_rest_{i}" for i in range(3 * REST))).reshape(count, 3, REST).transpose(1, 2)
    return {
        "means": columns("x", "y", "z"),
        "quats": columns("rot_0", "rot_1", "rot_2", "rot_3"),
        "scales": columns("scale_0", "scale_1", "scale_2"),
        "opacities": columns("opacity")[:, 0],
        "sh0": columns("f_dc_0", "f_dc_1", "f_dc_2")[:, None],
        "shN": rest,
    }


def median_ms(task, device, runs):
    def timed():
        start = time.perf_counter()
        task()
        if device.type == "cuda":
            torch.cuda.synchronize()
        return 1e3 * (time.perf_counter() - start)

    for _ in range(3):
        timed()
    return statistics.median(timed() for _ in range(runs))


def measure_scene(name, camera, file, device, runs):
    splats = trainable(read_ply(file), device)
    optimizers = optimizers_of(splats, 1.0)

    def forward():
        with torch.no_grad():
            render_of(splats, camera, DEGREE, device)

    with torch.no_grad():
        truth = 0.5 * render_of(splats, camera, DEGREE, device)[0]

    def step():
        loss_of(render_of(splats, camera, DEGREE, device)[0], truth).backward()
        for optimizer in optimizers.values():
            optimizer.step()
            optimizer.zero_grad(set_to_none=True)

    # The render comes first: a step moves the Gaussians.
    found = {"render": median_ms(forward, device, runs), "training step": median_ms(step, device, runs)}
    return {"scene": name, "splats": len(splats["means"]), "ms": found}


def from_points(points, device):
    """The first Gaussians, as `simple_trainer.py` makes them: as large as the mean distance of three neighbours."""
    means = torch.tensor([position for position, _ in points], dtype=torch.float32, device=device)
    colours = torch.tensor([colour for _, colour in points], dtype=torch.float32, device=device) / 255
    nearest = [torch.cdist(part, means).topk(4, largest=False).values[:, 1:] for part in means.split(1024)]
    size = torch.cat(nearest).square().mean(1).sqrt().clamp_min(1e-7)
    return {
        "means": means,
        "quats": torch.rand(len(means), 4, device=device),
        "scales": torch.log(size)[:, None].repeat(1, 3),
        "opacities": torch.logit(torch.full((len(means),), 0.1, device=device)),
        "sh0": ((colours - 0.5) / 0.28209479177387814)[:, None],
        "shN": torch.zeros(len(means), REST, 3, device=device),
    }


def photograph(entry):
    pixels = torch.from_numpy(np.asarray(Image.open(entry["file"]).convert("RGB")).copy())
    width, height = entry["camera"]["size"]
    if pixels.shape[:2] != (height, width):
        raise SystemExit(f"{entry['file']}: {pixels.shape[1]} x {pixels.shape[0]} px, expected {width} x {height}")
    return pixels


def train(name, capture, steps, device):
    torch.manual_seed(1)
    views = [(entry["camera"], photograph(entry).to(device), entry["test"]) for entry in capture["photographs"]]
    seen = [view for view in views if not view[2]]
    splats = trainable(from_points(capture["points"], device), device)
    # As there, 1.1 times the radius of the cameras.
    extent = capture["extent"]
    optimizers = optimizers_of(splats, extent)
    schedule = torch.optim.lr_scheduler.ExponentialLR(optimizers["means"], 0.01 ** (1 / steps))
    strategy = DefaultStrategy()
    strategy.check_sanity(splats, optimizers)
    state = strategy.initialize_state(scene_scale=extent)
    order, start = [], time.perf_counter()
    for step in range(steps):
        order = order or torch.randperm(len(seen)).tolist()
        camera, truth, _ = seen[order.pop()]
        picture, info = render_of(splats, camera, min(step // 1000, DEGREE), device)
        strategy.step_pre_backward(splats, optimizers, state, step, info)
        loss_of(picture, truth.float() / 255).backward()
        for optimizer in optimizers.values():
            optimizer.step()
            optimizer.zero_grad(set_to_none=True)
        schedule.step()
        strategy.step_post_backward(splats, optimizers, state, step, info, packed=False)
    if device.type == "cuda":
        torch.cuda.synchronize()
    seconds, scores = time.perf_counter() - start, []
    with torch.no_grad():
        for camera, truth, test in views:
            if test:
                picture = render_of(splats, camera, DEGREE, device)[0].clamp(0, 1)
                scores.append(-10 * math.log10(F.mse_loss(picture, truth.float() / 255).item()))
    return {"capture": name, "steps": steps, "seconds": seconds, "splats": len(splats["means"]), "psnr": statistics.mean(scores)}


def report(found, card):
    """Prints a line for each measurement, with this project's beside it."""
    if "ms" in found:
        for kind, ms in found["ms"].items():
            passes = ["activate", "project", "sh", "intersect", "rasterize"] if kind == "render" else [kind]
            ours = {}
            for timed in card.get("times", []):
                if timed["scene"] == found["scene"] and timed["pass"] in passes:
                    ours[timed["device"]] = ours.get(timed["device"], 0) + timed["median_ms"]
            beside = "".join(f"; splat on {device}: {own:.2f} ms, ratio {own / ms:.2f}" for device, own in ours.items())
            print(f"{found['scene']}, {found['splats']} Gaussians, {kind}: gsplat {ms:.2f} ms{beside}", flush=True)
        return
    line = f"{found['capture']}, {found['steps']} steps: gsplat {found['psnr']:.2f} dB, {found['splats']} Gaussians, {found['seconds']:.1f} s"
    for run, metrics in card.get("runs", []):
        if Path(run.split(",")[0]).name == found["capture"] and metrics.get("steps") == found["steps"]:
            seconds = metrics["seconds"]["train"]
            ratio = seconds / found["seconds"]
            line += f"; splat {metrics['test']['psnr']:.2f} dB, {metrics['splats']} Gaussians, {seconds:.1f} s, ratio {ratio:.2f}"
    print(line, flush=True)


def main():
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("folder", type=Path, help="what `gpu export` wrote")
    arguments.add_argument("--card", type=Path, help="card.json of `benches/card.sh run` on the same machine")
    arguments.add_argument("--steps", type=int, default=7000, help="steps of training on a capture")
    arguments.add_argument("--runs", type=int, default=20, help="runs of each scene")
    arguments.add_argument("--device", default="cuda")
    options = arguments.parse_args()
    device = torch.device(options.device)
    card = json.loads(options.card.read_text()) if options.card else {}
    print("SSIM:", "fused_ssim" if fused_ssim else "convolutions")
    files = sorted(options.folder.glob("*.json"))
    if not files:
        raise SystemExit(f"{options.folder} has no JSON file: write it with `gpu export`")
    for file in files:
        job = json.loads(file.read_text())
        if "photographs" in job:
            found = train(file.stem, job, options.steps, device)
        else:
            found = measure_scene(file.stem, job, file.with_suffix(".ply"), device, options.runs)
        report(found, card)


if __name__ == "__main__":
    main()

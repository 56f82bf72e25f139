"""Values of LPIPS by the authors' package, for tests/tests/lpips.rs. Writes reference.json beside this file.

    python -m venv /tmp/lpips && /tmp/lpips/bin/pip install torch==2.15.0 torchvision==0.29.2 lpips==0.1.4
    /tmp/lpips/bin/python tests/lpips/reference.py

The networks' own weights are nobody's to put here, so weights and pictures follow from a formula that the test has too. The
package, its networks, its scaling, its normalisation and its sums are as they are. Values are computed in float64, and in float32
beside them.
"""

import json
import warnings
from pathlib import Path

import lpips
import numpy as np
import torch

warnings.filterwarnings("ignore")


def mixed(seed, count):
    """Integers from 0 to 2^24 - 1: a hash of the place, by the constants of Chris Wellons' "lowbias32"."""
    x = (np.arange(count, dtype=np.uint64) * 0x9E3779B9 + seed).astype(np.uint32)
    x ^= x >> np.uint32(16)
    x *= np.uint32(0x7FEB352D)
    x ^= x >> np.uint32(15)
    x *= np.uint32(0x846CA68B)
    x ^= x >> np.uint32(16)
    return x >> np.uint32(8)


def seed_of(name):
    """FNV-1a in 32 bits."""
    seed = 0x811C9DC5
    for byte in name.encode():
        seed = (seed ^ byte) * 0x01000193 % 2**32
    return seed


def weights(name, shape):
    """Weights of layers after He et al. 2015, biases within 0.1, those of linear layers from 0 to 0.2."""
    values = mixed(seed_of(name), int(np.prod(shape))).astype(np.float32)
    if name.startswith("lin"):
        values = values / np.float32(2**24) * np.float32(0.2)
    else:
        bound = np.sqrt(6.0 / np.prod(shape[1:])) if len(shape) == 4 else 0.1
        values = (values / np.float32(2**23) - np.float32(1.0)) * np.float32(bound)
    return torch.from_numpy(values.reshape(shape))


def pictures(pair, height, width):
    """Two pictures of bytes, `[H, W, 3]`."""
    y, x, c = np.meshgrid(np.arange(height), np.arange(width), np.arange(3), indexing="ij")
    count = height * width * 3
    noise = lambda seed, levels: (mixed(seed, count) % levels).reshape(height, width, 3).astype(np.int64)
    truth = (3 * x + 2 * y + 40 * c + noise(1, 48)) % 256
    if pair == "equal":
        image = truth
    elif pair == "noisy":
        image = np.clip(truth + noise(2, 61) - 30, 0, 255)
    elif pair == "other":
        image = (5 * y + noise(3, 200)) % 256
    return truth, image


CASES = [
    ("alex", "-1..1", "noisy", 31, 31),
    ("alex", "-1..1", "other", 64, 48),
    ("alex", "-1..1", "noisy", 97, 131),
    ("alex", "-1..1", "noisy", 35, 1501),
    ("alex", "0..1", "noisy", 97, 131),
    ("alex", "-1..1", "equal", 40, 40),
    ("vgg", "-1..1", "noisy", 16, 16),
    ("vgg", "-1..1", "other", 48, 64),
    ("vgg", "-1..1", "noisy", 37, 53),
    ("vgg", "-1..1", "noisy", 1201, 17),
    ("vgg", "0..1", "noisy", 37, 53),
    ("vgg", "-1..1", "equal", 24, 24),
]


def main():
    networks, cases = {}, []
    for net in ["alex", "vgg"]:
        model = lpips.LPIPS(net=net, pretrained=False, pnet_rand=True, verbose=False)
        own = model.state_dict()
        shapes = {name: list(own[name].shape) for name in own if not name.startswith(("scaling_layer.", "lins."))}
        for name, shape in shapes.items():
            own[name].copy_(weights(name, shape))
        networks[net] = shapes
        for case in [case for case in CASES if case[0] == net]:
            _, input, pair, height, width = case
            values = {}
            for key, kind in [("f64", torch.float64), ("f32", torch.float32)]:
                model = model.to(kind)
                # Bytes become f32 first, as photographs do.
                both = [torch.from_numpy(p.astype(np.float32) / np.float32(255)) for p in pictures(pair, height, width)]
                truth, image = [p.to(kind).permute(2, 0, 1)[None] for p in both]
                with torch.no_grad():
                    values[key] = float(model(image, truth, normalize=input == "-1..1"))
            cases.append(dict(net=net, input=input, pair=pair, height=height, width=width, **values))
            print(cases[-1], abs(values["f32"] / values["f64"] - 1) if values["f64"] else "")
    made_with = {"lpips": "0.1.4", "torch": torch.__version__}
    text = json.dumps(dict(made_with=made_with, networks=networks, cases=cases), indent=1)
    Path(__file__).with_name("reference.json").write_text(text + "\n")


main()

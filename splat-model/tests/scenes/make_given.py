"""Writes given.ply: twenty Gaussians of degree 3 in the original layout, every number another one."""

import math
import struct

COUNT = 20


def value(i, low, high):
    """Between low and high, by the golden ratio: no two the same."""
    share = (0.5 + i * 0.6180339887498949) % 1.0
    return low + (high - low) * share


names = ["x", "y", "z", "nx", "ny", "nz"] + [f"f_dc_{i}" for i in range(3)] + [f"f_rest_{i}" for i in range(45)]
names += ["opacity"] + [f"scale_{i}" for i in range(3)] + [f"rot_{i}" for i in range(4)]
ranges = {"x": (-4, 4), "y": (-4, 4), "z": (-4, 4), "f": (-0.95, 0.95), "opacity": (-5, 5), "scale": (-7, 2), "rot": (-1, 1)}
head = f"ply\nformat binary_little_endian 1.0\nelement vertex {COUNT}\n"
head += "".join(f"property float {name}\n" for name in names) + "end_header\n"
with open("given.ply", "wb") as file:
    file.write(head.encode())
    number = 0
    for _ in range(COUNT):
        row = []
        for name in names:
            number += 1
            span = ranges.get(name) or ranges.get(name.split("_")[0])
            row.append(0.0 if span is None else value(number, *span))
        length = math.sqrt(sum(x * x for x in row[-4:]))
        row[-4:] = [x / length for x in row[-4:]]
        file.write(struct.pack(f"<{len(row)}f", *row))

"""IES profiles of lights: the node that names one, and its peak."""

import re
from pathlib import Path

import bpy

# Candela of a profile that are one watt a steradian for Cycles (intern/cycles/util/ies.cpp).
CANDELA_PER_WATT = 177.83


def node_of(light):
    """The IES texture of a light, if it has one."""
    nodes = light.node_tree.nodes if light.use_nodes and light.node_tree else ()
    return next((node for node in nodes if node.type == "TEX_IES"), None)


def path_of(node, folder):
    """Its file; a text block is written to `folder`."""
    if node.mode == "EXTERNAL":
        return Path(bpy.path.abspath(node.filepath)).resolve()
    path = Path(folder) / (re.sub(r"\W", "_", node.ies.name) + ".ies") if node.ies else None
    if path is not None:
        path.write_text(node.ies.as_string(), encoding="utf-8")
    return path


def peak(path):
    """The largest candela of a profile (LM-63), times its ballast factors; None if it cannot be read."""
    try:
        text = Path(path).read_text(encoding="latin-1")
        tilt, text = re.split(r"TILT\s*=\s*(\w+)", text, maxsplit=1)[1:]
        numbers = [float(number) for number in re.split(r"[\s,]+", text.strip())]
        if tilt == "INCLUDE":  # geometry, number of angles, angles, factors
            numbers = numbers[2 + 2 * int(numbers[1]) :]
        multiplier, verticals, horizontals = numbers[2], int(numbers[3]), int(numbers[4])
        factors = numbers[10] * numbers[11]
        return multiplier * factors * max(numbers[13 + verticals + horizontals :])
    except (OSError, IndexError, ValueError):
        return None

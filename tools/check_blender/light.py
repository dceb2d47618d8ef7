"""relume's light beside that of Cycles: the same room, exported, in numbers for each object."""

import json

import bpy
import numpy
from mathutils import Vector

import pictures
import scene

SIZE = (384, 216)
SAMPLES = 128
# Where all is Lambert: noise of both is below 0.3 % in the mean of an object's pixels.
TOLERANCE = 0.01
# Objects of fewer pixels are too noisy, darker ones have no ratio to speak of.
MIN_PIXELS, MIN_RADIANCE = 20, 1e-4


def seen_objects(size):
    """Which object the camera sees at each pixel's centre, by name; pixels beside another are None."""
    here = bpy.context.scene
    depsgraph = bpy.context.evaluated_depsgraph_get()
    camera = here.camera
    here.render.resolution_x, here.render.resolution_y = size
    right_top = camera.data.view_frame(scene=here)[0]
    names = numpy.empty((size[1], size[0]), object)
    for row, column in numpy.ndindex(names.shape):
        u, v = 2 * (column + 0.5) / size[0] - 1, 1 - 2 * (row + 0.5) / size[1]
        ray = camera.matrix_world.to_3x3() @ Vector((u * right_top.x, v * right_top.y, right_top.z))
        hit, _, _, _, thing, _ = here.ray_cast(depsgraph, camera.matrix_world.translation, ray)
        names[row, column] = thing.name if hit else None
    inner = names.copy()
    for axis, step in ((0, 1), (0, -1), (1, 1), (1, -1)):
        inner[numpy.roll(names, step, axis) != names] = None
    return inner


def compared(relume, image, reference):
    """relume's own figures, on means of 8x8 pixels."""
    figures = json.loads(relume.run("compare", image, reference, "--block", "8", output="stdout"))
    return ", ".join(f"{key} {figures[key]:.4f}" for key in ("rel_rmse", "bias", "flip_mean"))


def table(image, truth, seen):
    """Mean in each object's pixels of both, and their ratio; returns the ratios."""
    print("\n| object | pixels | Cycles | relume / Cycles | red, green, blue |\n|---|---|---|---|---|")
    ratios = {}
    for name in sorted(set(seen.ravel()) - {None}):
        pixels = seen == name
        ours, theirs = image[pixels].mean(axis=0), truth[pixels].mean(axis=0)
        if pixels.sum() >= MIN_PIXELS and theirs.min() > MIN_RADIANCE:
            ratios[name] = ours.mean() / theirs.mean()
            channels = ", ".join(f"{ratio:.3f}" for ratio in ours / theirs)
            print(f"| {name} | {pixels.sum()} | {theirs.mean():.4f} | {ratios[name]:.3f} | {channels} |")
    return ratios


def check(relume):
    """Two rooms in units of Cycles; whether the one of Lambert surfaces has its light.

    The other's materials differ by design: Blender's energy is conserved where glTF's BRDF is not, coats, sheen and glass
    are left out, and Blender exports no index of refraction by itself.
    """
    for name, is_plain in (("rich", False), ("plain", True)):
        scene.room(is_plain)
        file = pictures.export(relume.folder / f"{name}.glb", export_import_convert_lighting_mode="COMPAT")
        seen = seen_objects(SIZE)
        truth = pictures.cycles(SIZE, 2 * SAMPLES, relume.folder / f"{name}-cycles.exr")
        options = ("--spp", SAMPLES, "--filter", "box", "--passes", "beauty")
        image, said = relume.picture(file, f"{name}-relume", SIZE, *options, command="reference")
        print(f"\n{name}: {compared(relume, relume.folder / f'{name}-relume.exr', relume.folder / f'{name}-cycles.exr')}")
        ratios = table(image, truth, seen)
    return max(abs(ratio - 1) for ratio in ratios.values()) <= TOLERANCE

"""Each kind of light by itself: Cycles beside relume, through the add-on."""


import bpy
import numpy

import addon
import pictures

SAMPLES = 512
# Blocks of Cycles' own noise.
BLOCK = 8
KINDS = {
    "point": ("POINT", dict(energy=80)),
    "point, radius 0.2 m": ("POINT", dict(energy=80, shadow_soft_size=0.2)),
    "point, 3200 K, 1 stop": ("POINT", dict(energy=40, use_temperature=True, temperature=3200, exposure=1)),
    "spot, blend 0": ("SPOT", dict(energy=300, spot_size=0.9, spot_blend=0.0)),
    "spot, blend 0.5": ("SPOT", dict(energy=300, spot_size=0.9, spot_blend=0.5)),
    "spot, blend 1": ("SPOT", dict(energy=300, spot_size=0.9, spot_blend=1.0)),
    "spot, radius 0.1 m": ("SPOT", dict(energy=300, spot_size=0.9, spot_blend=0.15, shadow_soft_size=0.1)),
    "sun": ("SUN", dict(energy=2, angle=0.0)),
    "sun, 10 degrees": ("SUN", dict(energy=2, angle=0.1745)),
    "area, square": ("AREA", dict(energy=60, size=0.8)),
    "area, rectangle, spread 90": ("AREA", dict(energy=60, shape="RECTANGLE", size=1.0, size_y=0.4, spread=1.5708)),
    "area, disk": ("AREA", dict(energy=60, shape="DISK", size=0.8)),
    "area, ellipse 2:1": ("AREA", dict(energy=60, shape="ELLIPSE", size=1.0, size_y=0.5)),
}
PLACE, TURN = (1.2, -1.5, 2.6), (40, 15, 20)


def lit(kind, values, folder):
    """The room with one light, or with the world alone; returns what made it."""
    addon.room()
    if kind is None:
        values(bpy.context.scene.world, folder)
    else:
        light = addon.new_light("light", kind, PLACE, TURN, **values)
        # What the camera sees of the light itself is not compared.
        light.visible_camera = False


def grey(world, _folder):
    background = world.node_tree.nodes["Background"]
    background.inputs["Color"].default_value, background.inputs["Strength"].default_value = (0.3, 0.4, 0.5, 1), 0.5


def check(relume):
    """A table: mean of relume over that of Cycles, and how far pictures are apart in blocks of 8x8 pixels."""
    package = addon.load()
    export, watts = package.live.export, package.live.lights.LUMENS_PER_WATT
    kinds = {**KINDS, "world, one colour": (None, grey), "world, a map turned by 40 degrees": (None, addon.sky)}
    print(f"\n| light | relume / Cycles | rel_rmse, {BLOCK}x{BLOCK} | bias |\n|---|---|---|---|")
    worst = 0.0
    for name, (kind, values) in kinds.items():
        lit(kind, values, relume.folder)
        here = bpy.context.scene
        if not (relume.folder / "kinds.glb").exists():
            export.write_scene(here, relume.folder / "kinds.glb")
        export.write_rig(export.entries(here, relume.folder), relume.folder / "kinds.toml")
        truth = pictures.cycles(addon.SIZE, SAMPLES, relume.folder / "cycles.exr")
        options = ("--rig", relume.folder / "kinds.toml", "--samples", 4, "--final", "1%")
        image, _ = relume.picture(relume.folder / "kinds.glb", "kinds", addon.SIZE, *options)
        apart = compared(image / watts, truth)
        worst = max(worst, abs(apart[0] - 1))
        print("| {} | {:.4f} | {:.4f} | {:+.4f} |".format(name, *apart), flush=True)
    return worst < 0.02


def compared(image, truth):
    """Ratio of means, relative RMSE and bias on blocks."""
    def blocks(picture):
        height, width, _ = picture.shape
        return picture.reshape(height // BLOCK, BLOCK, width // BLOCK, BLOCK, 3).mean(axis=(1, 3))

    ours, theirs = blocks(image), blocks(truth)
    difference = ours - theirs
    return ours.mean() / theirs.mean(), numpy.linalg.norm(difference) / numpy.linalg.norm(theirs), difference.mean() / theirs.mean()

"""The add-on from its source, and a room with every kind of light."""

import importlib.util
import math
import sys
from pathlib import Path

import bpy

import scene as scenes

SIZE = (192, 128)
SOURCE = Path(__file__).resolve().parents[2] / "blender"


def load():
    """The add-on's package, with its handlers at work, as Blender would load it from its zip."""
    if "relume_addon" not in sys.modules:
        places = dict(submodule_search_locations=[str(SOURCE)])
        spec = importlib.util.spec_from_file_location("relume_addon", SOURCE / "__init__.py", **places)
        addon = sys.modules["relume_addon"] = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(addon)
        for handlers, handler in addon.HANDLERS:
            handlers.append(handler)
    return sys.modules["relume_addon"]


def new_light(name, kind, location=(0, 0, 2), rotation=(0, 0, 0), scale=(1, 1, 1), **values):
    data = bpy.data.lights.new(name, kind)
    for key, value in values.items():
        setattr(data, key, value)
    return scenes.link(name, data, location, rotation, scale)


def room():
    """A floor, two walls and a block, all Lambert; a black world."""
    scenes.empty_file()
    boxes = (
        ("floor", (0, 0, 0), (8, 8, 0.1), (0.6, 0.6, 0.6)),
        ("wall.001", (0, 3, 1.5), (8, 0.1, 3), (0.6, 0.4, 0.3)),
        ("side", (-3, 0, 1.5), (0.1, 8, 3), (0.3, 0.5, 0.6)),
        ("block", (0.5, 0, 0.55), (0.6, 0.8, 1.0), (0.7, 0.7, 0.7)),
    )
    for name, location, size, color in boxes:
        scenes.link(name, scenes.box(name, size, scenes.lambert(name, color)), location)
    here = bpy.context.scene
    here.camera = scenes.link("camera", bpy.data.cameras.new("camera"), (1, -6, 2.5), (70, 0, 8))
    here.render.resolution_x, here.render.resolution_y = SIZE


def lit_room(folder):
    """The room with every kind of light."""
    room()
    here = bpy.context.scene
    new_light("bulb", "POINT", (1, -1, 2), energy=80, shadow_soft_size=0.1, color=(1, 0.8, 0.6))
    new_light("warm.001", "POINT", (-1, -1, 2), energy=40, use_temperature=True, temperature=3200)
    spot = new_light("spot", "SPOT", (2, -2, 3), (35, 10, 40), energy=300, spot_size=0.9, spot_blend=0.4, shadow_soft_size=0.05)
    new_light("sun", "SUN", rotation=(30, 20, 0), energy=0.5, angle=0.02)
    new_light("square", "AREA", (-2, 0, 2.5), (0, -50, 0), (2, 2, 1), energy=60, size=0.5)
    new_light("softbox", "AREA", (0, -2, 3), (20, 0, 15), energy=90, shape="RECTANGLE", size=1.0, size_y=0.4, spread=2.0)
    new_light("disk", "AREA", (2, 1, 2), (0, 60, 0), energy=50, shape="DISK", size=0.6, exposure=0.5)
    new_light("oval", "AREA", (-2, 2, 2), (0, -60, 0), energy=50, shape="ELLIPSE", size=0.6, size_y=0.3)
    parent = scenes.link("stand", None, (0.5, 0, 0), (0, 0, 30))
    spot.parent = parent
    bpy.context.view_layer.lightgroups.add(name="practicals")
    bpy.data.objects["bulb"].lightgroup = "practicals"
    receivers = bpy.data.collections.new("only the block")
    receivers.objects.link(bpy.data.objects["block"])
    bpy.data.objects["disk"].light_linking.receiver_collection = receivers
    sky(here.world, folder)
    bpy.context.view_layer.update()


def sky(world, folder):
    """A small HDR map, turned by 40 degrees."""
    image = bpy.data.images.new("sky", 32, 16, float_buffer=True, is_data=True)
    image.pixels = [c for y in range(16) for x in range(32) for c in (0.1 + 0.2 * (x > 20), 0.15, 0.2 + y / 32, 1)]
    image.filepath_raw, image.file_format = str(folder / "sky.exr"), "OPEN_EXR"
    image.save()
    nodes, links = world.node_tree.nodes, world.node_tree.links
    texture, mapping, place = (nodes.new(f"ShaderNode{kind}") for kind in ("TexEnvironment", "Mapping", "TexCoord"))
    texture.image = bpy.data.images.load(str(folder / "sky.exr"))
    texture.image.colorspace_settings.name = "Linear Rec.709"  # a file of data has none
    mapping.inputs["Rotation"].default_value[2] = math.radians(40)
    links.new(place.outputs["Generated"], mapping.inputs["Vector"])
    links.new(mapping.outputs["Vector"], texture.inputs["Vector"])
    links.new(texture.outputs["Color"], nodes["Background"].inputs["Color"])
    nodes["Background"].inputs["Strength"].default_value = 0.3

"""The world as one more light: a dome."""

import array
import math
from pathlib import Path

import bpy
from mathutils import Color

from .lights import LUMENS_PER_WATT

# Blender's +x is the middle of a map, relume's is +z; both turn counter-clockwise as seen from above.
MIDDLE_DEG = 90.0
# Colour spaces whose numbers are radiance, as relume reads EXR and Radiance files.
# Files of images that were written, by what they depend on.
WRITTEN = {}
LINEAR = {"Linear Rec.709", "Non-Color", "scene_linear", "Linear"}


def background_of(world):
    nodes = world.node_tree.nodes if world and world.node_tree else ()
    return next((node for node in nodes if node.type == "BACKGROUND"), None)


def source(socket, kind):
    """The node of this kind that feeds a socket."""
    node = socket.links[0].from_node if socket.links else None
    return node if node and node.type == kind else None


def texture_of(world):
    background = background_of(world)
    texture = source(background.inputs["Color"], "TEX_ENVIRONMENT") if background else None
    return texture if texture and texture.image else None


def turn_of(texture):
    """The rotation of a map about +z, radians counter-clockwise."""
    mapping = source(texture.inputs["Vector"], "MAPPING")
    return -mapping.inputs["Rotation"].default_value[2] if mapping else 0.0


def image_path(image, folder):
    """The file of an image. One that has none, or that Blender reads in another colour space, is written to `folder`. None
    if there are no pixels."""
    path = Path(bpy.path.abspath(image.filepath))
    usual = LINEAR if path.suffix.lower() in {".exr", ".hdr"} else {"sRGB"}
    is_usual = image.source in {"FILE", "GENERATED"} and image.colorspace_settings.name in usual
    if is_usual and not image.packed_file and path.is_file():
        return path.resolve()
    key = (image.session_uid, tuple(image.size), image.colorspace_settings.name, image.is_dirty)
    if key not in WRITTEN or not WRITTEN[key].exists():
        name = f"{bpy.path.clean_name(image.name)}-{len(WRITTEN)}"
        packed = image.packed_file if is_usual else None
        WRITTEN[key] = write_packed(packed, folder, name + path.suffix) if packed else write_linear(image, folder, name)
    return WRITTEN[key]


def write_packed(packed, folder, name):
    path = Path(folder) / name
    path.write_bytes(packed.data)
    return path


def write_linear(image, folder, name):
    """Scene-linear, as EXR."""
    width, height = image.size
    pixels = array.array("f", bytes(4 * len(image.pixels)))
    if len(pixels) != 4 * width * height or not pixels:
        return None
    image.pixels.foreach_get(pixels)
    if not image.is_float and image.colorspace_settings.name == "sRGB":  # bytes come as they are stored
        pixels = array.array("f", (Color((x, 0, 0)).from_srgb_to_scene_linear().r for x in pixels))
    path = (Path(folder) / name).with_suffix(".exr")
    copy = bpy.data.images.new("relume", width, height, float_buffer=True, is_data=True)
    copy.pixels.foreach_set(pixels)
    copy.filepath_raw, copy.file_format = str(path), "OPEN_EXR"
    copy.save()
    bpy.data.images.remove(copy)
    return path


def entry_of(world, folder):
    """The world as a dome; None if it is black."""
    background = background_of(world)
    if background is None:
        return None
    strength = background.inputs["Strength"].default_value
    entry = {"kind": "dome", "color": [1.0, 1.0, 1.0], "intensity": LUMENS_PER_WATT * strength, "visible": True}
    texture = texture_of(world)
    path = image_path(texture.image, folder) if texture else None
    if path:
        entry["map"] = str(path)
        entry["rotate_deg"] = MIDDLE_DEG + math.degrees(turn_of(texture))
        return entry
    entry["color"] = list(background.inputs["Color"].default_value)[:3]
    return entry if max(entry["color"]) * strength > 0 else None


def apply(world, entry, changed):
    """Gives the world the values of relume's entry that `changed` names; None makes it black."""
    background = background_of(world)
    if entry is None or not entry.get("enabled", True):
        background.inputs["Strength"].default_value = 0.0
        return
    if changed & {"intensity", "stops", "enabled"}:
        strength = entry.get("intensity", 1.0) * 2 ** entry.get("stops", 0.0) / LUMENS_PER_WATT
        background.inputs["Strength"].default_value = strength
    if "map" in changed and entry.get("map"):
        texture = texture_of(world) or new_texture(world, background)
        texture.image = bpy.data.images.load(entry["map"], check_existing=True)
    texture = texture_of(world)
    if "color" in changed and not texture:
        background.inputs["Color"].default_value = (*entry["color"], 1.0)
    if "rotate_deg" in changed and texture:
        mapping = source(texture.inputs["Vector"], "MAPPING") or new_mapping(world, texture)
        mapping.inputs["Rotation"].default_value[2] = -math.radians(entry.get("rotate_deg", 0.0) - MIDDLE_DEG)


def new(name):
    """A black world."""
    made = bpy.data.worlds.new(name)
    if background_of(made) is None:  # before Blender 5 a world has no nodes by itself
        made.use_nodes = True
    background_of(made).inputs["Strength"].default_value = 0.0
    return made


def new_texture(world, background):
    texture = world.node_tree.nodes.new("ShaderNodeTexEnvironment")
    world.node_tree.links.new(texture.outputs["Color"], background.inputs["Color"])
    return texture


def new_mapping(world, texture):
    nodes, links = world.node_tree.nodes, world.node_tree.links
    mapping, coordinates = nodes.new("ShaderNodeMapping"), nodes.new("ShaderNodeTexCoord")
    links.new(coordinates.outputs["Generated"], mapping.inputs["Vector"])
    links.new(mapping.outputs["Vector"], texture.inputs["Vector"])
    return mapping

"""The world as one more light: a dome."""

import array
import json
import math
from pathlib import Path

import bpy
from mathutils import Color

from .lights import LINKS, LUMENS_PER_WATT, PROPERTY

# Blender's +x is the middle of a map, relume's is +z; both turn counter-clockwise as seen from above.
MIDDLE_DEG = 90.0
# What a dome may have in relume and a world not: kept with the world.
ONLY_RELUME = ("physical_sky", "group", "follows", "solo", "factor", "shadows", *LINKS)
# Files of images that were written, by what they depend on.
WRITTEN = {}
# Colour spaces whose numbers are radiance, as relume reads EXR and Radiance files.
LINEAR = {"Linear Rec.709", "Non-Color", "scene_linear", "Linear"}


def uses_nodes(world):
    """Before Blender 5 a world may have one colour and no nodes."""
    return bool(world.node_tree) and world.use_nodes


def background_of(world):
    """The node that is the world, if that is a background."""
    output = world.node_tree.get_output_node("ALL") if world and uses_nodes(world) else None
    return source(output.inputs["Surface"], "BACKGROUND") if output else None


def source(socket, kind):
    """The node of this kind that feeds a socket."""
    node = socket.links[0].from_node if socket.links else None
    return node if node and node.type == kind else None


def texture_of(world):
    background = background_of(world)
    return source(background.inputs["Color"], "TEX_ENVIRONMENT") if background else None


def problem_of(world):
    """Why relume cannot have this world, or None."""
    if world is None or not uses_nodes(world):
        return None
    background, texture = background_of(world), texture_of(world)
    if background is None:
        output = world.node_tree.get_output_node("ALL")
        is_black = output is None or not output.inputs["Surface"].links
        return None if is_black else "the world is no background"
    if background.inputs["Strength"].links or background.inputs["Color"].links and texture is None:
        return "the world's background has other nodes than one map"
    if texture is None:
        return None
    if texture.image is None or is_missing(texture.image):
        return "the world's map is missing"
    if texture.projection != "EQUIRECTANGULAR":
        return "the world's map is a mirror ball"
    vector, mapping = texture.inputs["Vector"], source(texture.inputs["Vector"], "MAPPING")
    if mapping is None:
        return None if not vector.links or source(vector, "TEX_COORD") else "the world's map is placed by other nodes"
    values = [mapping.inputs[name].default_value for name in ("Location", "Scale") if name in mapping.inputs]
    is_plain = all(tuple(value) in {(0.0, 0.0, 0.0), (1.0, 1.0, 1.0)} for value in values)
    is_upright = tuple(mapping.inputs["Rotation"].default_value[:2]) == (0.0, 0.0)
    if mapping.vector_type not in {"POINT", "TEXTURE"} or not is_plain or not is_upright:
        return "the world's map is not only turned about Z"
    return None


def is_missing(image):
    is_file = image.source == "FILE" and not image.packed_file and not image.has_data
    return is_file and not Path(bpy.path.abspath(image.filepath)).is_file()


def turn_of(texture):
    """The rotation of a map about +z, radians counter-clockwise."""
    mapping = source(texture.inputs["Vector"], "MAPPING")
    turn = mapping.inputs["Rotation"].default_value[2] if mapping else 0.0
    return turn if mapping and mapping.vector_type == "TEXTURE" else -turn


def image_path(image, folder):
    """The file of an image. One that has none, or that Blender reads in another colour space, is written to `folder`. None
    if there are no pixels."""
    path = Path(bpy.path.abspath(image.filepath))
    usual = LINEAR if path.suffix.lower() in {".exr", ".hdr"} else {"sRGB"}
    is_usual = image.source in {"FILE", "GENERATED"} and image.colorspace_settings.name in usual
    if is_usual and not image.packed_file and path.is_file():
        return path.resolve()
    key = (image.session_uid, tuple(image.size), image.colorspace_settings.name, image.is_dirty)
    if WRITTEN.get(key) is None or not WRITTEN[key].exists():
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
    """The world as a dome; None if it is black, or has a problem."""
    if world is None or problem_of(world):
        return None
    background, texture = background_of(world), texture_of(world)
    color, strength = world.color, 1.0
    if background:
        color, strength = background.inputs["Color"].default_value, background.inputs["Strength"].default_value
    elif uses_nodes(world):
        return None
    entry = {"kind": "dome", "color": [1.0, 1.0, 1.0], "intensity": LUMENS_PER_WATT * strength, "visible": True}
    path = image_path(texture.image, folder) if texture else None
    if texture and path is None:
        return None
    if texture:
        entry["map"] = str(path)
        entry["rotate_deg"] = MIDDLE_DEG + math.degrees(turn_of(texture))
    else:
        entry["color"] = list(color)[:3]
    entry.update(json.loads(world.get(PROPERTY, "{}")))
    return entry if max(entry["color"]) * strength > 0 else None


def apply(world, entry, changed):
    """Gives the world the values of relume's entry that `changed` names; None makes it black."""
    background = background_of(world) or new_background(world)
    if entry is None:
        background.inputs["Strength"].default_value = 0.0
        return
    if changed & {"intensity", "stops"}:
        strength = entry.get("intensity", 1.0) * 2 ** entry.get("stops", 0.0) / LUMENS_PER_WATT
        background.inputs["Strength"].default_value = strength
    if "map" in changed and entry.get("map"):
        texture = texture_of(world) or new_texture(world, background)
        texture.image = bpy.data.images.load(entry["map"], check_existing=True)
    elif "map" in changed:
        for link in background.inputs["Color"].links:
            world.node_tree.links.remove(link)
    texture = texture_of(world)
    if changed & {"color", "map"} and not texture:
        background.inputs["Color"].default_value = (*entry.get("color", [1.0, 1.0, 1.0]), 1.0)
    if "rotate_deg" in changed and texture:
        mapping = source(texture.inputs["Vector"], "MAPPING") or new_mapping(world, texture)
        turn = math.radians(entry.get("rotate_deg", 0.0) - MIDDLE_DEG)
        mapping.inputs["Rotation"].default_value[2] = turn if mapping.vector_type == "TEXTURE" else -turn
    extras = {key: entry[key] for key in ONLY_RELUME if key in entry}
    if texture and "color" in entry:
        extras["color"] = entry["color"]
    extras |= {key: False for key, usual in (("enabled", True), ("visible", False)) if entry.get(key, usual) is False}
    if extras:
        world[PROPERTY] = json.dumps(extras)
    elif PROPERTY in world:
        del world[PROPERTY]


def new_background(world):
    """A background, black, in a world that has none."""
    if not uses_nodes(world):
        world.use_nodes = True
        if background_of(world):  # Blender made one
            return background_of(world)
    nodes, links = world.node_tree.nodes, world.node_tree.links
    output = world.node_tree.get_output_node("ALL") or nodes.new("ShaderNodeOutputWorld")
    background = nodes.new("ShaderNodeBackground")
    background.inputs["Strength"].default_value = 0.0
    links.new(background.outputs["Background"], output.inputs["Surface"])
    return background


def new(name):
    """A black world."""
    made = bpy.data.worlds.new(name)
    (background_of(made) or new_background(made)).inputs["Strength"].default_value = 0.0
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

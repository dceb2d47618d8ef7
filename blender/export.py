"""What relume opens: camera, geometry and materials as glTF, lights as a rig."""

import hashlib
import json
import math
import os
from pathlib import Path

import bpy

from . import lights, rendered, world


def folder_of(scene):
    """A private folder for exported files: the same after a restart, if the .blend file has been saved."""
    base = os.environ.get("XDG_CACHE_HOME") or os.environ.get("LOCALAPPDATA") or Path.home() / ".cache"
    of = bpy.data.filepath or str(os.getpid())
    name = f"{Path(of).stem}-{hashlib.sha256(f'{of}/{scene.name}'.encode()).hexdigest()[:8]}"
    folder = Path(base) / "relume" / "blender" / name
    folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    return folder


def keys(scene):
    """The light objects by their names in relume."""
    named = {}
    for thing in lights.lights(scene):
        key, number = lights.key_of(thing.name), 2
        while key in named:
            key, number = f"{lights.key_of(thing.name)}_{number}", number + 1
        named[key] = thing
    return named


def world_key(scene):
    return lights.key_of(scene.world.name) if scene.world else None


def entries(scene, folder):
    """All lights of a scene as relume's entries, by key."""
    rendered.view_layer(scene).update()
    found = {key: lights.entry_of(thing, scene, folder) for key, thing in keys(scene).items()}
    dome = world.entry_of(scene.world, folder)
    if dome:
        found[world_key(scene)] = dome
    return found


def shown(scene):
    """Names of the objects that are exported."""
    things = rendered.objects(scene)
    return {thing.name for thing in things if thing.type not in {"LIGHT", "EMPTY"} and not thing.hide_render}


def write_scene(scene, path):
    """Camera, geometry and materials, as they are at this frame."""
    written = path.with_name(f"{path.stem}-new{path.suffix}")
    with bpy.context.temp_override(scene=scene, view_layer=rendered.view_layer(scene)):
        bpy.ops.export_scene.gltf(
            filepath=str(written),
            export_format="GLB",
            export_cameras=True,
            export_lights=False,
            export_apply=True,
            export_animations=False,
            export_current_frame=True,
            export_rest_position_armature=False,
            export_gn_mesh=True,
            use_active_scene=True,
            use_renderable=True,
        )
    written.replace(path)  # relume may be reading the one before


def write_rig(found, path):
    """Lights as a rig file."""
    groups = sorted({entry["group"] for entry in found.values() if "group" in entry})
    lines = [f"[[group]]\nname = {toml(group)}" for group in groups]
    for key, entry in found.items():
        values = {"name": key, **entry}
        lines.append("[[light]]\n" + "\n".join(f"{name} = {toml(value)}" for name, value in values.items()))
    path.write_text("\n\n".join(lines) + "\n", encoding="utf-8")


def toml(value):
    """A value in TOML, whose strings, numbers and lists are those of JSON."""
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{toml(key)} = {toml(item)}" for key, item in value.items()) + " }"
    if isinstance(value, (list, tuple)):
        return "[" + ", ".join(map(toml, value)) + "]"
    return json.dumps(value, ensure_ascii=False)


def picture(scene):
    """Options of `relume view` for the size and camera that Blender would render."""
    render = scene.render
    # relume's pixels are square: the side along which Blender's are longer gets more of them.
    aspect = render.pixel_aspect_x / render.pixel_aspect_y
    sides = (render.resolution_x * max(1.0, aspect), render.resolution_y * max(1.0, 1 / aspect))
    size = [max(1, int(side * render.resolution_percentage / 100)) for side in sides]
    chosen = ("--size", "{}x{}".format(*size))
    return (*chosen, "--camera", scene.camera.name) if scene.camera else chosen


def exposure(scene):
    """Blender's, in stops: relume counts candela where Blender counts watts."""
    return f"{scene.view_settings.exposure - math.log2(lights.LUMENS_PER_WATT):.3f}"


def working_space():
    """The space that Blender's colours are in; before Blender 5 a file does not say."""
    return getattr(getattr(bpy.data, "colorspace", None), "working_space", "Linear Rec.709")

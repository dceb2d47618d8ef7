"""Blender's lights as entries of a relume rig, and back.

Blender is Z-up and counts watts, relume is Y-up and counts candela: 683 lm/W, as Blender's own glTF exporter has it.
"""

import json
import math

import bpy
from mathutils import Color, Euler, Matrix, Vector

from . import ies, links, rendered

LUMENS_PER_WATT = 683.0
KINDS = {"POINT": "point", "SPOT": "spot", "SUN": "directional"}
TYPES = {"point": "POINT", "spot": "SPOT", "directional": "SUN", "rect": "AREA", "disk": "AREA"}
# What a light may have in relume and not in Blender: kept with the object.
ONLY_RELUME = (
    *("range", "decay_start", "gobo", "barn_doors_deg", "barn_doors_soft_deg"),
    *("two_sided", "factor", "solo", "follows"),
)
PROPERTY = "relume"
# Keys of an entry that only some lights of Blender have.
LINKS = ("only", "except", "no_shadow_from")
OPTIONAL = (*LINKS, "group", "ies", "map")


def key_of(name):
    """A light's name in relume: names of layers are parted by dots there."""
    return name.replace(".", "_")


def to_relume(v):
    return [v[0], v[2], -v[1]]


def to_blender(v):
    return Vector((v[0], -v[2], v[1]))


def lights(scene):
    """The light objects of a scene that are rendered. Portals are none: they only tell Cycles where to look."""
    found = [thing for thing in rendered.objects(scene) if thing.type == "LIGHT"]
    return [thing for thing in found if not getattr(getattr(thing.data, "cycles", None), "is_portal", False)]


def kind_of(light):
    if light.type == "AREA":
        return "disk" if light.shape in {"DISK", "ELLIPSE"} else "rect"
    return KINDS[light.type]


def sizes(thing):
    """Width and height of an area light, metres."""
    light, scale = thing.data, thing.matrix_world.to_scale()
    height = light.size_y if light.shape in {"RECTANGLE", "ELLIPSE"} else light.size
    return light.size * abs(scale.x), height * abs(scale.y)


def candela_per_watt(thing, folder=None):
    """relume's intensity of a light of one watt: candela straight ahead, or lux."""
    light = thing.data
    per_watt = LUMENS_PER_WATT
    if light.type in {"POINT", "SPOT"}:
        per_watt /= 4 * math.pi
    elif light.type == "AREA":
        half = math.radians(spread_deg(light)) / 2
        per_watt /= math.pi * (1 - half / math.tan(half))
    if not getattr(light, "normalize", True):
        per_watt *= area(thing)
    node = ies.node_of(light) if light.type in {"POINT", "SPOT"} else None
    path = node and folder and ies.path_of(node, folder)
    if path and ies.peak(path):
        per_watt *= 4 * math.pi * ies.peak(path) / ies.CANDELA_PER_WATT * node.inputs["Strength"].default_value
    return per_watt


def area(thing):
    """By what Blender multiplies the power of a light that is not normalized, square metres."""
    light = thing.data
    if light.type == "AREA":
        width, height = sizes(thing)
        return width * height * (math.pi / 4 if kind_of(light) == "disk" else 1)
    if light.type == "SUN":
        return math.pi * math.sin(light.angle / 2) ** 2 or 1.0
    return math.pi * light.shadow_soft_size**2 or 1.0


# Over the fade of a spot, from the edge to full intensity in the cosine, glTF's squared ramp has the mean 1/3, Cycles'
# smoothstep 1/2. A fade of 3/4 of the width loses as much light: 3/4 (1 - 1/3) = 1 - 1/2.
FADE = 0.75


def inner_angle(outer, of_blend):
    """Where relume's spot begins to fade, radians."""
    edge = math.cos(outer)
    return min(math.acos(min(1.0, edge + FADE * of_blend * (1 - edge))), outer)


def blend(inner, outer):
    edge = math.cos(outer)
    return min(1.0, max(0.0, (math.cos(inner) - edge) / (FADE * (1 - edge)))) if edge < 1 else 0.0


def spread_deg(light):
    """In relume's range; pi in single precision is a little more."""
    return min(max(math.degrees(light.spread), 0.01), 180.0)


def tint(light):
    """What a light's temperature multiplies its colour by."""
    if not getattr(light, "use_temperature", False):
        return (1.0, 1.0, 1.0)
    return tuple(light.temperature_color)


def entry_of(thing, scene, folder):
    """A light as relume's entry."""
    light, matrix = thing.data, thing.matrix_world
    kind = kind_of(light)
    entry = {
        "kind": kind,
        "color": [max(0.0, c * t) for c, t in zip(light.color, tint(light))],
        # Blender subtracts light of less than no watts, nobody else can.
        "intensity": max(0.0, light.energy) * candela_per_watt(thing, folder),
        "stops": getattr(light, "exposure", 0.0),
        "enabled": not thing.hide_render,
        "shadows": light.use_shadow,
    }
    if kind != "directional":
        entry["position"] = to_relume(matrix.translation)
    if kind != "point" or light.use_nodes:  # a profile has a direction
        entry["direction"] = to_relume(-matrix.col[2].xyz.normalized())
        entry["up"] = to_relume(matrix.col[1].xyz.normalized())
    if kind in {"point", "spot"}:
        entry["radius"] = light.shadow_soft_size
    if kind == "spot":
        entry["outer_deg"] = math.degrees(light.spot_size / 2)
        entry["inner_deg"] = math.degrees(inner_angle(light.spot_size / 2, light.spot_blend))
    elif kind == "directional":
        entry["angle_deg"] = math.degrees(light.angle)
    elif kind == "rect":
        entry["width"], entry["height"] = sizes(thing)
        entry["spread_deg"] = spread_deg(light)
    elif kind == "disk":
        width, height = sizes(thing)
        entry["radius"] = math.sqrt(width * height) / 2
        entry["spread_deg"] = spread_deg(light)
    has_size = kind in {"rect", "disk"} or kind == "point" and light.shadow_soft_size > 0
    entry["visible"] = has_size and thing.visible_camera
    if thing.lightgroup:
        entry["group"] = key_of(thing.lightgroup)
    if folder and light.type in {"POINT", "SPOT"} and ies.node_of(light):
        path = ies.path_of(ies.node_of(light), folder)
        if path and ies.peak(path):
            entry["ies"] = str(path)
    entry.update(links.links_of(thing, scene))
    entry.update(json.loads(thing.get(PROPERTY, "{}")))
    return entry


def new(scene, key, entry):
    """A new light object for a light of relume; Blender may call it otherwise."""
    light = bpy.data.lights.new(key, TYPES[entry["kind"]])
    thing = bpy.data.objects.new(key, light)
    scene.collection.objects.link(thing)
    apply(thing, scene, entry, set(entry), None)


def apply(thing, scene, entry, changed, folder):
    """Gives a light object the values of relume's entry that `changed` names; what the entry lacks is relume's default."""
    light = thing.data
    kind = entry["kind"]
    if "kind" in changed:
        light.type = TYPES[kind]
        light = light.type_recast()
        if kind in {"rect", "disk"} and kind_of(light) != kind:
            light.shape = "RECTANGLE" if kind == "rect" else "DISK"
    place(thing, entry, changed)
    if "color" in changed:
        set_color(light, entry.get("color", [1.0, 1.0, 1.0]))
    size(thing, entry, changed)
    # After the size, on which watts may depend.
    if changed & {"intensity", "stops", "spread_deg", "kind", "ies"}:
        stops = entry.get("stops", 0.0)
        if hasattr(light, "exposure"):
            light.exposure, stops = stops, 0.0
        per_watt = candela_per_watt(thing, folder)
        if per_watt > 0:
            light.energy = entry.get("intensity", 1.0) * 2**stops / per_watt
    if "enabled" in changed:
        thing.hide_render = not entry.get("enabled", True)
    if "shadows" in changed:
        light.use_shadow = entry.get("shadows", True)
    if "visible" in changed:
        thing.visible_camera = entry.get("visible", False)
    if "group" in changed:
        group = entry.get("group", "")
        layer = rendered.view_layer(scene)
        known = next((known.name for known in layer.lightgroups if key_of(known.name) == group), None)
        if group and known is None:
            known = layer.lightgroups.add(name=group).name
        thing.lightgroup = known or ""
    if changed & set(LINKS):
        links.link(thing, entry)
    extras = {key: entry[key] for key in ONLY_RELUME if key in entry}
    extras |= {key: entry[key] for key in LINKS if links.has_others(entry.get(key, ()))}
    if extras:
        thing[PROPERTY] = json.dumps(extras)
    elif PROPERTY in thing:
        del thing[PROPERTY]


def place(thing, entry, changed):
    if not changed & {"position", "direction", "up"}:
        return
    matrix = thing.matrix_world.copy()
    location, rotation, scale = matrix.decompose()
    if "position" in entry and "position" in changed:
        location = to_blender(entry["position"])
    if "direction" in entry and changed & {"direction", "up"}:
        back = -to_blender(entry["direction"]).normalized()
        up = to_blender(entry["up"]) if "up" in entry else rotation @ Vector((0, 1, 0))
        right = up.cross(back)
        if right.length < 1e-6:  # as relume does: up along the direction
            right = Vector((0, 1, 0)).cross(back) if abs(back.y) < 0.9 else Vector((1, 0, 0)).cross(back)
        right.normalize()
        # Once more: little is left of the difference of directions that are nearly the same.
        right = (right - back * right.dot(back)).normalized()
        rotation = Matrix((right, back.cross(right), back)).transposed().to_quaternion()
    thing.matrix_world = target = Matrix.LocRotScale(location, rotation, scale)
    has_deltas = any(thing.delta_rotation_euler) or any(scale != 1 for scale in thing.delta_scale)
    if thing.rotation_mode == "XYZ" and thing.parent_type == "OBJECT" and not has_deltas:
        parent = thing.parent.matrix_world @ thing.matrix_parent_inverse if thing.parent else Matrix()
        thing.rotation_euler = euler((parent.inverted_safe() @ target).to_3x3().normalized())


def euler(m):
    """Angles of a rotation. Blender's own lose four digits where the second one is a right angle."""
    x = math.atan2(m[2][1], m[2][2])
    sin, cos = math.sin(x), math.cos(x)
    y = math.atan2(-m[2][0], math.hypot(m[0][0], m[1][0]))
    return Euler((x, y, math.atan2(sin * m[0][2] - cos * m[0][1], cos * m[1][1] - sin * m[1][2])))


def set_color(light, color):
    """Sets the colour; a temperature stays one, and the tint beside it becomes the colour."""
    if getattr(light, "use_temperature", False) and min(color) > 0:
        low, high = 800.0, 20000.0
        wanted = color[0] / color[2]
        for _ in range(40):
            light.temperature = (low + high) / 2
            red, _, blue = light.temperature_color
            low, high = (light.temperature, high) if blue <= 0 or red / blue > wanted else (low, light.temperature)
    elif getattr(light, "use_temperature", False):
        light.use_temperature = False
    light.color = Color([c / t if t > 0 else c for c, t in zip(color, tint(light))])


def size(thing, entry, changed):
    light, kind = thing.data, entry["kind"]
    if kind in {"point", "spot"} and "radius" in changed:
        light.shadow_soft_size = entry.get("radius", 0.0)
    if kind == "spot" and changed & {"inner_deg", "outer_deg"}:
        inner, outer = entry.get("inner_deg", 0.0), entry.get("outer_deg", 45.0)
        light.spot_size = math.radians(2 * outer)
        light.spot_blend = blend(math.radians(inner), light.spot_size / 2)
    if kind == "directional" and "angle_deg" in changed:
        light.angle = math.radians(entry.get("angle_deg", 0.0))
    if kind not in {"rect", "disk"}:
        return
    scale = [abs(s) or 1.0 for s in thing.matrix_world.to_scale()]
    if kind == "rect" and changed & {"width", "height"}:
        light.size, size_y = entry["width"] / scale[0], entry["height"] / scale[1]
        if light.shape == "SQUARE" and not math.isclose(light.size, size_y, rel_tol=1e-6):
            light.shape = "RECTANGLE"
        if light.shape == "RECTANGLE":
            light.size_y = size_y
    if kind == "disk" and "radius" in changed:
        width, height = sizes(thing)
        if width * height > 0:
            factor = 2 * entry["radius"] / math.sqrt(width * height)
            light.size, light.size_y = light.size * factor, light.size_y * factor
        else:
            light.size, light.size_y = 2 * entry["radius"] / scale[0], 2 * entry["radius"] / scale[1]
    if "spread_deg" in changed:
        light.spread = math.radians(entry.get("spread_deg", 180.0))

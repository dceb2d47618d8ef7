"""Whether everything stands where Blender has it: bright markers in relume's picture against Blender's own projection."""

import bpy
import numpy
from bpy_extras.object_utils import world_to_camera_view
from mathutils import Vector

import pictures
import scene

SIZE = (1920, 1080)
TOLERANCE_PX = 0.5
# Side of the window around a projected marker in which it is looked for.
REACH_PX = 30

# What is shown only as instances stands far below.
UNSEEN = {"leaf", "particle"}

CAMERAS = {
    "wide": dict(lens=30),
    "vertical": dict(lens=20, sensor_fit="VERTICAL"),
    "horizontal": dict(lens=40, sensor_fit="HORIZONTAL", sensor_width=36),
    "ortho": dict(type="ORTHO", ortho_scale=6.0),
}


def add_camera(name, values):
    data = bpy.data.cameras.new(name)
    for key, value in values.items():
        setattr(data, key, value)
    camera = scene.link(name, data, (0.6, -6.0, 1.7))
    camera.rotation_euler = (Vector((0.1, 0, 1.0)) - camera.location).to_track_quat("-Z", "Y").to_euler()
    return camera


def markers():
    """Object name and centre of each octahedron, as Blender evaluates it, instances included."""
    found = []
    for instance in bpy.context.evaluated_depsgraph_get().object_instances:
        mesh = instance.object.data
        if instance.object.type != "MESH" or not instance.show_self:
            continue
        corners = [instance.matrix_world @ vertex.co for vertex in mesh.vertices]
        name = instance.parent.name if instance.is_instance else instance.object.name
        for first in range(0, len(corners) - 5, 6):
            found.append((name, sum(corners[first : first + 6], Vector()) / 6))
    return found


def in_pixels(camera, point, size):
    u, v, depth = world_to_camera_view(bpy.context.scene, camera, point)
    inside = depth > 0 and 0.02 < u < 0.98 and 0.02 < v < 0.98
    return numpy.array([u * size[0], (1 - v) * size[1]]) if inside else None


def centroid_near(picture, place):
    """The mean of the bright pixels around `place`, weighted; None in the dark."""
    x, y = (int(c) - REACH_PX // 2 for c in place)
    x, y = max(x, 0), max(y, 0)
    window = picture[y : y + REACH_PX, x : x + REACH_PX].mean(axis=2)
    if window.sum() == 0:
        return None
    rows, columns = numpy.indices(window.shape)
    return numpy.array([(columns * window).sum(), (rows * window).sum()]) / window.sum() + (x + 0.5, y + 0.5)


WAYS = {
    "as nodes": dict(),
    "as instances": dict(export_gpu_instances=True),
    "by Draco": dict(export_draco_mesh_compression_enable=True, export_draco_position_quantization=20),
}


def check(relume):
    return all([check_export(relume, way, **options) for way, options in WAYS.items()])


def check_export(relume, way, size=SIZE, cameras=CAMERAS, **options):
    """A table of how far markers are from where Blender has them; whether all are within the tolerance."""
    scene.posed_markers()
    bpy.context.scene.render.resolution_x, bpy.context.scene.render.resolution_y = size
    made = {name: add_camera(name, values) for name, values in cameras.items()}
    # By default armatures are written in their rest position.
    file = pictures.export(relume.folder / f"places {way}.glb", export_rest_position_armature=False, **options)
    print(f"\n| {way}: camera | object | markers | furthest, px |\n|---|---|---|---|")
    measured = set()
    right = True
    for name, camera in made.items():
        picture, _ = relume.picture(file, f"places-{name}", size, "--camera", name, "--gi", "off", "--no-cache")
        places = [(of, in_pixels(camera, point, size)) for of, point in markers()]
        places = [(of, place) for of, place in places if place is not None]
        for of in dict.fromkeys(of for of, _ in places):
            mine = [place for other, place in places if other == of]
            # Those that another stands close to cannot be told apart.
            alone = [p for p in mine if sum(max(abs(p - q)) < 0.9 * REACH_PX for _, q in places) == 1]
            found = [centroid_near(picture, place) for place in alone]
            if not alone:
                continue
            measured.add(of)
            apart = [numpy.hypot(*(f - p)) if f is not None else numpy.inf for f, p in zip(found, alone)]
            worst = max(apart)
            right &= worst <= TOLERANCE_PX
            print(f"| {name} | {of} | {len(alone)} of {len(mine)} | {worst:.3f} |")
    # Each object must be alone in the view of one camera at least.
    return right and measured == {of for of, _ in markers()} - UNSEEN

"""Blender scenes in code: objects that Blender poses in every way that a file can carry, and a room to light."""

import math

import bmesh
import bpy
import numpy
from mathutils import Euler, Vector

MARKER_RADIUS = 0.035


def empty_file():
    # The exporter says what goes wrong and no more.
    bpy.app.debug_value = 2
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.context.scene.world = bpy.data.worlds.new("black")
    bpy.context.scene.world.node_tree.nodes["Background"].inputs["Color"].default_value = (0, 0, 0, 1)


def link(name, data, location=(0, 0, 0), rotation=(0, 0, 0), scale=(1, 1, 1), parent=None):
    """An object in the scene; `rotation` in degrees."""
    thing = bpy.data.objects.new(name, data)
    thing.location, thing.scale = location, scale
    thing.rotation_euler = Euler(map(math.radians, rotation))
    thing.parent = parent
    bpy.context.scene.collection.objects.link(thing)
    return thing


def material(name, **inputs):
    """A Principled material; `Base_Color=...` sets the input "Base Color", a socket is linked to it."""
    made = bpy.data.materials.new(name)
    made.use_nodes = True
    shader = made.node_tree.nodes["Principled BSDF"]
    for key, value in inputs.items():
        socket = shader.inputs[key.replace("_", " ")]
        if isinstance(value, bpy.types.NodeSocket):
            made.node_tree.links.new(value, socket)
        elif isinstance(value, (tuple, list)):
            socket.default_value = (*value, 1.0)[: len(socket.default_value)]
        else:
            socket.default_value = value
    return made


def lambert(name, color):
    """Reflects diffusely and nothing else: the same in Blender and in glTF."""
    return material(name, Base_Color=color, Roughness=1.0, Specular_IOR_Level=0.0)


def emitter(name, color, strength):
    return material(name, Base_Color=(0, 0, 0), Specular_IOR_Level=0.0, Emission_Color=color, Emission_Strength=strength)


def image(name, pixels, is_color=True):
    """An image of RGBA `pixels`, rows from below, packed as PNG."""
    height, width, _ = pixels.shape
    made = bpy.data.images.new(name, width, height, alpha=True)
    made.colorspace_settings.name = "sRGB" if is_color else "Non-Color"
    made.pixels.foreach_set(numpy.ascontiguousarray(pixels, numpy.float32).ravel())
    made.pack()
    return made


def texture(of_material, picture):
    node = of_material.node_tree.nodes.new("ShaderNodeTexImage")
    node.image = picture
    return node


def into(of_material, name, socket):
    of_material.node_tree.links.new(socket, of_material.node_tree.nodes["Principled BSDF"].inputs[name])


def mesh(name, corners, faces, of_material=None, uvs=None):
    made = bpy.data.meshes.new(name)
    made.from_pydata(corners, [], faces)
    if uvs is not None:
        layer = made.uv_layers.new(name="UVMap")
        layer.uv.foreach_set("vector", [x for face in faces for corner in face for x in uvs[corner]])
    if of_material is not None:
        made.materials.append(of_material)
    made.update()
    return made


def box(name, size, of_material):
    """A box around the origin, faces outwards."""
    x, y, z = (s / 2 for s in size)
    corners = [(i * x, j * y, k * z) for k in (-1, 1) for j in (-1, 1) for i in (-1, 1)]
    faces = [(0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (2, 6, 7, 3), (0, 4, 6, 2), (1, 3, 7, 5)]
    return mesh(name, corners, faces, of_material)


def sheet(name, width, height, of_material):
    """Faces +Z, with texture coordinates."""
    x, y = width / 2, height / 2
    corners = [(-x, -y, 0), (x, -y, 0), (x, y, 0), (-x, y, 0)]
    return mesh(name, corners, [(0, 1, 2, 3)], of_material, [(0, 0), (1, 0), (1, 1), (0, 1)])


def sphere(name, radius, of_material, segments=48):
    made = bpy.data.meshes.new(name)
    ball = bmesh.new()
    bmesh.ops.create_uvsphere(ball, u_segments=segments, v_segments=segments // 2, radius=radius, calc_uvs=True)
    for face in ball.faces:
        face.smooth = True
    ball.to_mesh(made)
    made.materials.append(of_material)
    return made


def octahedra(name, centres, of_material):
    """One mesh with a small octahedron around each centre: what the eye finds again."""
    corners, faces = [], []
    for centre in centres:
        first = len(corners)
        r = MARKER_RADIUS
        for axis in ((r, 0, 0), (0, r, 0), (0, 0, r), (-r, 0, 0), (0, -r, 0), (0, 0, -r)):
            corners.append(tuple(Vector(centre) + Vector(axis)))
        around = [(0, 1, 2), (1, 3, 2), (3, 4, 2), (4, 0, 2), (1, 0, 5), (3, 1, 5), (4, 3, 5), (0, 4, 5)]
        faces += [tuple(first + i for i in face) for face in around]
    return mesh(name, corners, faces, of_material)


def skinned_arm(of_material, location):
    """Markers along two bones, the armature a hundred times too large and posed."""
    rig = bpy.data.armatures.new("rig")
    armature = link("armature", rig, location, (0, 0, 20), (0.01,) * 3)
    bpy.context.view_layer.objects.active = armature
    bpy.ops.object.mode_set(mode="EDIT")
    lower, upper = rig.edit_bones.new("lower"), rig.edit_bones.new("upper")
    lower.head, lower.tail = (0, 0, 0), (0, 0, 50)
    upper.head, upper.tail = (0, 0, 50), (0, 0, 100)
    upper.parent = lower
    bpy.ops.object.mode_set(mode="OBJECT")

    heights = (10, 40, 60, 90)
    made = octahedra("arm", [(0, 0, 0)] * len(heights), of_material)
    for i, vertex in enumerate(made.vertices):
        vertex.co = vertex.co * 100 + Vector((0, 0, heights[i // 6]))
    arm = link("arm", made, parent=armature)
    arm.modifiers.new("armature", "ARMATURE").object = armature
    for bone, marker_range in (("lower", range(0, 12)), ("upper", range(12, 24))):
        arm.vertex_groups.new(name=bone).add(list(marker_range), 1.0, "REPLACE")
    for bone, degrees in (("lower", 25), ("upper", -70)):
        armature.pose.bones[bone].rotation_mode = "XYZ"
        armature.pose.bones[bone].rotation_euler = (math.radians(degrees), 0, math.radians(15))
    return arm


def scattered(of_material, location):
    """Instances on the points of a grid by geometry nodes, turned and of several sizes."""
    leaf = link("leaf", octahedra("leaf", [(0, 0, 0)], of_material), (0, 0, -50))
    tree = bpy.data.node_groups.new("scatter", "GeometryNodeTree")
    tree.interface.new_socket("Geometry", in_out="OUTPUT", socket_type="NodeSocketGeometry")
    new = tree.nodes.new
    grid, place, source = new("GeometryNodeMeshGrid"), new("GeometryNodeInstanceOnPoints"), new("GeometryNodeObjectInfo")
    out = new("NodeGroupOutput")
    for name, value in (("Size X", 1.2), ("Size Y", 0.8), ("Vertices X", 4), ("Vertices Y", 3)):
        grid.inputs[name].default_value = value
    source.inputs["Object"].default_value = leaf
    place.inputs["Rotation"].default_value = (0.3, 0.5, 0.7)
    place.inputs["Scale"].default_value = (1.3, 0.8, 1.0)
    tree.links.new(grid.outputs["Mesh"], place.inputs["Points"])
    tree.links.new(source.outputs["Geometry"], place.inputs["Instance"])
    tree.links.new(place.outputs["Instances"], out.inputs["Geometry"])
    scatter = link("scatter", bpy.data.meshes.new("points"), location, (70, 0, 30))
    scatter.modifiers.new("scatter", "NODES").node_group = tree
    return scatter


def particles(of_material, location):
    """A hair system that shows an object at each hair."""
    leaf = link("particle", octahedra("particle", [(0, 0, 0)], of_material), (0, 0, -60))
    ground = link("hairy", sheet("hairy", 1.0, 0.8, lambert("hairy", (0, 0, 0))), location, (80, 10, -20))
    settings = ground.modifiers.new("hair", "PARTICLE_SYSTEM").particle_system.settings
    settings.type, settings.count, settings.hair_length = "HAIR", 12, 1.0
    settings.use_advanced_hair = True
    settings.render_type, settings.instance_object = "OBJECT", leaf
    settings.particle_size, settings.size_random, settings.use_rotations = 1.0, 0.0, True
    ground.show_instancer_for_render = False
    return ground


def shaped(of_material, location):
    """A shape key at 0.6, which moves one of two markers."""
    thing = link("shaped", octahedra("shaped", [(0, 0, 0), (0.3, 0, 0)], of_material), location)
    thing.shape_key_add(name="Basis")
    key = thing.shape_key_add(name="raised")
    for point in key.data[6:]:
        point.co.z += 0.5
    key.value = 0.6
    return thing


def posed_markers():
    """All the ways to stand somewhere, as bright octahedra before a camera 6 m away."""
    empty_file()
    glow = emitter("glow", (1, 1, 1), 5.0)
    frame = [(x, 0, z) for x in (-2.0, 0, 2.0) for z in (-1.0, 1.0)]
    link("frame", octahedra("frame", frame, glow), (0, 0, 1.0))
    link("turned", octahedra("turned", [(0, 0, 0), (0.5, 0.2, 0.1)], glow), (-1.7, 0.3, 1.4), (20, 40, 60), (0.8, 1.4, 1))
    mirrored = octahedra("mirrored", [(0, 0, 0), (0.35, 0, 0.2)], glow)
    original = link("original", mirrored, (-1.5, -0.2, 0.6), (0, 30, 10))
    link("mirrored", mirrored, (-0.6, -0.2, 0.6), (0, 30, 10), (-1, 1, 1))
    link("child", octahedra("child", [(0.4, 0, 0.1)], glow), (0.1, 0.1, -0.3), (0, 15, 0), (1.2, 1.2, 1.2), parent=original)
    skinned_arm(glow, (0.2, 0, 0.6))
    scattered(glow, (1.2, 0, 1.35))
    particles(glow, (-0.6, 0.4, 1.5))
    shaped(glow, (1.0, -0.3, 0.25))
    array = link("array", octahedra("array", [(0, 0, 0)], glow), (-1.8, 0, 1.8))
    modifier = array.modifiers.new("array", "ARRAY")
    modifier.count, modifier.use_relative_offset, modifier.use_constant_offset = 4, False, True
    modifier.constant_offset_displace = (0.25, 0, -0.03)
    # A second scene, as files have that were once copied from another.
    bpy.data.scenes.new("empty")


def pattern(name, size, of, is_color=True):
    """A square image whose RGBA at (u, v) is `of(u, v)`, v upwards."""
    v, u = (numpy.indices((size, size)) + 0.5) / size
    channels = [numpy.broadcast_to(channel, u.shape) for channel in of(u, v)]
    return image(name, numpy.stack(channels, axis=2), is_color)


def checks(u, v, count=8):
    return ((numpy.floor(u * count) + numpy.floor(v * count)) % 2)


def textured_floor():
    """Colour, roughness and metal from images, and a normal map of waves."""
    made = material("floor")
    color = texture(made, pattern("tiles", 256, lambda u, v: (0.2 + 0.5 * checks(u, v), 0.35 + 0 * u, 0.3 * u, 1)))
    into(made, "Base Color", color.outputs["Color"])
    rough = texture(made, pattern("rough", 128, lambda u, v: (0 * u, 0.3 + 0.5 * u, 0.8 * checks(u, v), 1), False))
    split = made.node_tree.nodes.new("ShaderNodeSeparateColor")
    made.node_tree.links.new(rough.outputs["Color"], split.inputs[0])
    into(made, "Roughness", split.outputs["Green"])
    into(made, "Metallic", split.outputs["Blue"])

    def waves(u, v):
        slope_x, slope_y = 0.3 * numpy.cos(40 * u), 0.2 * numpy.cos(30 * v)
        length = numpy.sqrt(1 + slope_x**2 + slope_y**2)
        return 0.5 - 0.5 * slope_x / length, 0.5 - 0.5 * slope_y / length, 0.5 + 0.5 / length, 1

    bumps = made.node_tree.nodes.new("ShaderNodeNormalMap")
    made.node_tree.links.new(texture(made, pattern("waves", 256, waves, False)).outputs["Color"], bumps.inputs["Color"])
    into(made, "Normal", bumps.outputs["Normal"])
    return made


def leaf_material(name, way):
    """Alpha of an image: holes by a "mask" of either node that the exporter knows, or a "blend"."""
    made = lambert(name, (0.1, 0.5, 0.1))
    disc = lambda u, v: (0.1, 0.5, 0.1, numpy.clip(1.5 - 3 * numpy.hypot(u - 0.5, v - 0.5), 0, 1))
    picture = texture(made, pattern(name, 64, disc))
    into(made, "Base Color", picture.outputs["Color"])
    alpha = picture.outputs["Alpha"]
    if way != "blend":
        cut = made.node_tree.nodes.new("ShaderNodeMath")
        cut.operation = {"greater": "GREATER_THAN", "round": "ROUND"}[way]
        made.node_tree.links.new(alpha, cut.inputs[0])
        cut.inputs[1].default_value = 0.4
        alpha = cut.outputs[0]
    into(made, "Alpha", alpha)
    return made


def painted(name):
    """A box whose corners have colours."""
    made = lambert(name, (1, 1, 1))
    node = made.node_tree.nodes.new("ShaderNodeVertexColor")
    node.layer_name = "Color"
    into(made, "Base Color", node.outputs["Color"])
    data = box(name, (0.5, 0.5, 0.5), made)
    layer = data.color_attributes.new("Color", "FLOAT_COLOR", "POINT")
    for i, vertex in enumerate(data.vertices):
        layer.data[i].color = (*(0.2 + 0.6 * (c > 0) for c in vertex.co), 1)
    return data


def walls():
    """A room of 4 m by 4 m by 2.8 m without its front and without half its ceiling."""
    sides = {
        "left": ((-2, 0, 1.4), (90, 0, 90), 4, 2.8, (0.65, 0.1, 0.08)),
        "right": ((2, 0, 1.4), (90, 0, -90), 4, 2.8, (0.1, 0.5, 0.12)),
        "back": ((0, 2, 1.4), (90, 0, 0), 4, 2.8, (0.7, 0.7, 0.7)),
        "ceiling": ((0, 1, 2.8), (180, 0, 0), 4, 2, (0.7, 0.7, 0.7)),
    }
    for name, (location, rotation, width, height, color) in sides.items():
        link(name, sheet(name, width, height, lambert(name, color)), location, rotation)


def lamp(name, kind, energy, location, rotation=(0, 0, 0), color=(1, 1, 1), **values):
    """A punctual light, as files have them."""
    data = bpy.data.lights.new(name, kind)
    data.energy, data.color = energy, color
    if kind == "SUN":
        data.angle = 0.0
    elif kind != "AREA":
        data.shadow_soft_size = 0.0
    for key, value in values.items():
        setattr(data, key, value)
    return link(name, data, location, rotation)


def room(is_plain):
    """A room, all Lambert or of everything that materials can be, and a camera before it."""
    empty_file()
    walls()
    floor = lambert("floor", (0.6, 0.6, 0.6)) if is_plain else textured_floor()
    link("floor", sheet("floor", 4, 4, floor))
    link("block", box("block", (0.8, 0.8, 1.2), lambert("block", (0.7, 0.6, 0.3))), (-0.9, 0.7, 0.6), (0, 0, 25))
    link("painted", painted("painted"), (0.9, -0.7, 0.25), (0, 0, 30))
    link("panel", sheet("panel", 0.8, 0.5, emitter("panel", (1, 0.7, 0.4), 4.0)), (0.9, 1.97, 1.7), (90, 0, 0))
    if is_plain:
        link("ball", sphere("ball", 0.4, lambert("ball", (0.2, 0.3, 0.8))), (0.8, 0.6, 0.4))
    else:
        kinds = {
            "dielectric": dict(Base_Color=(0.2, 0.3, 0.8), Roughness=0.4),
            "metal": dict(Base_Color=(0.9, 0.6, 0.3), Roughness=0.3, Metallic=1.0),
            "dense": dict(Base_Color=(0.5, 0.1, 0.1), Roughness=0.5, IOR=2.0),
            "tinted": dict(Base_Color=(0.1, 0.1, 0.1), Roughness=0.4, Specular_IOR_Level=1.0, Specular_Tint=(0.3, 1, 0.3)),
            "coated": dict(Base_Color=(0.6, 0.1, 0.1), Roughness=0.6, Coat_Weight=1.0, Coat_Roughness=0.1),
            "sheen": dict(Base_Color=(0.1, 0.1, 0.3), Roughness=0.8, Sheen_Weight=1.0, Sheen_Tint=(1, 1, 1)),
            "glass": dict(Base_Color=(1, 1, 1), Roughness=0.1, Transmission_Weight=1.0),
        }
        for i, (name, inputs) in enumerate(kinds.items()):
            place = (-1.5 + 0.5 * i, 0.1 - 0.9 * (i % 2), 0.22)
            link(name, sphere(name, 0.22, material(name, **inputs)), place)
        for i, way in enumerate(("greater", "round")):
            leaf = sheet(way, 0.5, 0.5, leaf_material(way, way))
            link(way, leaf, (0.1 + 0.5 * i, 1.2, 1.1), (80, 0, 10 - 20 * i))
    lamp("point", "POINT", 60, (0.5, -0.4, 2.2), color=(1, 0.95, 0.9))
    lamp("spot", "SPOT", 150, (-1.2, -1.5, 2.4), (50, 0, -25), spot_size=math.radians(50), spot_blend=0.0)
    lamp("sun", "SUN", 2.0, (0, 0, 5), (50, 10, 0), (0.8, 0.9, 1))
    camera = link("camera", bpy.data.cameras.new("camera"), (0, -5.6, 1.4), (90, 0, 0))
    camera.data.lens = 36
    bpy.context.scene.camera = camera

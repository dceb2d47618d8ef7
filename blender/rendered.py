"""What Blender would render of a scene."""

import bpy


def view_layer(scene):
    """The view layer that is looked at, or the first one of a scene that is not."""
    context = bpy.context
    return context.view_layer if context.scene == scene and context.view_layer else scene.view_layers[0]


def objects(scene):
    """The objects in collections that are rendered, each once; they themselves may be off."""
    found = {}

    def visit(layer):
        if layer.exclude or layer.collection.hide_render:
            return
        found.update((thing.session_uid, thing) for thing in layer.collection.objects)
        for child in layer.children:
            visit(child)

    visit(view_layer(scene).layer_collection)
    return found.values()

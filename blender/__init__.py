"""relume in Blender: opens the scene in a relume window, and keeps the lights of both equal."""

import shutil

import bpy
from bpy.app.handlers import persistent

from .live import Live

# Interval at which messages are exchanged, seconds.
INTERVAL = 1 / 60
# The scene that is open in relume.
running = None


class Preferences(bpy.types.AddonPreferences):
    bl_idname = __package__

    program: bpy.props.StringProperty(
        name="relume", description="The relume program", subtype="FILE_PATH", default=shutil.which("relume") or "relume"
    )

    def draw(self, _context):
        self.layout.prop(self, "program")


class Open(bpy.types.Operator):
    bl_idname = "relume.open"
    bl_label = "Open in relume"
    bl_description = "Exports the scene and opens it in relume, which stays connected"

    def execute(self, context):
        program = bpy.path.abspath(context.preferences.addons[__package__].preferences.program)
        if shutil.which(program) is None:
            self.report({"ERROR"}, f"{program} is not there: set the path of relume in the add-on's preferences")
            return {"CANCELLED"}
        begin(Live(context.scene)).start(program)
        return {"FINISHED"}


class Connect(bpy.types.Operator):
    bl_idname = "relume.connect"
    bl_label = "Connect"
    bl_description = "Connects with the relume window of this file that is open already; its lights come here"

    def execute(self, context):
        begin(Live(context.scene, takes_theirs=True))
        return {"FINISHED"}


class Reload(bpy.types.Operator):
    bl_idname = "relume.reload"
    bl_label = "Export again"
    bl_description = "Exports camera, objects and materials again; relume bakes them while its old picture stays"

    @classmethod
    def poll(cls, _context):
        return running is not None and running.scene is not None

    def execute(self, _context):
        running.reload()
        return {"FINISHED"}


class BringBack(bpy.types.Operator):
    bl_idname = "relume.bring_back"
    bl_label = "Bring lights back"
    bl_description = "Gives Blender's lights all values of relume's"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, _context):
        return running is not None and running.scene is not None and running.is_open

    def execute(self, _context):
        running.bring_back()
        return {"FINISHED"}


class Disconnect(bpy.types.Operator):
    bl_idname = "relume.disconnect"
    bl_label = "Disconnect"
    bl_description = "Leaves relume open, and keeps the lights equal no longer"

    def execute(self, _context):
        end()
        return {"FINISHED"}


class Panel(bpy.types.Panel):
    bl_idname = "VIEW3D_PT_relume"
    bl_label = "relume"
    bl_space_type, bl_region_type, bl_category = "VIEW_3D", "UI", "relume"

    def draw(self, _context):
        column = self.layout.column()
        column.operator(Open.bl_idname, icon="LIGHT")
        if running is None:
            column.operator(Connect.bl_idname)
            return
        column.label(text=running.message)
        if running.progress:
            what, share = running.progress
            column.progress(text=what, factor=share)
        if running.outdated:
            names = sorted(running.outdated)
            more = f" and {len(names) - 3} more" if len(names) > 3 else ""
            column.label(text=f"changed: {', '.join(names[:3])}{more}", icon="ERROR")
            column.operator(Reload.bl_idname)
        for problem in running.problems():
            column.label(text=problem, icon="ERROR")
        if running.is_open:
            column.operator(BringBack.bl_idname)
        column.operator(Disconnect.bl_idname)


def begin(new):
    global running
    end()
    running = new
    if not bpy.app.timers.is_registered(pump):
        bpy.app.timers.register(pump, persistent=True)
    return running


def end():
    global running
    if running is not None:
        running.stop()
    running = None


def pump():
    """Called by Blender's timer; returns when it is due again."""
    if running is None:
        return None
    before = (running.message, running.progress)
    running.pump()
    if before != (running.message, running.progress):
        redraw()
    return INTERVAL


def redraw():
    for window in bpy.context.window_manager.windows:
        for area in window.screen.areas:
            if area.type == "VIEW_3D":
                area.tag_redraw()


@persistent
def on_change(scene, depsgraph):
    if running is not None and scene.session_uid == running.scene_uid:
        running.note(depsgraph.updates)


@persistent
def on_undo(_scene, *_):
    if running is not None:
        running.is_dirty = True


@persistent
def on_load(*_):
    end()


CLASSES = (Preferences, Open, Connect, Reload, BringBack, Disconnect, Panel)
HANDLERS = (
    (bpy.app.handlers.depsgraph_update_post, on_change),
    (bpy.app.handlers.undo_post, on_undo),
    (bpy.app.handlers.redo_post, on_undo),
    (bpy.app.handlers.load_pre, on_load),
)


def register():
    for kind in CLASSES:
        bpy.utils.register_class(kind)
    for handlers, handler in HANDLERS:
        handlers.append(handler)


def unregister():
    end()
    for handlers, handler in HANDLERS:
        handlers.remove(handler)
    for kind in reversed(CLASSES):
        bpy.utils.unregister_class(kind)

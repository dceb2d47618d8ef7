"""Keeps Blender's lights and relume's equal: what changes on one side is sent to the other at once.

Each side has its own idea of every light. `ours` is what Blender had when both agreed last, `theirs` what relume has
said. What differs from `ours` was edited in Blender; what relume sends was edited there.
"""

import math
import subprocess
import time
import traceback
import uuid

import bpy

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None

from . import export, lights, world
from .connection import Connection, Lost

# Blender's numbers have single precision.
PRECISION = 2e-6
# Time in which edits that follow each other are one step of undo, seconds.
GESTURE = 0.4
RETRY = 1.0
# The same after relume refused to speak with this add-on.
PATIENCE = 10.0
POLL = 1.0


def same(a, b):
    if isinstance(a, (list, tuple)) and isinstance(b, (list, tuple)):
        scale = max((abs(x) for x in (*a, *b) if isinstance(x, float)), default=1.0)
        return len(a) == len(b) and all(
            abs(x - y) <= PRECISION * max(scale, 1e-3) if isinstance(x, float) and isinstance(y, float) else x == y
            for x, y in zip(a, b)
        )
    if isinstance(a, float) and isinstance(b, (int, float)):
        return math.isclose(a, b, rel_tol=PRECISION, abs_tol=1e-9)
    return a == b


def difference(before, after):
    """The merge patch between two entries."""
    changed = {key: value for key, value in after.items() if key not in before or not same(before[key], value)}
    return changed | {key: None for key in before if key not in after}


def merge(value, patch):
    """Applies a merge patch (RFC 7396)."""
    for key, change in patch.items():
        if change is None:
            value.pop(key, None)
        elif isinstance(change, dict):
            value[key] = merge(value[key] if isinstance(value.get(key), dict) else {}, change)
        else:
            value[key] = change
    return value


def is_locked(path):
    """Whether a window of relume has this lock file; where Python cannot tell, whether it is there."""
    if fcntl is None or not path.exists():
        return path.exists()
    with path.open("rb") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            return False
        except OSError:
            return True


class Live:
    """One scene of Blender in one relume."""

    def __init__(self, scene, takes_theirs=False):
        """`takes_theirs`: relume's lights come here at first."""
        # The same after the scene was renamed.
        self.scene_uid, self.takes_theirs = scene.session_uid, takes_theirs
        self.folder = export.folder_of(scene)
        self.glb, self.rig = self.folder / "scene.glb", self.folder / "scene.rig.toml"
        self.file, self.log = self.folder / "connection.json", self.folder / "relume.log"
        self.connection = self.process = self.peer = None
        self.ours, self.theirs, self.uids = {}, {}, {}
        # Lights that relume refused, as they were.
        self.rejected = {}
        # Edits that relume has not answered yet, by id.
        self.pending = {}
        self.retry_at, self.poll_at, self.edited_at, self.gesture = 0.0, 0.0, 0.0, ""
        self.undo_at = None
        self.is_dirty, self.is_open = False, False
        # Objects in the file, and names of what relume does not show as it is now.
        self.exported, self.outdated = export.shown(scene), set()
        # Options that relume was started with, and whether it has yet to load what was exported.
        self.arguments, self.needs_reload = None, False
        self.message, self.progress = "" if self.file.exists() else "relume has no window of this scene", None

    @property
    def scene(self):
        return next((scene for scene in bpy.data.scenes if scene.session_uid == self.scene_uid), None)

    def problems(self):
        """What relume has not as Blender has it, and why."""
        scene = self.scene
        if scene is None:
            return ["the scene is gone"]
        found = [world.problem_of(scene.world)]
        if self.arguments not in {None, export.picture(scene)}:
            found.append("another camera or size: open it again")
        if export.working_space() != "Linear Rec.709":
            found.append("colours are taken for Rec. 709")
        return [problem for problem in found if problem]

    # Starting

    def start(self, program, options=()):
        """Exports the scene and opens it in a relume window."""
        self.export()
        found = export.entries(self.scene, self.folder)
        export.write_rig(found, self.rig)
        self.file.unlink(missing_ok=True)
        self.forget_autosaves()
        command = [program, "view", self.glb, "--rig", self.rig, "--listen", self.file]
        self.arguments = export.picture(self.scene)
        command += [*self.arguments, "--exposure", export.exposure(self.scene), *options]
        with self.log.open("wb") as log:
            self.process = subprocess.Popen(list(map(str, command)), stderr=log)
        self.ours, self.uids = found, self.current_uids()
        self.message = "relume starts"

    def forget_autosaves(self):
        """What a window left that crashed: Blender has its edits. Windows that are open have a lock."""
        for path in self.folder.glob("scene.rig.autosave*.toml"):
            if not is_locked(path.with_suffix(".lock")):
                path.unlink(missing_ok=True)

    def export(self):
        export.write_scene(self.scene, self.glb)
        self.exported = export.shown(self.scene)
        bpy.context.view_layer.update()  # tells of all that the exporter touched
        self.outdated.clear()

    def reload(self):
        """Exports again; relume bakes it while the old picture stays, once it is connected."""
        before = self.exported
        self.export()
        if self.is_open:
            self.unlink(before - self.exported)
            self.connection.request("reload")
        else:
            self.needs_reload = True

    def unlink(self, gone):
        """Takes objects that are gone out of relume's links, as it refuses a scene that lacks them."""
        unsure = {*self.rejected, *(key for patch in self.pending.values() for key in patch)}
        for key, entry in self.theirs.items():
            linked = gone.union(*(entry.get(name, ()) for name in lights.LINKS)) if key in unsure else gone
            links = {name: entry.get(name, []) for name in lights.LINKS}
            left = {name: [thing for thing in things if thing not in linked] or None for name, things in links.items()}
            if key in unsure or left != {name: things or None for name, things in links.items()}:
                self.send({key: left})
                merge(entry, left)

    def bring_back(self):
        """Gives Blender's lights all values of relume's."""
        found = export.entries(self.scene, self.folder)
        for key in found.keys() - self.theirs.keys():
            self.remove(key)
        for key, entry in list(self.theirs.items()):
            # A key that one of them lacks has relume's default there.
            self.apply(key, entry, set(difference(found.get(key, {}), entry)))
        self.agree()

    def stop(self):
        if self.connection:
            self.connection.close()
        self.connection = None

    # Every few milliseconds

    def pump(self):
        """Sends what was edited here, takes what was edited there. Never waits."""
        if self.scene is None or bpy.app.is_job_running("RENDER"):  # which reads what would change
            return
        self.watch()
        try:
            if self.connection is None:
                self.connect()
            if self.connection is None:
                return
            self.connection.flush()
            for message in self.connection.receive():
                self.take(message)
            if time.monotonic() > self.poll_at:  # of light groups and new names Blender tells nothing
                self.poll_at, self.is_dirty = time.monotonic() + POLL, True
                self.outdated |= self.exported ^ export.shown(self.scene)
            if self.is_open and self.is_dirty:
                self.send_edits()
            self.connection.flush()
        except Lost as lost:
            self.lose(str(lost))
        except Exception as error:  # a timer that raises is never called again
            traceback.print_exc()
            self.lose(f"{type(error).__name__}: {error}")
        self.push_undo()

    def watch(self):
        """Tells why a relume that was started here has ended."""
        if self.process is None or self.process.poll() is None:
            return
        code, self.process = self.process.returncode, None
        lines = self.log.read_text(encoding="utf-8", errors="replace").strip().splitlines()
        if code != 0:
            self.message = lines[-1] if lines else f"relume ended with status {code}"

    def connect(self):
        if time.monotonic() < self.retry_at or not self.file.exists():
            return
        self.retry_at = time.monotonic() + RETRY
        try:
            self.connection = Connection(self.file)
            self.message = "connected"
        except Lost:
            if self.process:
                self.message = "waiting for relume"

    def lose(self, why):
        if self.connection:
            self.connection.close()
        self.connection, self.is_open = None, False
        for patch in self.pending.values():  # nobody knows whether relume has these edits
            for key, change in patch.items():
                for name in change or ():
                    self.ours.get(key, {}).pop(name, None)
        self.pending.clear()
        self.message = f"not connected: {why}"

    def take(self, message):
        event = message.get("event")
        if event == "opened":
            self.opened(message)
        elif event == "edited":
            self.message = message["message"]
            self.edited(message["rig"])
        elif event == "progress":
            self.progress = (message["what"], message["share"])
        elif event == "indirect" and message["complete"]:
            self.progress = None
        elif event == "failed":
            self.message, self.progress = message["message"], None
        elif "error" in message:
            if message.get("id") == Connection.HELLO:
                self.retry_at = time.monotonic() + PATIENCE
                raise Lost(message["error"])
            self.message = message["error"]
            if "id" in message:
                self.refused(message["id"])
        elif "id" in message:
            self.pending.pop(message["id"], None)
            if "rig" in message:
                self.theirs = self.soon(message["rig"]["lights"])

    def note(self, updates):
        """Marks lights as edited, or objects as not up to date in relume, by updates of the dependency graph."""
        for update in updates:
            changed = update.id.original
            # New relations tag everything else as shaded anew.
            is_other = update.is_updated_transform or update.is_updated_geometry
            if isinstance(changed, bpy.types.Object) and changed.type not in {"LIGHT", "EMPTY"}:
                if is_other and (changed.name in self.exported or changed == self.scene.camera):
                    self.outdated.add(changed.name)
            elif isinstance(changed, (bpy.types.Material, bpy.types.Mesh, bpy.types.Camera)):
                self.outdated.add(changed.name)
            else:  # lights, worlds, their nodes, collections
                self.is_dirty = True
            if isinstance(changed, (bpy.types.Scene, bpy.types.Collection)):
                self.outdated |= self.exported ^ export.shown(self.scene)

    # From relume

    def soon(self, theirs):
        """relume's lights with the edits that it has not answered yet."""
        for patch in self.pending.values():
            merge(theirs, patch)
        return theirs

    def opened(self, message):
        """relume has told all of its lights: agrees with it anew."""
        self.message = "the scene is open in relume"
        # New objects can be linked now.
        self.rejected.clear()
        for entry in self.ours.values():
            for name in lights.LINKS:
                entry.pop(name, None)
        theirs = self.soon(message["rig"]["lights"])
        is_same = self.connection.process == self.peer
        known, self.theirs, self.is_open = self.theirs, theirs, True
        self.peer = self.connection.process
        if self.takes_theirs:
            self.takes_theirs = False
            self.bring_back()
        elif is_same and known:
            # What was edited there while nobody listened; then what was edited here.
            patch = {key: difference(known.get(key, {}), entry) for key, entry in theirs.items()}
            patch |= {key: None for key in known if key not in theirs}
            edits = self.edits()
            for key, change in patch.items():
                change = self.left(key, change, [edits, *self.pending.values()])
                if change != {}:
                    self.change(key, change)
        else:  # a new relume
            self.send_all()
        self.send_edits()
        self.send_emitters()
        if self.needs_reload:
            self.needs_reload = False
            self.connection.request("reload")
        self.edited_at = 0.0  # the next edit is undone without these

    def send_all(self):
        """Blender's lights are the ones: the next edit is whatever differs from relume's."""
        found, theirs = export.entries(self.scene, self.folder), self.theirs
        of_both = {key: theirs[key].keys() & {*found[key], *lights.OPTIONAL} for key in found.keys() & theirs.keys()}
        self.ours = {key: {name: theirs[key][name] for name in names} for key, names in of_both.items()}
        self.ours |= {key: {} for key, entry in theirs.items() if key not in found and entry["kind"] != "emitter"}
        self.uids = self.current_uids()

    def send_emitters(self):
        """Emissive materials are exported in Blender's units: converts them to relume's."""
        of_file = [key for key, entry in self.theirs.items() if entry["kind"] == "emitter" and entry["intensity"] == 1.0]
        if of_file:
            self.send({key: {"intensity": lights.LUMENS_PER_WATT} for key in of_file})
            for key in of_file:
                self.theirs[key]["intensity"] = lights.LUMENS_PER_WATT

    def edited(self, rig):
        self.send_edits()  # what was edited here before, so that it is not taken for what comes now
        for key, change in rig.get("lights", {}).items():
            change = self.left(key, change, self.pending.values())
            if change != {}:
                merge(self.theirs, {key: change})
                self.change(key, change)

    @staticmethod
    def left(key, change, own):
        """What is left of a change of relume's where our `own` edits win, as relume has not seen them yet."""
        for patch in own:
            if key in patch and (change is None or patch[key] is None):
                return {}
            if key in patch:
                change = {name: value for name, value in change.items() if name not in patch[key]}
        return change

    def change(self, key, change):
        """Gives a light here what changed there."""
        if change is not None and "name" in change and change["name"] != key:
            key = self.rename(key, change["name"])
        if change is None:
            self.ours.pop(key, None)
            self.remove(key)
        else:
            key = self.apply(key, self.theirs[key], set(change))
        self.agree(key)
        self.undo_at = time.monotonic() + GESTURE

    def remove(self, key):
        thing = self.things().get(key)
        if thing is not None:
            bpy.data.objects.remove(thing)
        elif key == export.world_key(self.scene) and not world.problem_of(self.scene.world):
            world.apply(self.scene.world, None, set())

    def apply(self, key, entry, changed):
        """Gives a light here values of relume's, and returns its name in both afterwards."""
        things = self.things()
        thing = things.get(key)
        if entry["kind"] == "emitter":
            return key
        if entry["kind"] == "dome":
            self.apply_dome(key, entry, changed)
        elif thing is None:
            lights.new(self.scene, key, entry)
            key = self.renamed(key, self.things().keys() - things.keys())
        elif thing.library:
            self.message = f"{key} is linked from another file, and stays as it is there"
        else:
            lights.apply(thing, self.scene, entry, changed, self.folder)
        return key

    def renamed(self, key, names):
        """Tells relume the name that Blender gave a light, the only one of `names`, if another object has `key`."""
        name = next(iter(names), key)
        if name != key:
            self.send({key: {"name": name}})
            for known in (self.theirs, self.ours):
                if key in known:
                    known[name] = known.pop(key)
        return name

    def apply_dome(self, key, entry, changed):
        here = self.scene.world
        if here is None:
            self.scene.world = here = world.new(key)
        if world.problem_of(here):
            self.message = f"{key} stays in relume: {world.problem_of(here)}"
            return
        if lights.key_of(here.name) != key and world.entry_of(here, self.folder) is None:
            here.name = key
        if lights.key_of(here.name) == key:
            world.apply(here, entry, changed)
        else:
            self.message = f"{key} stays in relume: Blender has one world"

    def rename(self, key, name):
        """Renames a light here as it was there, and returns its name in both afterwards."""
        is_world = key == export.world_key(self.scene)
        thing = self.scene.world if is_world else self.things().get(key)
        for known in (self.theirs, self.ours):
            if key in known:
                known[name] = known.pop(key)
        if thing is None or thing.library:
            return name
        thing.name = name
        given = {export.world_key(self.scene)} if is_world else {k for k, v in self.things().items() if v == thing}
        return self.renamed(name, given)

    def agree(self, key=None):
        """Both sides have the same now, of one light or of all."""
        found = export.entries(self.scene, self.folder)
        self.uids = self.current_uids()
        if key is None:
            self.ours = found
        elif key in found:
            self.ours[key] = found[key]
        else:
            self.ours.pop(key, None)

    def push_undo(self):
        """One step of undo for edits of relume that followed each other."""
        if self.undo_at is not None and time.monotonic() > self.undo_at:
            self.undo_at = None
            if not bpy.app.background:
                bpy.ops.ed.undo_push(message=f"relume: {self.message}")

    # To relume

    def things(self):
        return export.keys(self.scene)

    def current_uids(self):
        return {thing.session_uid: key for key, thing in self.things().items()}

    def edits(self):
        """What was edited here since both agreed: a patch of relume's lights."""
        found = export.entries(self.scene, self.folder)
        if any(found.get(key) != entry for key, entry in self.rejected.items()):
            self.rejected.clear()
            self.send_all()
        uids = self.current_uids()
        patch = {}
        for uid, key in uids.items():
            old = self.uids.get(uid)
            if old is not None and old != key and old in self.ours and old not in found:
                patch[old] = {"name": key, **difference(self.ours[old], found[key])}
        renamed = {change["name"] for change in patch.values()}
        for key, entry in found.items():
            if key not in renamed:
                change = difference(self.ours.get(key, {}), entry)
                if "intensity" in change:  # Blender may have no stops: relume's are part of its watts then
                    change["stops"] = entry.get("stops", 0.0)
                if change:
                    patch[key] = change
        patch |= {key: None for key in self.ours if key not in found and key not in patch}
        return patch

    def send_edits(self):
        self.is_dirty = False
        patch = self.edits()
        if not patch:
            return
        for key in [key for key, change in patch.items() if change is None and key not in self.theirs]:
            del patch[key]
        self.send(patch)
        for key, change in patch.items():
            if change is not None and "name" in change and key in self.theirs:
                self.theirs[change["name"]] = self.theirs.pop(key)
                key = change["name"]
            merge(self.theirs, {key: change})
        self.agree()

    def send(self, patch):
        if not patch:
            return
        now = time.monotonic()
        if now - self.edited_at > GESTURE:
            self.gesture = uuid.uuid4().hex
        self.edited_at = now
        rig = {"lights": patch}
        groups = {change["group"] for change in patch.values() if change and change.get("group")}
        if groups:
            rig["groups"] = {group: {} for group in sorted(groups)}
        number = self.connection.request("edit", rig=rig, gesture=self.gesture)
        self.pending[number] = patch

    def refused(self, number):
        """relume has not taken an edit, as it may name an object that is new: tries each light of it by itself, and one that
        is refused alone again once it has changed."""
        patch = self.pending.pop(number, {})
        self.connection.request("rig")  # the lights as they are there
        if len(patch) > 1:
            for key, change in patch.items():
                self.send({key: change})
            return
        found = export.entries(self.scene, self.folder)
        for key, change in patch.items():
            key = (change or {}).get("name", key)
            self.rejected[key] = found.get(key)

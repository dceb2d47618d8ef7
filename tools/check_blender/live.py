"""Whether Blender and a relume window agree while both are edited in turn, and whichever is killed."""

import os
import random
import subprocess
import sys
import time
from pathlib import Path

import bpy
from mathutils import Euler, Vector

import addon

sys.path.append(str(Path(__file__).resolve().parents[1]))
import relume_client  # noqa: E402

PATIENCE = 120.0
EDITS = 200
# By key of an entry: default, and by how much both sides may differ (metres, degrees).
NUMBERS = {
    **{"position": (None, 1e-5), "direction": (None, 1e-5), "color": (None, 1e-4)},
    **{"radius": (0, 1e-5), "width": (None, 1e-5), "height": (None, 1e-5)},
    **{"outer_deg": (None, 1e-3), "inner_deg": (None, 1e-3), "angle_deg": (0, 1e-3)},
    **{"spread_deg": (180, 1e-3), "rotate_deg": (0, 1e-3)},
}
OTHERS = {
    **{"kind": None, "enabled": True, "shadows": True, "visible": False},
    **{"group": None, "only": None, "except": None, "map": None, "ies": None},
}
# Lights that are new in relume.
SHAPES = (
    {"kind": "spot", "direction": [0, -1, 0.2], "outer_deg": 30, "inner_deg": 20},
    {"kind": "rect", "direction": [0, -1, 0], "width": 1, "height": 0.3},
    {"kind": "sphere", "radius": 0.2},
    {"kind": "disk", "direction": [1, 0, 0], "radius": 0.3},
)


def strength(entry):
    return 2 ** entry.get("stops", 0) * entry["intensity"]


def xdotool(*arguments):
    return subprocess.run(["xdotool", *arguments], capture_output=True, text=True, check=False).stdout


class Check:
    def __init__(self, package, program):
        self.package, self.program, self.edits = package, program, 0
        self.random = random.Random(int(os.environ.get("SEED", "1")))
        self.worst = {}  # by kind: difference and tolerance
        self.names = 0

    # Both sides

    def settle(self, condition=lambda: True):
        """Until nothing is on its way any more: what was asked last is answered after all that came before."""
        live, start, asked = self.live, time.monotonic(), False
        while True:
            bpy.context.view_layer.update()
            live.pump()
            if live.is_open and condition() and not live.pending and not live.is_dirty:
                if asked:
                    return
                live.pending[live.connection.request("rig")] = {}
                asked = True
            assert time.monotonic() - start < PATIENCE, f"no peace: {live.message} {live.pending}"
            time.sleep(0.004)

    def relume(self):
        return relume_client.Client(self.live.file, "check")

    def compare(self, what):
        """All lights of both sides."""
        theirs = self.client.ask("rig")["rig"]["lights"]
        theirs = {key: entry for key, entry in theirs.items() if entry["kind"] != "emitter"}
        self.settle()
        ours = self.package.live.export.entries(bpy.context.scene, self.live.folder)
        assert set(ours) == set(theirs), f"after {what}: {set(ours) ^ set(theirs)}"
        for key, entry in ours.items():
            of = f"after {what}: {key}"
            self.near(of, "watts, relative", 1.0, strength(theirs[key]) / strength(entry), 1e-3)
            for name, (default, tolerance) in NUMBERS.items():
                if name in entry:
                    pair = (entry[name], theirs[key].get(name, default))
                    for a, b in zip(*(value if isinstance(value, list) else [value] for value in pair)):
                        self.near(of, name, a, b, tolerance)
            for name, default in OTHERS.items():
                pair = (entry.get(name, default), theirs[key].get(name, default))
                assert pair[0] == pair[1], f"{of}: {name}: {pair}"

    def near(self, of, name, a, b, tolerance):
        known, _ = self.worst.get(name, (0.0, tolerance))
        self.worst[name] = (max(known, abs(a - b)), tolerance)
        assert abs(a - b) <= tolerance, f"{of}: {name}: Blender has {a}, relume {b}"

    # Edits

    def edit_blender(self):
        pick = self.random
        things = list(self.package.live.export.keys(bpy.context.scene).values())
        if len(things) < 4:  # an undo may have taken all that a new window was told
            self.add_lights(4)
            return "Blender: new lights"
        thing = pick.choice(things)
        light = thing.data
        edits = ["move", "turn", "color", "energy", "size", "switch", "group", "new", "delete", "rename", "world", "many"]
        kind = pick.choice(edits)
        if kind == "move":
            thing.location += Vector(pick.uniform(-1, 1) for _ in range(3))
        elif kind == "turn":
            thing.rotation_euler = Euler(pick.uniform(-3, 3) for _ in range(3))
        elif kind == "color":
            light.color = [pick.uniform(0.1, 1) for _ in range(3)]
        elif kind == "energy":
            light.energy *= 2 ** pick.uniform(-2, 2)
        elif kind == "size":
            if light.type == "AREA":
                light.size, light.spread = pick.uniform(0.1, 2), pick.uniform(0.3, 3)
            elif light.type == "SPOT":
                light.spot_size, light.spot_blend = pick.uniform(0.2, 2), pick.uniform(0, 1)
            elif light.type == "SUN":
                light.angle = pick.uniform(0, 0.2)
            else:
                light.shadow_soft_size = pick.uniform(0, 0.3)
        elif kind == "switch":
            thing.hide_render = not thing.hide_render
        elif kind == "group":
            thing.lightgroup = pick.choice(["", "practicals"])
            self.live.poll_at = 0.0  # as if a second had passed
        elif kind == "new":
            self.add_lights(1)
        elif kind == "delete" and len(things) > 6:
            bpy.data.objects.remove(thing)
        elif kind == "rename":
            self.names += 1
            thing.name = f"renamed.{self.names:03}"
        elif kind == "world":
            nodes = bpy.context.scene.world.node_tree.nodes
            nodes["Background"].inputs["Strength"].default_value = pick.uniform(0.1, 1)
            nodes["Mapping"].inputs["Rotation"].default_value[2] = pick.uniform(-3, 3)
        else:
            for each in things:
                each.location.z += 0.1
        return f"Blender: {kind}"

    def add_lights(self, count):
        for _ in range(count):
            self.names += 1
            place = [self.random.uniform(-2, 2) for _ in range(3)]
            addon.new_light(f"new {self.names}", self.random.choice(["POINT", "SPOT", "SUN", "AREA"]), place, energy=20)

    def edit_relume(self):
        pick = self.random
        everything = self.client.ask("rig")["rig"]["lights"]
        entries = {key: entry for key, entry in everything.items() if entry["kind"] not in ("emitter", "dome")}
        key = pick.choice(list(entries))
        entry = entries[key]
        edits = ["move", "turn", "color", "kelvin", "watt", "stops", "size", "switch"]
        kind = pick.choice([*edits, "new", "delete", "rename", "dome", "group", "undo", "links"])
        if kind == "move" and "position" in entry:
            self.client.edit({key: {"position": [x + pick.uniform(-1, 1) for x in entry["position"]]}})
        elif kind == "turn" and "direction" in entry:
            self.client.edit({key: {"direction": [pick.uniform(-1, 1) for _ in range(3)]}})
        elif kind == "color":
            self.client.edit({key: {"color": [pick.uniform(0.05, 1) for _ in range(3)]}})
        elif kind == "kelvin":
            self.client.edit({key: {"kelvin": pick.uniform(2000, 9000)}})
        elif kind == "watt":
            self.client.edit({key: {"watt": pick.uniform(1, 500)}})
        elif kind == "stops":
            self.client.edit({key: {"stops": pick.uniform(-2, 2)}})
        elif kind == "size" and entry["kind"] == "rect":
            sides = {side: pick.uniform(0.1, 2) for side in ("width", "height")}
            self.client.edit({key: {**sides, "spread_deg": pick.uniform(20, 180)}})
        elif kind == "size" and entry["kind"] == "spot":
            self.client.edit({key: {"outer_deg": 40, "inner_deg": pick.uniform(20, 39)}})
        elif kind == "size" and entry["kind"] in ("disk", "point"):
            self.client.edit({key: {"radius": pick.uniform(0.05, 0.5)}})
        elif kind == "switch":
            self.client.edit({key: {"enabled": not entry["enabled"], "shadows": not entry["shadows"]}})
        elif kind == "new":
            self.names += 1
            shape = pick.choice(SHAPES)
            place = [pick.uniform(-2, 2) for _ in range(3)]
            self.client.edit({f"there {self.names}": {**shape, "position": place, "watt": 30}})
        elif kind == "delete" and len(entries) > 6:
            self.client.edit({key: None})
        elif kind == "rename":
            self.names += 1
            self.client.edit({key: {"name": f"there {self.names}"}})
        elif kind == "dome":
            dome = next(key for key, entry in everything.items() if entry["kind"] == "dome")
            self.client.edit({dome: {"rotate_deg": pick.uniform(0, 360), "stops": pick.uniform(-1, 1)}})
        elif kind == "group":
            self.client.ask("edit", rig={"groups": {"new group": {}}, "lights": {key: {"group": "new group"}}})
        elif kind == "links":
            self.client.edit({key: {"except": ["block"], "only": None}})
        elif kind == "undo":
            self.client.ask("rig")
            self.client.events.clear()
            xdotool("key", "ctrl+z")  # in the window, as a person
            self.client.wait("edited")
        return f"relume: {kind}"

    # Runs

    def start(self):
        self.live = self.package.Live(bpy.context.scene)
        self.package.begin(self.live)
        self.live.start(self.program, ("--gi", "off"))
        self.settle()
        self.client = self.relume()
        self.window()

    def window(self):
        start = time.monotonic()
        while True:
            found = xdotool("search", "--onlyvisible", "--name", "relume$").split()
            if found:
                xdotool("windowactivate", found[-1], "windowfocus", found[-1])
                if xdotool("getwindowfocus").strip() == found[-1]:
                    return
            assert time.monotonic() - start < PATIENCE, "no window"
            time.sleep(0.1)

    def alternate(self, count):
        for number in range(count):
            what = self.edit_blender() if number % 2 == 0 else self.edit_relume()
            self.settle()
            self.compare(f"edit {number}, {what}")
            self.edits += 1

    def change_scene(self):
        """An object that moves is said to, and relume loads it while all lights stay."""
        assert not self.live.outdated, f"nothing but lights has changed, but {self.live.outdated}"
        bpy.data.objects["block"].location.x += 0.2
        bpy.context.view_layer.update()
        assert self.live.outdated == {"block"}, self.live.outdated
        self.client.ask("rig")
        self.client.events.clear()
        self.live.reload()
        opened = lambda: any(event["event"] == "opened" for event in self.client.events)  # noqa: E731
        while not opened():
            self.live.pump()
            self.client.ask("rig")
        self.settle()
        assert not self.live.outdated, self.live.outdated

    def kill_window(self):
        self.live.process.kill()
        self.live.process.wait()
        start = time.monotonic()
        while self.live.is_open:
            self.live.pump()
            assert time.monotonic() - start < PATIENCE
        self.edit_blender()  # goes on alone
        bpy.context.view_layer.update()
        self.live.forget_autosaves()
        command = [self.program, "view", self.live.glb, "--rig", self.live.rig, "--listen", self.live.file]
        command += ["--gi", "off", "--size", "{}x{}".format(*addon.SIZE)]
        self.live.process = subprocess.Popen(list(map(str, command)))
        self.settle()
        self.client = self.relume()
        self.window()

    def drop_blender(self):
        """As after a crash: the file as it was saved, and nothing known."""
        process = self.live.process
        self.live.stop()
        entries = self.client.ask("rig")["rig"]["lights"]
        self.client.edit({next(key for key, entry in entries.items() if "position" in entry): {"stops": 1.25}})
        self.live = self.package.Live(bpy.context.scene, takes_theirs=True)
        self.live.process = process
        self.package.begin(self.live)
        self.settle()


def check(relume):
    """Edits on both sides in turn, all lights compared after each one; after each 20 the scene changes, and a kill."""
    if "DISPLAY" not in os.environ:
        print("\nnot run: live, which needs a display")
        return True
    addon.lit_room(relume.folder)
    live = Check(addon.load(), Path(relume.path).resolve())
    try:
        live.start()
        live.compare("opening")
        for part in range(EDITS // 20):
            live.alternate(20)
            live.change_scene()
            live.compare(f"loading again {part}")
            live.random.choice([live.kill_window, live.drop_blender])()
            live.compare(f"kill {part}")
    finally:
        live.live.process.kill()
    print(f"\n{live.edits} edits, {EDITS // 20} kills: both sides agreed after each one")
    print("\n| what | largest difference | allowed |\n|---|---|---|")
    for kind, (apart, tolerance) in sorted(live.worst.items()):
        print(f"| {kind} | {apart:.1e} | {tolerance:.0e} |")
    return True

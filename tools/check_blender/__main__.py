"""Whether relume opens what Blender writes, shows it where Blender does, and lights it as Cycles does.

    python3 tools/check_blender RELUME FOLDER [places] [files] [light] [kinds] [live]

builds scenes in Blender, exports them as glTF and prints tables in Markdown: how far bright markers are from Blender's own
projection (posed skins, instances, particles, shape keys, mirrored objects), what each option of the exporter changes,
each object's mean radiance beside that of Cycles, each kind of light through the add-on beside Cycles, and whether Blender
and a window agree while both are edited (this needs a display). Exit status 1 if markers are off by more than half a pixel, a file
is refused, or a Lambert room differs from Cycles by more than 1 %. Needs Python with the package bpy (5.0); takes some
minutes. Pictures and files stay in FOLDER.
"""

import sys

import files
import kinds
import light
import live
import pictures
import places

PARTS = {"places": places.check, "files": files.check, "light": light.check, "kinds": kinds.check, "live": live.check}


def main():
    if len(sys.argv) < 3 or not set(sys.argv[3:]) <= set(PARTS):
        sys.exit(__doc__)
    relume = pictures.Relume(sys.argv[1], sys.argv[2])
    results = {name: PARTS[name](relume) for name in sys.argv[3:] or PARTS}
    for name, is_right in results.items():
        print(f"\n{name}: {'as it should be' if is_right else 'WRONG'}")
    sys.exit(0 if all(results.values()) else 1)


main()

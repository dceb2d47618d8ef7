"""Files to and fro: exports, relume's runs, EXR pictures as arrays."""

import subprocess
from pathlib import Path

import bpy
import numpy


class Relume:
    """The program at `path`; pictures and files lie in `folder`."""

    def __init__(self, path, folder):
        self.path, self.folder = path, Path(folder)
        self.folder.mkdir(parents=True, exist_ok=True)

    def run(self, *arguments, output="stderr"):
        """What it says on stderr, or writes to stdout; refusals raise."""
        done = subprocess.run([self.path, *map(str, arguments)], capture_output=True, text=True)
        if done.returncode != 0:
            raise RuntimeError(f"relume {' '.join(map(str, arguments))}: exit {done.returncode}: {done.stderr.strip()}")
        return getattr(done, output)

    def picture(self, scene, name, size, *options, command="render"):
        """A picture as rows of RGB from the top, and what was said."""
        out = self.folder / f"{name}.exr"
        said = self.run(command, scene, "-o", out, "--size", f"{size[0]}x{size[1]}", *options)
        return read_exr(out), said


def export(path, **options):
    """The open file as .glb, as its user would: modifiers applied, cameras and lights too."""
    settings = dict(export_cameras=True, export_lights=True, export_apply=True, export_gn_mesh=True)
    settings.update(options)
    bpy.ops.export_scene.gltf(filepath=str(path), export_format="GLB", **settings)
    return path


def read_exr(path):
    picture = bpy.data.images.load(str(path), check_existing=False)
    picture.colorspace_settings.name = "Non-Color"
    width, height = picture.size
    pixels = numpy.empty(width * height * 4, numpy.float32)
    picture.pixels.foreach_get(pixels)
    bpy.data.images.remove(picture)
    return pixels.reshape(height, width, 4)[::-1, :, :3].astype(float)


def cycles(size, samples, path):
    """What Cycles makes of the open scene: unclamped, all bounces, through pixels like boxes."""
    scene = bpy.context.scene
    scene.render.engine = "CYCLES"
    scene.render.resolution_x, scene.render.resolution_y = size
    settings = scene.cycles
    settings.device, settings.samples, settings.use_denoising = "CPU", samples, False
    settings.use_adaptive_sampling = False
    settings.sample_clamp_direct = settings.sample_clamp_indirect = 0.0
    settings.max_bounces = settings.diffuse_bounces = settings.glossy_bounces = settings.transmission_bounces = 32
    settings.transparent_max_bounces = 64
    settings.blur_glossy = 0.0
    settings.pixel_filter_type = "BOX"
    scene.render.image_settings.file_format = "OPEN_EXR"
    scene.render.image_settings.color_depth = "32"
    scene.render.filepath = str(path)
    bpy.ops.render.render(write_still=True)
    return read_exr(path)

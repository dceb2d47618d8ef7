"""Every way to export the same scene: none may be refused, and each gives the same picture."""

import numpy

import pictures
import scene

SIZE = (480, 270)

WAYS = {
    "instances": dict(export_gpu_instances=True),
    "WebP": dict(export_image_format="WEBP"),
    "WebP beside PNG": dict(export_image_add_webp=True, export_image_webp_fallback=True),
    "JPEG": dict(export_image_format="JPEG", export_jpeg_quality=95),
    "Draco": dict(export_draco_mesh_compression_enable=True, export_draco_position_quantization=20),
    "tangents": dict(export_tangents=True),
    "all colours": dict(export_all_vertex_colors=True, export_vertex_color="ACTIVE"),
    "extras": dict(export_extras=True, export_attributes=True),
    "modifiers kept": dict(export_apply=False),
    "flat bones": dict(export_hierarchy_flatten_bones=True),
    "full collections": dict(export_hierarchy_full_collections=True),
    "original specular": dict(export_original_specular=True),
    "units as they are": dict(export_import_convert_lighting_mode="RAW"),
    "photometric units": dict(export_import_convert_lighting_mode="SPEC"),
    "z up": dict(export_yup=False),
    "unused too": dict(export_unused_images=True, export_unused_textures=True),
}


def check(relume):
    """Prints how far each way's picture is from that of the defaults; whether all opened."""
    scene.room(is_plain=False)
    usual = pictures.export(relume.folder / "usual.glb", export_import_convert_lighting_mode="COMPAT")
    options = ("--gi", "off", "--no-cache")
    want, said = relume.picture(usual, "usual", SIZE, *options)
    print("\n| export | apart from the default | brighter | what else is said |\n|---|---|---|---|")
    print(f"| default | | | {' / '.join(said.split(chr(10)))} |")
    opened = True
    for way, values in WAYS.items():
        file = pictures.export(
            relume.folder / f"{way.replace(' ', '-')}.glb",
            **{"export_import_convert_lighting_mode": "COMPAT", **values},
        )
        try:
            got, says = relume.picture(file, file.stem, SIZE, *options)
        except RuntimeError as refused:
            print(f"| {way} | REFUSED | {refused} |")
            opened = False
            continue
        apart = numpy.abs(got - want).sum() / want.sum()
        news = [line.split("glb: ")[-1] for line in says.splitlines() if line.split("glb: ")[-1] not in said]
        print(f"| {way} | {apart:.4f} | {got.mean() / want.mean():.4f} | {' / '.join(news)} |")
    return opened

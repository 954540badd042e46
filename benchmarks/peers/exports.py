"""The scenes as files for each renderer: the meshes and the sky are the same files for all."""

from __future__ import annotations

import hashlib
import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
from four_scenes import BenchScene, Part
from raykiln.image import write_exr


def export(scene: BenchScene, folder: Path) -> Path:
    """Write a scene for every renderer, unless it is there in this version; returns its folder."""
    stamp = _stamp()
    target = folder / scene.name
    if (target / "stamp").is_file() and (target / "stamp").read_text() == stamp:
        return target
    shutil.rmtree(target, ignore_errors=True)
    target.mkdir(parents=True)
    for part in scene.parts:
        _write_ply(target / f"{part.name}.ply", part)
    if scene.sky is not None:
        write_exr(target / "sky.exr", {"beauty": scene.sky})
        # With the poles on z, maps begin a quarter turn further on, and LuxCore's go backwards.
        quarter = scene.sky.shape[1] // 4
        for name, sky in (("cycles", scene.sky), ("luxcore", scene.sky[:, ::-1])):
            turned = np.ascontiguousarray(np.roll(sky, quarter, axis=1))
            write_exr(target / f"sky_{name}.exr", {"beauty": turned})
    (target / "raykiln.json").write_text(json.dumps(_for_raykiln(scene), indent=1))
    (target / "mitsuba.xml").write_text(_for_mitsuba(scene))
    (target / "luxcore.scn").write_text(_for_luxcore(scene, target))
    (target / "neutral.json").write_text(json.dumps(_neutral(scene), indent=1))
    (target / "stamp").write_text(stamp)
    return target


def _stamp() -> str:
    """Changes with the code that makes the scenes."""
    files = [Path(__file__).with_name(f"{n}.py") for n in ("exports", "four_scenes", "shapes")]
    return hashlib.sha256(b"".join(f.read_bytes() for f in files)).hexdigest()


def _write_ply(path: Path, part: Part) -> None:
    vertices = part.mesh.vertices.astype("<f4")
    faces = np.empty(len(part.mesh.faces), [("count", "u1"), ("index", "<i4", 3)])
    faces["count"], faces["index"] = 3, part.mesh.faces
    header = (
        "ply\nformat binary_little_endian 1.0\n"
        f"element vertex {len(vertices)}\n"
        "property float x\nproperty float y\nproperty float z\n"
        f"element face {len(faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    path.write_bytes(header.encode() + vertices.tobytes() + faces.tobytes())


def _for_raykiln(scene: BenchScene) -> dict[str, Any]:
    look_at = {"origin": scene.origin, "target": scene.target}
    shapes = []
    for part in scene.parts:
        shape: dict[str, Any] = {"type": "mesh", "file": f"{part.name}.ply", "material": part.name}
        if part.radiance is not None:
            shape["emission"] = {"radiance": part.radiance}
        shapes.append(shape)
    return {
        "version": 1,
        "name": scene.title,
        "cameras": [{"type": "perspective", "fov_deg": scene.fov_deg, "look_at": look_at}],
        "materials": {part.name: _raykiln_material(part) for part in scene.parts},
        "shapes": shapes,
        "lights": [{"type": "environment", "file": "sky.exr"}] if scene.sky is not None else [],
    }


def _raykiln_material(part: Part) -> dict[str, Any]:
    m = part.material
    if m.kind == "metal":
        return {"type": "conductor", "eta": m.eta, "k": m.k, "alpha": m.alpha}
    if m.kind == "glass":
        return {"type": "dielectric", "int_ior": m.eta, "ext_ior": 1.0}
    # Opaque surfaces of every renderer here reflect on both sides.
    return {"type": "diffuse", "reflectance": m.reflectance, "two_sided": True}


def _for_mitsuba(scene: BenchScene) -> str:
    """Film, sampler and integrator are parameters of the file."""
    lines = [
        '<scene version="3.0.0">',
        *(f'  <default name="{n}" value="{v}"/>' for n, v in _MITSUBA_DEFAULTS.items()),
        '  <boolean name="embree_use_robust_intersections" value="$watertight"/>',
        '  <integrator type="path"><integer name="max_depth" value="$depth"/>'
        '<integer name="rr_depth" value="$rr_depth"/></integrator>',
        f'  <sensor type="perspective"><float name="fov" value="{scene.fov_deg}"/>'
        '<float name="near_clip" value="0.001"/><float name="far_clip" value="1000"/>',
        f'    <transform name="to_world"><lookat origin="{_row(scene.origin)}" '
        f'target="{_row(scene.target)}" up="0, 1, 0"/></transform>',
        '    <film type="hdrfilm"><integer name="width" value="$size"/>'
        '<integer name="height" value="$size"/><string name="component_format" value="float32"/>'
        '<string name="pixel_format" value="rgb"/><rfilter type="box"/></film>',
        '    <sampler type="$sampler"><integer name="sample_count" value="$spp"/></sampler>',
        "  </sensor>",
    ]
    if scene.sky is not None:
        sky = '<string name="filename" value="sky.exr"/>'
        lines.append(f'  <emitter type="envmap">{sky}</emitter>')
    for part in scene.parts:
        lines += [
            f'  <shape type="ply"><string name="filename" value="{part.name}.ply"/>'
            '<boolean name="face_normals" value="true"/>',
            f"    {_mitsuba_bsdf(part)}",
        ]
        if part.radiance is not None:
            lines.append(
                f'    <emitter type="area"><rgb name="radiance" value="{_row(part.radiance)}"/>'
                "</emitter>"
            )
        lines.append("  </shape>")
    return "\n".join([*lines, "</scene>", ""])


_MITSUBA_DEFAULTS = {
    "size": 64,
    "spp": 16,
    "depth": 8,
    "rr_depth": 100000,
    "sampler": "independent",
    "watertight": "false",
}


def _mitsuba_bsdf(part: Part) -> str:
    m = part.material
    if m.kind == "metal":
        return (
            '<bsdf type="twosided"><bsdf type="roughconductor">'
            f'<float name="alpha" value="{m.alpha}"/><string name="distribution" value="ggx"/>'
            f'<float name="eta" value="{m.eta}"/><float name="k" value="{m.k}"/></bsdf></bsdf>'
        )
    if m.kind == "glass":
        return (
            f'<bsdf type="dielectric"><float name="int_ior" value="{m.eta}"/>'
            '<float name="ext_ior" value="1"/></bsdf>'
        )
    return (
        '<bsdf type="twosided"><bsdf type="diffuse">'
        f'<rgb name="reflectance" value="{_row(m.reflectance)}"/></bsdf></bsdf>'
    )


def _row(values: Any) -> str:
    return ", ".join(f"{float(v):.9g}" for v in values)


def z_up(p: Any) -> tuple[float, float, float]:
    """A point for a renderer whose skies have their poles on z."""
    return (p[0], -p[2], p[1])


_Z_UP = "1 0 0 0 0 0 1 0 0 -1 0 0 0 0 0 1"  # the same turn as a matrix, column by column


def _for_luxcore(scene: BenchScene, folder: Path) -> str:
    row = 2.0 / scene.size  # LuxCore's images lie one row lower
    words = {
        "scene.camera.screenwindow": _words((-1.0, 1.0, -1.0 - row, 1.0 - row)),
        "scene.camera.type": "perspective",
        "scene.camera.lookat.orig": _words(z_up(scene.origin)),
        "scene.camera.lookat.target": _words(z_up(scene.target)),
        "scene.camera.up": "0 0 1",
        "scene.camera.fieldofview": str(scene.fov_deg),
        "scene.camera.cliphither": "0.001",
    }
    if scene.sky is not None:
        sky = "scene.lights.sky"
        words |= {
            f"{sky}.type": "infinite",
            f"{sky}.file": f'"{folder / "sky_luxcore.exr"}"',
            f"{sky}.gamma": "1",
            f"{sky}.gain": "1 1 1",
        }
    for part in scene.parts:
        name = f"scene.materials.{part.name}"
        words |= {f"{name}.{key}": value for key, value in _luxcore_material(part).items()}
        if part.radiance is not None:
            words |= {
                f"{name}.emission": _words(part.radiance),
                f"{name}.emission.normalizebycolor": "0",
            }
        thing = f"scene.objects.{part.name}"
        words |= {
            f"{thing}.ply": f'"{folder / part.name}.ply"',
            f"{thing}.material": part.name,
            f"{thing}.transformation": _Z_UP,
        }
    for part in scene.parts:
        if part.material.kind == "metal":
            fresnel = f"scene.textures.fresnel_{part.name}"
            words |= {
                f"{fresnel}.type": "fresnelconst",
                f"{fresnel}.n": _words([part.material.eta] * 3),
                f"{fresnel}.k": _words([part.material.k] * 3),
            }
    return "".join(f"{key} = {value}\n" for key, value in sorted(words.items(), key=_order))


def _order(item: tuple[str, str]) -> tuple[bool, str]:
    return (item[0].startswith("scene.objects"), item[0])


def _luxcore_material(part: Part) -> dict[str, str]:
    m = part.material
    if m.kind == "metal":
        roughness = str(m.alpha)
        return {
            "type": "metal2",
            "fresnel": f"fresnel_{part.name}",
            "uroughness": roughness,
            "vroughness": roughness,
        }
    if m.kind == "glass":
        return {
            "type": "glass",
            "kr": "1 1 1",
            "kt": "1 1 1",
            "interiorior": str(m.eta),
            "exteriorior": "1",
        }
    return {"type": "matte", "kd": _words(m.reflectance)}


def _words(values: Any) -> str:
    return " ".join(f"{float(v):.9g}" for v in values)


def _neutral(scene: BenchScene) -> dict[str, Any]:
    """What a renderer without a text format is told (Cycles)."""
    parts = [
        {
            "name": part.name,
            "file": f"{part.name}.ply",
            "material": vars(part.material),
            "radiance": part.radiance,
        }
        for part in scene.parts
    ]
    return {
        "origin": scene.origin,
        "target": scene.target,
        "fov_deg": scene.fov_deg,
        "sky": "sky_cycles.exr" if scene.sky is not None else None,
        "parts": parts,
    }

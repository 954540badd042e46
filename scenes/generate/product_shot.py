"""A glazed mug on a walnut coaster, beside a brass caddy: a glTF file under a sky of its own."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
import paint
from glb import GlbWriter
from kit import Array, coarse, directions, placement, unit
from raykiln.image import encode_exr, encode_png
from raykiln.scene import LookAt, look_at_matrix

CM = 0.01
SIDES = 96
SKY = "product_shot/sky.exr"


class Surface(NamedTuple):
    """Vertices, normals, texture coordinates, faces."""

    vertices: Array
    normals: Array
    uvs: Array
    faces: Array


def smooth_line(points: list[tuple[float, float]], count: int) -> Array:
    """A Catmull-Rom spline through points (n, 2), in `count` steps of equal parameter."""
    p = np.array([points[0], *points, points[-1]], np.float64)
    t = np.linspace(0, len(points) - 1, count + 1)
    i = np.minimum(t.astype(int), len(points) - 2)
    f = (t - i)[:, None]
    a, b, c, d = (p[i + k] for k in range(4))
    line: Array = 0.5 * (
        2 * b + (c - a) * f + (2 * a - 5 * b + 4 * c - d) * f**2 + (3 * b - a - 3 * c + d) * f**3
    )
    return line


def sheet(points: Array, normals: Array, uvs: Array) -> Surface:
    """A grid (rows, columns, ...) as triangles; a quad faces the side that sees it run
    downwards row by row and rightwards column by column."""
    n_rows, columns = points.shape[:2]
    corner = (np.arange(n_rows - 1)[:, None] * columns + np.arange(columns - 1)).reshape(-1)
    below = corner + columns
    faces = np.concatenate(
        [np.stack([corner, below, corner + 1], 1), np.stack([corner + 1, below, below + 1], 1)]
    )
    area = np.cross(
        points.reshape(-1, 3)[faces[:, 1]] - points.reshape(-1, 3)[faces[:, 0]],
        points.reshape(-1, 3)[faces[:, 2]] - points.reshape(-1, 3)[faces[:, 0]],
    )
    faces = faces[np.linalg.norm(area, axis=1) > 1e-9]
    return Surface(points.reshape(-1, 3), normals.reshape(-1, 3), uvs.reshape(-1, 2), faces)


def lathe(profile: Array) -> Surface:
    """A profile (n, 2) of radius and height, from the top down, turned about y.

    The front (+z) is at u = 0.5; u runs to the right as seen from outside, v down.
    """
    turn = np.linspace(-np.pi, np.pi, SIDES + 1)
    around = np.stack([np.sin(turn), np.zeros_like(turn), np.cos(turn)], -1)
    up = np.array([0.0, 1.0, 0.0])
    slope = np.gradient(profile, axis=0)
    # With the profile running down the outside, its normal is its direction turned left.
    outward, upward = -slope[:, 1], slope[:, 0]
    points = profile[:, :1, None] * around + profile[:, 1:, None] * up
    normals = unit(outward[:, None, None] * around + upward[:, None, None] * up)
    run = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(profile, axis=0), axis=1))])
    shape = (len(profile), SIDES + 1)
    u = np.broadcast_to((turn / (2 * np.pi) + 0.5), shape)
    v = np.broadcast_to((run / run[-1])[:, None], shape)
    return sheet(points * CM, normals, np.stack([u, v], -1))


def rounded(corners: list[tuple[float, float]], radius: float, steps: int = 6) -> Array:
    """A profile through corners, the inner ones rounded off."""
    points = [np.array(corners[0])]
    for before, here, after in zip(corners, corners[1:], corners[2:], strict=False):
        p = np.array(here)
        a, b = (p + radius * _unit2(np.array(q) - p) for q in (before, after))
        t = np.linspace(0, 1, steps + 1)[:, None]
        points += list((1 - t) ** 2 * a + 2 * t * (1 - t) * p + t**2 * b)
    points.append(np.array(corners[-1]))
    return np.array(points)


def _unit2(v: Array) -> Array:
    normalized: Array = v / np.linalg.norm(v)
    return normalized


def handle() -> Surface:
    """An oval bar along a bow at the mug's right side (+x)."""
    bow = [(3.85, 7.9), (5.2, 8.25), (6.55, 7.5), (6.9, 5.9), (6.4, 4.2), (5.3, 3.0), (4.15, 2.6)]
    line = smooth_line(bow, 36)
    ahead = np.gradient(line, axis=0)
    ahead /= np.linalg.norm(ahead, axis=1, keepdims=True)
    aside = np.stack([-ahead[:, 1], ahead[:, 0]], 1)
    turn = np.linspace(0, 2 * np.pi, 25)
    wide, thick = 0.62, 0.42
    side = np.zeros((len(line), 1, 3))
    side[:, 0, :2] = aside
    z = np.array([0.0, 0.0, 1.0])
    center = np.concatenate([line, np.zeros((len(line), 1))], 1)[:, None]
    c, s = np.cos(turn)[:, None], np.sin(turn)[:, None]
    points = center + thick * c * side + wide * s * z
    normals = unit(c / thick * side + s / wide * z)
    uvs = np.stack(np.meshgrid(turn / (2 * np.pi), np.linspace(0, 1, len(line))), -1)
    return turned_over(sheet(points * CM, normals, uvs))


def turned_over(surface: Surface) -> Surface:
    """Faces wound the way the normals point."""
    v, f = surface.vertices, surface.faces
    area = np.cross(v[f[:, 1]] - v[f[:, 0]], v[f[:, 2]] - v[f[:, 0]])
    if np.einsum("ij,ij->i", area, surface.normals[f[:, 0]]).sum() < 0:
        return surface._replace(faces=f[:, ::-1])
    return surface


def backdrop() -> Surface:
    """A sheet of paper that lies on the table and curves up behind."""
    turn = np.linspace(0, np.pi / 2, 25)
    front = np.array([[90.0, 0.0]])
    curve = np.stack([-28 - 30 * np.sin(turn), 30 - 30 * np.cos(turn)], 1)
    line = np.concatenate([front, curve, [[-58.0, 160.0]]])
    slope = np.gradient(line, axis=0)
    slope[0], slope[1], slope[-1] = (-1, 0), (-1, 0), (0, 1)
    across = np.array([-150.0, 150.0])
    shape = (len(line), 2)
    points = np.empty((*shape, 3))
    points[..., 0], points[..., 1], points[..., 2] = across, line[:, 1:], line[:, :1]
    normals = np.zeros((*shape, 3))
    normals[..., 1], normals[..., 2] = -slope[:, :1], slope[:, 1:]
    uvs = np.zeros((*shape, 2))
    return turned_over(sheet(points * CM, unit(normals), uvs))


def disk(radius: float, height: float) -> Surface:
    """A level disk with texture coordinates as seen from above."""
    made = lathe(np.array([[1e-4, height], [radius, height]]))
    up = np.broadcast_to([0.0, 1.0, 0.0], made.normals.shape)
    uvs = made.vertices[:, [0, 2]] / (2 * radius * CM) + 0.5
    return turned_over(Surface(made.vertices, up, uvs, made.faces))


def sky() -> Array:
    """A studio (128, 256, 3): a dim room, a tall window with bars, a strip light, a glow above."""
    toward = directions(128)
    x, y, z = np.moveaxis(toward, -1, 0)
    room = np.array([0.13, 0.13, 0.14]) + 0.2 * np.clip(y, 0, 1)[..., None] ** 2
    image = np.where((y < 0)[..., None], 0.12, room) * np.ones(3)
    bearing, elevation = np.degrees(np.arctan2(x, z)), np.degrees(np.arcsin(np.clip(y, -1, 1)))
    # The window stands to the left in front; each axis runs 0 to 1 over it.
    across, upward = (bearing + 84) / 50, (elevation - 3) / 56
    inside = (np.abs(across - 0.5) < 0.5) & (np.abs(upward - 0.5) < 0.5)
    bars = (np.abs(across - 0.5) < 0.03) | (np.abs((upward * 3) % 1 - 0.5) > 0.46)
    daylight = np.array([16.0, 16.6, 18.0]) * (0.55 + 0.45 * np.clip(upward, 0, 1)[..., None])
    image = np.where((inside & ~bars)[..., None], daylight, image)
    strip = (np.abs(bearing - 78) < 9) & (np.abs(elevation - 28) < 30)
    image = np.where(strip[..., None], np.array([7.0, 5.6, 4.2]), image)
    above = np.exp(18 * (toward @ unit([0.1, 1.0, -0.35]) - 1))[..., None]
    lit: Array = image + above * np.array([2.2, 2.1, 2.0])
    return lit


def materials(glb: GlbWriter) -> dict[str, int]:
    """The materials by name."""
    mug = paint.mug()

    def plain(color: list[float], roughness: float, metallic: float = 0.0) -> dict[str, Any]:
        factors = {"baseColorFactor": [*color, 1.0], "roughnessFactor": roughness}
        return {"pbrMetallicRoughness": {**factors, "metallicFactor": metallic}}

    packed = glb.image("mug metal and roughness", bytes(encode_png(mug.metal_roughness)))
    found: dict[str, dict[str, Any]] = {
        "mug": {
            "pbrMetallicRoughness": {
                "baseColorTexture": glb.image("mug color", bytes(encode_png(mug.base_color))),
                "metallicRoughnessTexture": packed,
            },
            "normalTexture": glb.image("mug normals", bytes(encode_png(mug.normal))),
        },
        "glaze": plain([0.02, 0.095, 0.115], 0.14),
        "cream glaze": plain([0.72, 0.66, 0.55], 0.12),
        "gold": plain([0.98, 0.7, 0.27], 0.22, 1.0),
        "coffee": {
            **plain([0.03, 0.012, 0.006], 0.05),
            "extensions": {"KHR_materials_ior": {"ior": 1.34}},
        },
        "walnut": {
            "pbrMetallicRoughness": {
                "baseColorTexture": glb.image("walnut", bytes(encode_png(paint.wood()))),
                "metallicFactor": 0.0,
                "roughnessFactor": 0.42,
            }
        },
        "brass": plain([0.88, 0.62, 0.32], 0.24, 1.0),
        "clay": plain([0.45, 0.25, 0.15], 0.8),
        "paper": plain([0.6, 0.44, 0.34], 0.85),
    }
    return {name: glb.add("materials", name=name, **values) for name, values in found.items()}


def surfaces() -> list[tuple[str, str, Surface, tuple[float, float, float]]]:
    """Name, material, surface and place (in cm) of each mesh."""
    base = 1.2  # the top of the coaster
    outer = smooth_line([(3.7, 10), (4.03, 8), (4.36, 6), (4.5, 4), (4.22, 1.6), (3.5, 0.25)], 40)
    foot = rounded([(3.5, 0.25), (3.25, 0.0), (0.01, 0.0)], 0.15)
    turn = np.linspace(0, np.pi, 9)
    lip = np.stack([3.54 - 0.16 * np.cos(turn), 10 + 0.16 * np.sin(turn)], 1)
    inner = smooth_line([(3.38, 10), (3.78, 8), (4.1, 5), (3.7, 1.4), (1.5, 0.7), (0.01, 0.65)], 32)
    caddy = rounded([(4.4, 7.5), (4.6, 7.3), (4.6, 0.2), (4.4, 0), (0.01, 0)], 0.14)
    lid = rounded([(0.01, 9.3), (3.2, 9.0), (4.75, 8.5), (4.75, 7.5), (4.3, 7.5)], 0.3)
    ball = np.linspace(0, np.pi, 25)
    knob = np.stack([0.85 * np.sin(ball) + 1e-3, 10.0 + 0.85 * np.cos(ball)], 1)
    slab = rounded([(6.2, base), (6.4, base - 0.02), (6.4, 0), (0.01, 0)], 0.1)
    here, behind = (0.0, base, 0.0), (-11.5, 0.0, -13.0)
    return [
        ("mug wall", "mug", lathe(outer), here),
        ("mug foot", "clay", lathe(foot), here),
        ("mug lip", "gold", lathe(lip[::-1]), here),
        ("mug inside", "cream glaze", turned_over(lathe(inner)), here),
        ("mug handle", "glaze", handle(), here),
        ("coffee", "coffee", disk(3.62, 8.9), here),
        ("coaster top", "walnut", disk(6.21, base), (0.0, 0.0, 0.0)),
        ("coaster edge", "walnut", lathe(slab), (0.0, 0.0, 0.0)),
        ("caddy", "brass", lathe(caddy), behind),
        ("caddy lid", "brass", lathe(lid), behind),
        ("caddy knob", "walnut", lathe(knob), behind),
        ("backdrop", "paper", backdrop(), (0.0, 0.0, 0.0)),
    ]


def look(origin: list[float], target: list[float]) -> list[float]:
    """A node's matrix, column by column, for a camera or a light that looks at a point (cm)."""
    matrix = look_at_matrix(LookAt(origin=scaled(origin), target=scaled(target)))
    return [round(float(x), 6) for x in matrix.T.reshape(-1)]


def scaled(point: list[float]) -> tuple[float, float, float]:
    """Centimetres as metres."""
    return point[0] * CM, point[1] * CM, point[2] * CM


def build() -> dict[str, bytes]:
    """The files of the scene."""
    glb = GlbWriter()
    names = materials(glb)
    nodes = []
    for name, material, surface, place in surfaces():
        at = placement(np.array(place) * CM, *np.eye(3))[:3, 3]
        vertices, normals, uvs = (coarse(a, 2.0**-20) for a in surface[:3])
        node = glb.mesh(name, vertices, normals, uvs, surface.faces, names[material])
        glb.document["nodes"][node]["translation"] = [round(float(x), 4) for x in at]
        nodes.append(node)
    lens = {"yfov": math.radians(19.5), "znear": 0.01, "aspectRatio": 16 / 9}
    camera = glb.add("cameras", name="camera", type="perspective", perspective=lens)
    view = look([4.5, 16.0, 56.0], [-1.5, 5.5, 0.0])
    nodes.append(glb.add("nodes", name="camera", camera=camera, matrix=view))
    rim = {
        "type": "spot",
        "name": "rim",
        "color": [1.0, 0.82, 0.6],
        "intensity": 1.3,
        "spot": {"innerConeAngle": 0.1, "outerConeAngle": 0.3},
    }
    extension = {"KHR_lights_punctual": {"light": 0}}
    aim = look([38.0, 42.0, -38.0], [0.0, 6.0, 0.0])
    nodes.append(glb.add("nodes", name="rim", extensions=extension, matrix=aim))
    own = {
        "name": "Product shot",
        "description": "A textured glTF product shot: a glazed mug with a name in gold leaf, "
        "a walnut coaster and a brass caddy, under a window sky painted by code.",
        "settings": {"width": 960, "height": 540, "spp": 128, "max_depth": 8},
        "lights": [{"type": "environment", "file": SKY, "scale": 0.55}],
    }
    glb.add("scenes", name="product shot", nodes=nodes, extras={"raykiln": own})
    glb.document["scene"] = 0
    glb.document["extensionsUsed"] = ["KHR_lights_punctual", "KHR_materials_ior"]
    glb.document["extensions"] = {"KHR_lights_punctual": {"lights": [rim]}}
    exr = bytes(encode_exr({"beauty": coarse(sky(), 2.0**-10)}, half=True))
    return {"product_shot.glb": glb.content(), SKY: exr}

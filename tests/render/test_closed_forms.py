"""Scenes whose radiance is known exactly."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
import raykiln as rk

from .statistics import Estimate, excess
from .support import floor, looking, placed, radiance, render_runs

WHITE = rk.Diffuse(reflectance=1.0)


def assert_radiance(estimate: Estimate, expected: Any, *, relative: float = 1e-3) -> None:
    """The mean of the image is `expected` within its error bars (and rounding)."""
    whole = estimate.whole()
    truth = Estimate(np.broadcast_to(np.asarray(expected, float), whole.runs.shape))
    off = excess(whole, truth, relative=relative, sigmas=5.0).max()
    assert off <= 1, f"{whole.mean.ravel()} +- {whole.standard_error.ravel()}, not {expected}"


def closed_room(shape: str, reflectance: float) -> rk.Scene:
    """A room whose walls all shine inwards with radiance (1, 2, 3)."""
    scene = rk.Scene()
    scene.add_material("wall", rk.Diffuse(reflectance=reflectance))
    wall = {"material": "wall", "flip_normals": True}
    shine = rk.Emission(radiance=(1.0, 2.0, 3.0))
    room = rk.Sphere if shape == "sphere" else rk.Cube
    scene.shapes.append(room(**wall, emission=shine))
    return looking(scene, (0.1, 0.2, 0.3), (0.5, -0.4, -0.6), fov_deg=70)


@pytest.mark.parametrize("shape", ["sphere", "cube"])
@pytest.mark.parametrize("reflectance", [0.2, 0.5, 0.8])
def test_closed_room_sums_the_series(shape: str, reflectance: float) -> None:
    scene = closed_room(shape, reflectance)
    found = render_runs(scene, 8, width=16, height=16, spp=64, max_depth=-1, rr_depth=3)
    assert_radiance(found, np.array([1, 2, 3]) / (1 - reflectance))


@pytest.mark.parametrize("max_depth", [1, 2, 3, 6])
def test_closed_room_cut_at_a_depth(max_depth: int) -> None:
    scene = closed_room("sphere", 0.6)
    found = render_runs(scene, 8, width=8, height=8, spp=64, max_depth=max_depth, rr_depth=-1)
    assert_radiance(found, np.array([1, 2, 3]) * (1 - 0.6**max_depth) / (1 - 0.6))


LOSSLESS: dict[str, Any] = {
    "diffuse": WHITE,
    "mirror": rk.Conductor(metal="none"),
    "glass": rk.Dielectric(int_ior=1.5, ext_ior=1.0),
    "diamond": rk.Dielectric(int_ior=2.4, ext_ior=1.0),
    "thin glass": rk.Dielectric(int_ior=1.5, ext_ior=1.0, thin=True),
    "plastic": rk.Plastic(diffuse_reflectance=1.0, int_ior=1.5, ext_ior=1.0),
    "colourless nonlinear plastic": rk.Plastic(
        diffuse_reflectance=1.0, int_ior=1.5, ext_ior=1.0, nonlinear=True
    ),
}


def in_a_furnace(material: Any) -> rk.Scene:
    """A ball in even light of radiance 1, which fills the image."""
    scene = rk.Scene()
    scene.add_sphere(material=material)
    scene.add_light(rk.ConstantLight(radiance=1.0))
    return looking(scene, (0, 0, 5), (0, 0, 0), fov_deg=16)


@pytest.mark.parametrize("name", LOSSLESS)
def test_lossless_ball_vanishes_in_a_furnace(name: str) -> None:
    settings: dict[str, Any] = {
        "width": 16,
        "height": 16,
        "spp": 64,
        "max_depth": -1,
        "rr_depth": 8,
    }
    assert_radiance(render_runs(in_a_furnace(LOSSLESS[name]), 8, **settings), 1.0)


def lossy() -> dict[str, Any]:
    """Materials that lose light between facets, at several roughnesses."""
    found: dict[str, Any] = {}
    for alpha in (0.05, 0.3, 0.8):
        for kind in ("ggx", "beckmann"):
            rough: dict[str, Any] = {"alpha": alpha, "distribution": kind}
            found[f"mirror {kind} {alpha}"] = rk.Conductor(metal="none", **rough)
            found[f"glass {kind} {alpha}"] = rk.Dielectric(**rough)
            found[f"plastic {kind} {alpha}"] = rk.Plastic(diffuse_reflectance=1.0, **rough)
        found[f"brushed {alpha}"] = rk.Conductor(metal="none", alpha=alpha, alpha_v=0.1)
        for metallic in (0.0, 0.5, 1.0):
            for transmission in (0.0, 0.6):
                found[f"principled {alpha} {metallic} {transmission}"] = rk.Principled(
                    base_color=1.0,
                    roughness=math.sqrt(alpha),
                    metallic=metallic,
                    transmission=transmission,
                )
    return found


@pytest.mark.parametrize("name", lossy())
def test_no_material_makes_energy(name: str) -> None:
    settings: dict[str, Any] = {
        "width": 16,
        "height": 16,
        "spp": 16,
        "max_depth": -1,
        "rr_depth": 8,
    }
    # Runs enough for an error bar to be trusted at five sigma.
    found = render_runs(in_a_furnace(lossy()[name]), 24, **settings).blocks(4)
    above = found.mean - 5 * found.standard_error
    assert above.max() <= 1.001
    assert found.mean.min() > 0.3


def seen_spot(light: Any = None) -> rk.Scene:
    """A white floor whose origin fills the image, seen from low beside it."""
    scene = rk.Scene()
    scene.add_material("white", WHITE)
    scene.add_material("black", rk.Diffuse(reflectance=0.0))
    scene.shapes.append(floor("white"))
    if light is not None:
        scene.add_light(light)
    return looking(scene, (0, 2, 4), (0, 0, 0), fov_deg=0.05)


SPOT: dict[str, Any] = {"width": 8, "height": 8, "spp": 64, "max_depth": 2}


@pytest.mark.parametrize("center", [(0, 3, 0), (2, 2, -1), (-4, 1.5, 1), (0.6, 0.9, 0)])
@pytest.mark.parametrize("radius", [0.05, 0.8])
def test_irradiance_of_a_sphere_light(center: tuple[float, ...], radius: float) -> None:
    scene = seen_spot()
    scene.add_sphere(center, radius, "black", emission=(5.0, 4.0, 3.0))  # type: ignore[arg-type]
    squared = float(np.dot(center, center))
    form_factor = radius**2 / squared * center[1] / math.sqrt(squared)
    found = render_runs(scene, 8, **SPOT)
    assert_radiance(found, np.array([5, 4, 3]) * form_factor)


def parallel_form_factor(a: float, b: float, distance: float) -> float:
    """From a point to an a x b rectangle that faces it, one corner straight above it."""
    x, y = a / distance, b / distance
    p, q = math.sqrt(1 + x * x), math.sqrt(1 + y * y)
    return (x / p * math.atan(y / p) + y / q * math.atan(x / q)) / (2 * math.pi)


@pytest.mark.parametrize(("a", "b", "height"), [(1, 1, 1), (4, 0.5, 1), (0.2, 3, 2), (30, 30, 1)])
def test_irradiance_of_a_rectangle_light(a: float, b: float, height: float) -> None:
    scene = seen_spot()
    place = placed((a / 2, height, -b / 2), (a / 2, b / 2, 1), turn_x_deg=90)
    shine = rk.Emission(radiance=(5.0, 4.0, 3.0))
    scene.shapes.append(rk.Rectangle(material="black", transform=place, emission=shine))
    found = render_runs(scene, 8, **SPOT)
    assert_radiance(found, np.array([5, 4, 3]) * parallel_form_factor(a, b, height))


def test_point_light() -> None:
    scene = seen_spot(rk.PointLight(position=(1, 2, -2), intensity=(9.0, 18.0, 27.0)))
    assert_radiance(render_runs(scene, 2, **SPOT), np.array([1, 2, 3]) / math.pi * 2 / 3)


def test_directional_light() -> None:
    scene = seen_spot(rk.DirectionalLight(direction=(3, -4, 0), irradiance=(1.0, 2.0, 3.0)))
    assert_radiance(render_runs(scene, 2, **SPOT), np.array([1, 2, 3]) * 0.8 / math.pi)


@pytest.mark.parametrize(("degrees", "share"), [(5, 1.0), (29, None), (41, 0.0)])
def test_spot_light(degrees: float, share: float | None) -> None:
    angle = math.radians(degrees)
    axis = (math.sin(angle), -math.cos(angle), 0.0)
    light = rk.SpotLight(
        position=(0, 2, 0), direction=axis, intensity=4.0, inner_angle_deg=15, outer_angle_deg=40
    )
    if share is None:
        inner, outer = math.cos(math.radians(15)), math.cos(math.radians(40))
        share = ((math.cos(angle) - outer) / (inner - outer)) ** 2
    assert_radiance(render_runs(seen_spot(light), 2, **SPOT), share / math.pi)


def sky_irradiance(pixels: Any, world_from_light: Any, fine: int = 512) -> Any:
    """On a floor that faces +y, by quadrature over the bilinear map."""
    height, width = pixels.shape[:2]
    y, phi = np.meshgrid((np.arange(fine) + 0.5) / fine, (np.arange(2 * fine) + 0.5) / fine)
    phi = phi * np.pi
    ring = np.sqrt(1 - y * y)
    world = np.stack([ring * np.cos(phi), y, ring * np.sin(phi)], axis=-1)
    d = world @ world_from_light
    x = np.mod(np.arctan2(d[..., 0], -d[..., 2]) / (2 * np.pi), 1) * width - 0.5
    row = np.arccos(np.clip(d[..., 1], -1, 1)) / np.pi * height - 0.5
    left, top = np.floor(x).astype(int), np.floor(row).astype(int)
    fx, fy = (x - left)[..., None], (row - top)[..., None]

    def texel(i: Any, j: Any) -> Any:
        return pixels[np.clip(j, 0, height - 1), i % width]

    upper = texel(left, top) * (1 - fx) + texel(left + 1, top) * fx
    lower = texel(left, top + 1) * (1 - fx) + texel(left + 1, top + 1) * fx
    radiance_ = upper * (1 - fy) + lower * fy
    return (radiance_ * y[..., None]).mean(axis=(0, 1)) * 2 * np.pi


@pytest.mark.parametrize("texel", [(3, 1), (9, 4), (15, 7), (0, 0)])
def test_environment_with_one_bright_texel(texel: tuple[int, int]) -> None:
    pixels = np.zeros((16, 16, 3), np.float32)
    pixels[texel[1], texel[0]] = 100, 200, 50
    angle = 0.7
    c, s = math.cos(angle), math.sin(angle)
    turn = np.array([[c, -s, 0, 0], [s, c, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
    rows = tuple(tuple(float(x) for x in row) for row in turn)
    light = rk.EnvironmentLight(pixels=pixels, transform=rows)
    expected = sky_irradiance(pixels, turn[:3, :3]) / math.pi
    found = render_runs(seen_spot(light), 8, **{**SPOT, "spp": 256})
    if not expected.any():
        assert not found.runs.any()
        return
    assert_radiance(found, expected, relative=3e-3)


def fresnel(cosine: float, eta: float) -> float:
    """Reflectance of unpolarised light that enters a medium of index eta."""
    sine = math.sqrt(1 - cosine**2) / eta
    inner = math.sqrt(1 - sine**2)
    s = (cosine - eta * inner) / (cosine + eta * inner)
    p = (inner - eta * cosine) / (inner + eta * cosine)
    return (s * s + p * p) / 2


def slab(angle: float, eta: float) -> rk.Scene:
    """A pane of thickness 1 between x = 0 and x = -1, seen along a ray through (0, 0, 0)."""
    scene = rk.Scene()
    scene.add_material("glass", rk.Dielectric(int_ior=eta, ext_ior=1.0))
    scene.add_material("black", rk.Diffuse(reflectance=0.0))
    scene.shapes.append(rk.Cube(material="glass", transform=placed((-0.5, 0, 0), (0.5, 400, 400))))
    origin = (5 * math.cos(angle), 5 * math.sin(angle), 0)
    return looking(scene, origin, (0, 0, 0), up=(0, 0, 1), fov_deg=0.01)


def wall_behind(scene: rk.Scene, y: float, half: float) -> None:
    """A strip that shines towards +x, in the plane x = -2, about a height y."""
    matrix = ((0, 0, 1, -2), (half, 0, 0, y), (0, 400, 0, 0), (0, 0, 0, 1))
    scene.shapes.append(
        rk.Rectangle(material="black", transform=matrix, emission=rk.Emission(radiance=1.0))
    )


@pytest.mark.parametrize("degrees", [0.0, 30.0, 56.3, 75.0])
@pytest.mark.parametrize("eta", [1.33, 1.5, 2.4])
def test_slab_transmits_by_fresnel(degrees: float, eta: float) -> None:
    angle = math.radians(degrees)
    scene = slab(angle, eta)
    wall_behind(scene, 0.0, 390.0)
    r = fresnel(math.cos(angle), eta)
    found = render_runs(scene, 8, width=8, height=8, spp=128, max_depth=-1, rr_depth=-1)
    assert_radiance(found, (1 - r) / (1 + r))


@pytest.mark.parametrize("degrees", [20.0, 45.0, 70.0])
@pytest.mark.parametrize("eta", [1.33, 1.5, 2.4])
def test_slab_shifts_by_snell(degrees: float, eta: float) -> None:
    angle = math.radians(degrees)
    inside = math.asin(math.sin(angle) / eta)
    # Through the pane at its inner angle, then one unit more to the wall.
    y = -math.tan(inside) - math.tan(angle)
    r = fresnel(math.cos(angle), eta)
    for shift, expected in ((0.0, (1 - r) ** 2), (0.03, 0.0), (-0.03, 0.0)):
        scene = slab(angle, eta)
        wall_behind(scene, y + shift, 0.01)
        settings: dict[str, Any] = {
            "width": 4,
            "height": 4,
            "spp": 256,
            "max_depth": 3,
            "rr_depth": -1,
        }
        assert_radiance(render_runs(scene, 6, **settings), expected)


def test_total_reflection_inside() -> None:
    # From within, beyond the critical angle, no light of the sky is seen.
    scene = rk.Scene()
    scene.add_material("glass", rk.Dielectric(int_ior=1.5, ext_ior=1.0))
    scene.shapes.append(rk.Cube(material="glass", transform=placed((0, -100, 0), (99, 100, 99))))
    scene.add_light(rk.ConstantLight(radiance=1.0))
    for degrees, dark in ((41.0, False), (42.5, True)):
        angle = math.radians(degrees)
        looking(scene, (0, -1, 0), (math.tan(angle), 0, 0), fov_deg=0.1)
        seen = radiance(scene, max_depth=2, spp=64)
        assert (seen.max() == 0) == dark


def gem(scene: rk.Scene, **where: Any) -> None:
    """An octahedron with smooth normals."""
    corners = [(1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1)]
    points = np.array(corners, np.float32)
    faces = [(x, y, z) if (x + y + z) % 2 else (x, z, y) for x in (0, 1) for y in (2, 3)
             for z in (4, 5)]  # fmt: skip
    scene.add_mesh(points, np.array(faces, np.uint32), normals=points, **where)


@pytest.mark.parametrize("shines", [False, True])
def test_instances_look_like_baked_copies(shines: bool) -> None:
    turn = np.array(placed((0, 0, 0), (0.5, 0.7, 0.4), turn_x_deg=25))
    mirror = np.array(placed((1.4, 1, 0), (-0.6, 0.5, 0.6)))
    moved = turn.copy()
    moved[:3, 3] = -1.2, 1.2, 0.4
    matrices = np.stack([moved, mirror]).astype(np.float32)
    shine: dict[str, Any] = {"emission": (2.0, 1.0, 0.5)} if shines else {}
    images = []
    for instanced in (True, False):
        scene = seen_spot(rk.PointLight(position=(1, 4, 2), intensity=20.0))
        look: dict[str, Any] = {"material": rk.Plastic(diffuse_reflectance=(0.2, 0.5, 0.7))}
        if instanced:
            gem(scene, group="gem", **look, **shine)
            scene.add_instances("gem", matrices)
        else:
            for matrix in matrices:
                gem(scene, transform=matrix.tolist(), **look, **shine)
        looking(scene, (0, 3, 6), (0, 0.7, 0), fov_deg=40)
        images.append(render_runs(scene, 8, width=32, height=32, spp=32, max_depth=5))
    off = excess(images[0].blocks(), images[1].blocks(), relative=0.005, sigmas=5)
    assert off.max() <= 1


def test_depth_and_normal_of_a_plane() -> None:
    scene = seen_spot()
    looking(scene, (0, 3, 0), (0, 0, 0), up=(0, 0, -1), fov_deg=60)
    settings = rk.RenderSettings(width=8, height=8, spp=4, aovs=("depth", "normal", "albedo"))
    aovs = rk.render(scene, settings).aovs
    np.testing.assert_allclose(aovs["depth"], 3.0, rtol=1e-5)
    np.testing.assert_allclose(aovs["normal"], np.broadcast_to((0, 1, 0), (8, 8, 3)), atol=1e-5)
    np.testing.assert_allclose(aovs["albedo"], 1.0, rtol=1e-6)

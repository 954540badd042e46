"""The scene whose bits are compared, and a process that renders it until it is killed.

python -m render.bit_scene CHECKPOINT SPP
"""

from __future__ import annotations

import sys
from typing import Any

import numpy as np
import raykiln as rk

SETTINGS: dict[str, Any] = {
    "width": 67,  # no multiple of any tile
    "height": 45,
    "max_depth": 6,
    "rr_depth": 3,
    "seed": 7,
    "aovs": ("albedo", "normal", "depth", "variance"),
}


def bit_scene() -> rk.Scene:
    """Meshes, spheres, instances, textures, cut-outs and every kind of light."""
    scene = rk.Scene()
    chart = np.arange(48, dtype=np.uint8).reshape(4, 4, 3) * 5
    scene.add_texture("chart", chart)
    ref = rk.TextureRef(texture="chart")
    scene.add_material("chart", rk.Diffuse(reflectance=ref))
    red = rk.TextureRef(texture="chart", channel="r")
    scene.add_material("holes", rk.Principled(base_color=0.7, roughness=0.3, opacity=red))
    floor = ((4.0, 0, 0, 0), (0, 0, 4.0, 0), (0, -4.0, 0, 0), (0, 0, 0, 1.0))
    scene.shapes.append(rk.Rectangle(material="chart", transform=floor))
    scene.add_sphere((-0.9, 0.6, 0), 0.6, rk.Dielectric(alpha=0.1))
    scene.add_sphere((0.5, 0.5, 0.4), 0.5, rk.Conductor(metal="Cu", alpha=0.2, alpha_v=0.05))
    points = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], np.float32)
    faces = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]], np.uint32)
    scene.add_mesh(points, faces, uvs=points[:, :2].copy(), material="holes", group="pyramid")
    places = np.tile(np.eye(4, dtype=np.float32), (3, 1, 1))
    places[:, :3, 3] = [(-0.3, 0, 1), (1.2, 0.2, -0.4), (0.2, 1.3, -1)]
    scene.add_instances("pyramid", places)
    scene.add_sphere((1.5, 2.2, 0.5), 0.3, emission=(9.0, 8.0, 6.0))
    scene.add_light(rk.PointLight(position=(-2, 3, 1), intensity=(2.0, 3.0, 4.0)))
    scene.add_light(rk.DirectionalLight(direction=(1, -2, -1), irradiance=0.3))
    sky = np.linspace(0.1, 1, 8 * 4 * 3, dtype=np.float32).reshape(4, 8, 3)
    scene.add_light(rk.EnvironmentLight(pixels=sky))
    scene.set_camera(origin=(0, 1.4, 4), target=(0, 0.6, 0))
    return scene


def main() -> None:
    """Render with a checkpoint at every pass, saying a line at each."""
    passes = -1

    def tell(progress: rk.Progress) -> None:
        nonlocal passes
        if progress.spp_done != passes:
            passes = progress.spp_done
            print(passes, flush=True)

    settings = rk.RenderSettings(**SETTINGS, spp=int(sys.argv[2]))
    rk.render(bit_scene(), settings, tell, checkpoint=sys.argv[1], checkpoint_interval_s=0.0)


if __name__ == "__main__":
    main()

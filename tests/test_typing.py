"""Types: a user's script passes mypy in strict mode, and the stubs say what the modules have."""

from __future__ import annotations

import ast
import inspect
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
import raykiln
from raykiln import _core, _image, _oiio

PACKAGE = Path(raykiln.__file__).parent
SCRIPT = """
from pathlib import Path

import numpy as np
import raykiln as rk
from numpy.typing import NDArray


def watch(progress: rk.Progress) -> bool:
    print(f"{progress.fraction:.0%}", progress.eta_s, progress.spp_done, progress.elapsed_s)
    preview: NDArray[np.float32] = progress.preview()
    return preview.size > 0


def build() -> rk.Scene:
    scene = rk.Scene()
    vertices = np.zeros((3, 3), np.float32)
    faces = np.array([[0, 1, 2]], np.uint32)
    gold: str = scene.add_material("gold", rk.Conductor(metal="Au", alpha=0.1))
    mesh: rk.Mesh = scene.add_mesh(vertices, faces, material=gold)
    scene.add_mesh(vertices, faces, normals=vertices, emission=(1.0, 2.0, 3.0), group="lamp")
    scene.add_instances("lamp", np.eye(4)[None])
    ball: rk.Sphere = scene.add_sphere((0, 1, 0), 0.5, rk.Diffuse(reflectance=(0.1, 0.2, 0.3)))
    scene.add_texture("photo", np.zeros((4, 4, 3), np.uint8))
    scene.add_light(rk.PointLight(position=(0, 3, 0), intensity=5))
    scene.add_light(rk.EnvironmentLight(pixels=np.ones((2, 4, 3), np.float32)))
    camera = scene.set_camera(origin=(0, 1, 5), target=(0, 0, 0), fov_deg=35)
    print(mesh.name, ball.radius, camera.fov_deg)
    return scene


def main() -> None:
    scene = rk.load_scene("cornell_box")
    settings = rk.RenderSettings(
        width=512, height=512, spp=256, max_depth=8, seed=0,
        integrator="path", aovs=("albedo", "normal", "depth"), crop=(0, 0, 10, 10),
    )
    result: rk.RenderResult = rk.render(scene, settings, on_progress=watch)
    rk.render(build(), on_progress=lambda p: print(p.fraction, p.eta_s))
    rk.render(scene, checkpoint=Path("state"), resume=True, checkpoint_interval_s=1.0)
    image: NDArray[np.float32] = result.image
    normal: NDArray[np.float32] = result.aovs["normal"]
    stats: rk.RenderStats = result.stats
    seconds: float = stats.render_s
    out: Path = result.save("out.exr", half=True)
    result.save(out.with_suffix(".png"), exposure=0.5, view="agx")
    report: rk.SceneReport = rk.check(scene)
    print(image.mean(), normal.shape, seconds, report.summary(), result.complete)
    text: str = scene.to_json(indent=1)
    names: dict[str, Path] = rk.bundled_scenes()
    print(len(text), names)
    try:
        rk.load_scene("missing.json")
    except rk.SceneError as error:
        where: str | None = error.pointer
        print(where, error.file, error.accepted)
    except (rk.SettingsError, rk.ImageError, rk.RenderError):
        raise


main()
"""
WRONG = """
import raykiln as rk

rk.RenderSettings(spp="many")
rk.render(rk.Scene(), on_progress=lambda p: p.percent)
rk.Scene().add_sphere(radius="large")
"""


def mypy(folder: Path, script: str) -> subprocess.CompletedProcess[str]:
    """Check a script in a folder of its own, as a user's project would."""
    pytest.importorskip("mypy")
    file = folder / "script.py"
    file.write_text(script)
    # Without the settings of this project; the package where it is.
    return subprocess.run(
        [sys.executable, "-m", "mypy", "--strict", "--config-file", "", str(file)],
        cwd=folder,
        env={"MYPYPATH": str(PACKAGE.parent), "PATH": "", "MYPY_CACHE_DIR": str(folder / "cache")},
        capture_output=True,
        text=True,
        check=False,
    )


def complaints(run: subprocess.CompletedProcess[str]) -> list[str]:
    """About the script itself."""
    return [
        line for line in run.stdout.splitlines() if line.startswith("script.py") and "error" in line
    ]


def test_a_users_script_is_typed(tmp_path: Path) -> None:
    run = mypy(tmp_path, SCRIPT)
    assert run.returncode in (0, 1), run.stderr
    assert complaints(run) == []


def test_a_users_mistakes_are_seen(tmp_path: Path) -> None:
    found = complaints(mypy(tmp_path, WRONG))
    assert [line.split(":")[1] for line in found] == ["4", "5", "6"]


def test_the_package_says_that_it_is_typed() -> None:
    assert (PACKAGE / "py.typed").is_file()


@pytest.mark.parametrize("module", [_core, _image, _oiio], ids=["_core", "_image", "_oiio"])
def test_stubs_match_the_compiled_module(module: ModuleType) -> None:
    name = module.__name__.rpartition(".")[2]
    stub = ast.parse((PACKAGE / f"{name}.pyi").read_text())
    assert dict(declared(stub)) == dict(existing(module))


Parameters = tuple[str, ...]


def declared(tree: ast.Module | ast.ClassDef, prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Dotted name -> parameter names (or None) of everything public in a stub."""
    for node in tree.body:
        if isinstance(node, ast.ClassDef):
            yield f"{prefix}{node.name}", None
            yield from declared(node, f"{prefix}{node.name}.")
        elif isinstance(node, ast.FunctionDef):
            is_property = any(isinstance(d, ast.Name) for d in node.decorator_list)
            yield f"{prefix}{node.name}", None if is_property else stub_parameters(node)
        elif isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
            name = node.target.id
            if not name.startswith("_") or name == "__version__":
                yield f"{prefix}{name}", None


def stub_parameters(node: ast.FunctionDef) -> Parameters:
    """Names; those that cannot be named in a call are `_`."""
    names = ["_" for _ in node.args.posonlyargs] + [a.arg for a in node.args.args]
    names = ["_" if name == "self" else name for name in names]
    return (*names, *(f"{a.arg}=" for a in node.args.kwonlyargs))


def existing(owner: Any, prefix: str = "") -> Iterator[tuple[str, Any]]:
    """The same of a compiled module, from the signatures that pybind11 leaves."""
    for name, value in vars(owner).items():
        if name.startswith("_") and name not in ("__init__", "__version__"):
            continue
        if inspect.isclass(value):
            yield f"{prefix}{name}", None
            yield from existing(value, f"{prefix}{name}.")
        else:
            callable_ = callable(value) and not isinstance(value, property)
            yield f"{prefix}{name}", compiled_parameters(value) if callable_ else None


def compiled_parameters(function: Any) -> Parameters:
    """Names from the first signature in a docstring."""
    line = next(line for line in function.__doc__.splitlines() if "->" in line)
    inner = line[line.index("(") + 1 : line.rindex(") ->")]
    depth, parts = 0, [""]
    for character in inner:
        depth += (character in "[(") - (character in "])")
        if character == "," and depth == 0:
            parts.append("")
        else:
            parts[-1] += character
    names: list[str] = []
    keyword_only = False
    for part in (part.strip() for part in parts):
        name = part.partition(":")[0]
        if name == "*":
            keyword_only = True
        elif name:
            unnamed = name == "self" or re.fullmatch(r"arg\d+", name)
            names.append(f"{name}=" if keyword_only else "_" if unnamed else name)
    return tuple(names)

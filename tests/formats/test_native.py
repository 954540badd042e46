"""The native JSON format and its schema."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import jsonschema
import numpy as np
import pytest
from format_support import LoadText
from numpy.testing import assert_array_equal
from raykiln.errors import SceneError
from raykiln.formats import load
from raykiln.formats.native import schema
from raykiln.scene import (
    CheckerTexture,
    Conductor,
    ConstantLight,
    Diffuse,
    DirectionalLight,
    EnvironmentLight,
    ImageTexture,
    Mesh,
    NormalMap,
    PointLight,
    Principled,
    Scene,
    SpotLight,
    TextureRef,
)

TETRAHEDRON = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], np.float32)
FACES = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]], np.uint32)


def full_scene() -> Scene:
    """A scene that uses every part of the description."""
    random = np.random.default_rng(1)
    scene = Scene(name="full", description="all of it", settings={"spp": 4})
    scene.add_texture("noise", random.integers(0, 256, (4, 5, 3), dtype=np.uint8))
    scene.add_texture("deep", ImageTexture(pixels=random.random((8, 8, 4), dtype=np.float32)))
    scene.add_texture("squares", CheckerTexture(uv_transform=((2, 0, 0), (0, 2, 0))))
    scene.add_material("chalk", Diffuse(reflectance=TextureRef(texture="squares")))
    scene.add_material("gold", Conductor(metal="Au", alpha=0.1, alpha_v=0.2))
    scene.add_material("paint", Principled(
        base_color=TextureRef(texture="noise", factor=(1, 0.5, 0.5)),
        roughness=TextureRef(texture="deep", channel="g"),
        normal_map=NormalMap(texture="noise", scale=0.5), alpha_cutoff=0.5,
    ))  # fmt: skip
    scene.add_mesh(TETRAHEDRON, FACES, None, TETRAHEDRON[:, :2], "chalk", emission=(1, 2, 3))
    scene.add_sphere((0, 1, 0), 0.5, "gold", name="ball")
    scene.add_mesh(random.random((90, 3)), np.arange(90).reshape(30, 3), group="leaf")
    scene.add_instances("leaf", np.tile(np.eye(4, dtype=np.float32), (7, 1, 1)))
    scene.add_light(PointLight(position=(0, 4, 0), intensity=3))
    scene.add_light(SpotLight(position=(0, 4, 0), direction=(0, -1, 0), intensity=(1, 2, 3)))
    scene.add_light(DirectionalLight(direction=(0, -1, 0), irradiance=1))
    scene.add_light(ConstantLight(radiance=0.1))
    scene.add_light(EnvironmentLight(pixels=random.random((4, 8, 3), dtype=np.float32)))
    scene.set_camera(origin=(0, 1, 5), target=(0, 0, 0))
    return scene


def assert_same(a: Any, b: Any) -> None:
    """Equal in all parts, arrays to the bit."""
    if isinstance(a, dict):
        assert a.keys() == b.keys()
        for key in a:
            assert_same(a[key], b[key])
    elif isinstance(a, list | tuple):
        assert len(a) == len(b)
        for x, y in zip(a, b, strict=True):
            assert_same(x, y)
    elif isinstance(a, np.ndarray):
        assert a.dtype == b.dtype
        assert_array_equal(a, b)
    else:
        assert a == b


def test_a_scene_comes_back_as_it_went(tmp_path: Path) -> None:
    scene = full_scene()
    (tmp_path / "full.json").write_text(scene.to_json(indent=1))
    again = load(tmp_path / "full.json")
    assert again.warnings == []
    assert_same(scene.model_dump(), again.model_dump())


def test_the_published_schema_is_up_to_date(repo_root: Path) -> None:
    """Made by `python -m raykiln.formats.native > docs/scene.schema.json`."""
    published = json.loads((repo_root / "docs" / "scene.schema.json").read_text())
    assert published == schema()


def test_the_schema_accepts_what_is_written_and_refuses_what_is_wrong() -> None:
    validator = jsonschema.Draft202012Validator(schema())
    validator.check_schema(validator.schema)
    validator.validate(json.loads(full_scene().to_json()))
    assert not validator.is_valid({"shapes": [{"type": "sphere", "radius": -1}]})
    assert not validator.is_valid({"shapes": [{"type": "blob"}]})
    assert not validator.is_valid({"shape": []})


def test_the_schema_accepts_the_bundled_scenes(repo_root: Path) -> None:
    validator = jsonschema.Draft202012Validator(schema())
    for path in sorted((repo_root / "scenes").glob("*.json")):
        validator.validate(json.loads(path.read_text()))


@pytest.mark.parametrize(
    ("text", "pointer", "message"),
    [
        ('{"shapes": [', "line 1, column 13", "not JSON"),
        ('{\n"shapes": [}', "line 2, column 12", "not JSON"),
        ("[]", None, "a scene is a JSON object"),
        ('{"shapes": [NaN]}', None, "finite numbers"),
        ('{"name": "a", "name": "b"}', None, "a name twice"),
        ('{"shapes": ' + "[" * 100_000 + "]" * 100_000 + "}", None, "nested too deeply"),
        ('{"shapes": ' + "9" * 10_000 + "}", None, "damaged"),
        ('{"shapes": [{"type": "sphere", "radius": -1}]}', "/shapes/0/radius", "greater than 0"),
        ('{"shapes": [{"type": "blob"}]}', "/shapes/0", "does not match any"),
        ('{"materials": {"gold": {"type": "conductor", "alfa": 1}}}', "/materials/gold/alfa",
         "not permitted"),
        ('{"shapes": [{"type": "mesh", "vertices": [[0,0,0],[1,0,0],[0,1,0]],'
         '"faces": [[0, 1, 3]]}]}', "/shapes/0", "face 0 refers to vertex 3 of 3"),
        ('{"shapes": [{"type": "mesh", "file": "none.ply"}]}', "/shapes/0/file", "does not exist"),
        ('{"shapes": [{"type": "mesh", "file": "scene.json"}]}', "/shapes/0/file",
         "not a mesh file"),
        ('{"textures": {"a": {"type": "image", "file": "../a.png"}}}', "/textures/a/file",
         "leads out"),
        ('{"lights": [{"type": "environment", "file": "a.exr"}]}', "/lights/0/file",
         "does not exist"),
    ],
)  # fmt: skip
def test_errors_say_where(
    load_text: LoadText, text: str, pointer: str | None, message: str
) -> None:
    with pytest.raises(SceneError) as caught:
        load_text("scene.json", text)
    assert message in str(caught.value)
    assert caught.value.pointer == pointer
    assert caught.value.file is not None


def test_mesh_files_are_read_and_images_are_found(tmp_path: Path, load_text: LoadText) -> None:
    (tmp_path / "a.png").touch()
    text = json.dumps(
        {
            "textures": {"a": {"type": "image", "file": "./a.png"}},
            "shapes": [{"type": "mesh", "file": "m.obj", "material": "m", "flip_normals": True}],
            "groups": {"g": [{"type": "mesh", "file": "m.obj"}]},
            "materials": {"m": {"type": "diffuse"}},
        }
    )
    scene = load_text("scene.json", text, m__obj="v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    for mesh in (scene.shapes[0], scene.groups["g"][0]):
        assert isinstance(mesh, Mesh)
        assert mesh.file is None
        assert mesh.faces is not None
        assert mesh.faces.tolist() == [[0, 1, 2]]
    assert isinstance(scene.shapes[0], Mesh)
    assert (scene.shapes[0].material, scene.shapes[0].flip_normals) == ("m", True)
    image = scene.textures["a"]
    assert isinstance(image, ImageTexture)
    assert image.file == "a.png"


def test_a_broken_mesh_file_is_named(load_text: LoadText) -> None:
    text = '{"shapes": [{"type": "mesh", "file": "m.obj"}]}'
    with pytest.raises(SceneError, match="'v' number 9 of 1") as caught:
        load_text("scene.json", text, m__obj="v 0 0 0\nf 1 1 9\n")
    assert str(caught.value.file).endswith("m.obj")


def test_an_editors_schema_line_is_ignored(load_text: LoadText) -> None:
    assert load_text("scene.json", '{"$schema": "scene.schema.json"}').shapes == []

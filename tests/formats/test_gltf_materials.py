"""glTF materials and textures."""

from __future__ import annotations

import json
import math
import struct
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from gltf_builder import TRIANGLE, Gltf
from numpy.testing import assert_allclose
from raykiln.errors import SceneError
from raykiln.formats import load, side_files
from raykiln.scene import (
    Diffuse,
    ImageTexture,
    Mesh,
    Principled,
    Scene,
    TextureRef,
)

UV = np.array([[0, 0], [1, 0], [0, 1]], np.float32)


def png(pixels: Any) -> bytes:
    """An 8-bit PNG of an array (height, width, 3 or 4)."""

    def chunk(kind: bytes, data: bytes) -> bytes:
        return (
            struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
        )

    height, width, channels = pixels.shape
    header = struct.pack(">IIBBBBB", width, height, 8, {3: 2, 4: 6}[channels], 0, 0, 0)
    rows = b"".join(b"\0" + row.tobytes() for row in pixels)
    return b"".join(
        [b"\x89PNG\r\n\x1a\n", chunk(b"IHDR", header), chunk(b"IDAT", zlib.compress(rows)),
         chunk(b"IEND", b"")]
    )  # fmt: skip


PIXELS = np.arange(24, dtype=np.uint8).reshape(2, 3, 4) * 10


def textured(material: dict[str, Any], sets: int = 1, textures: int = 1) -> Gltf:
    """A triangle with a material; every texture has the same embedded image."""
    gltf = Gltf()
    coordinates = {f"TEXCOORD_{i}": gltf.accessor(UV * (i + 1)) for i in range(sets)}
    gltf.node(mesh=gltf.mesh(TRIANGLE, attributes=coordinates, material=0))
    gltf.append("materials", material)
    view = gltf.view(png(PIXELS))
    gltf.append("images", {"bufferView": view, "mimeType": "image/png", "name": "picture"})
    for _ in range(textures):
        gltf.append("textures", {"source": 0})
    return gltf


def only_material(scene: Scene) -> Any:
    (mesh,) = scene.shapes
    assert isinstance(mesh, Mesh)
    return scene.materials[mesh.material or ""]


def read(tmp_path: Path, gltf: Gltf) -> Scene:
    return load(gltf.save_glb(tmp_path / "a.glb"))


def test_the_default_material_is_white_metal_and_rough(tmp_path: Path) -> None:
    gltf = Gltf()
    gltf.node(mesh=gltf.mesh(TRIANGLE))
    material = only_material(read(tmp_path, gltf))
    assert isinstance(material, Principled)
    assert (material.base_color, material.metallic, material.roughness) == ((1, 1, 1), 1, 1)
    assert material.ior == 1.5


def test_all_textures_of_metallic_roughness(tmp_path: Path) -> None:
    gltf = textured(
        {
            "name": "paint",
            "pbrMetallicRoughness": {
                "baseColorFactor": [0.5, 0.6, 0.7, 0.8],
                "baseColorTexture": {"index": 0},
                "metallicFactor": 0.25,
                "roughnessFactor": 0.75,
                "metallicRoughnessTexture": {"index": 1},
            },
            "normalTexture": {"index": 2, "scale": 0.5},
            "occlusionTexture": {"index": 3},
            "emissiveTexture": {"index": 4},
            "emissiveFactor": [1, 0.5, 0],
            "extensions": {"KHR_materials_emissive_strength": {"emissiveStrength": 4}},
            "doubleSided": True,
        },
        textures=5,
    )
    scene = read(tmp_path, gltf)
    paint = only_material(scene)
    assert isinstance(paint.base_color, TextureRef)
    assert paint.base_color.factor == (0.5, 0.6, 0.7)
    assert (paint.metallic.channel, paint.metallic.factor) == ("b", 0.25)
    assert (paint.roughness.channel, paint.roughness.factor) == ("g", 0.75)
    assert paint.metallic.texture == paint.roughness.texture
    assert paint.normal_map.scale == 0.5
    (mesh,) = scene.shapes
    assert isinstance(mesh, Mesh)
    assert mesh.emission is not None
    assert isinstance(mesh.emission.radiance, TextureRef)
    assert mesh.emission.radiance.factor == (4, 2, 0)
    assert mesh.emission.two_sided
    spaces = {
        paint.base_color.texture: "srgb",
        paint.metallic.texture: "linear",
        paint.normal_map.texture: "linear",
        mesh.emission.radiance.texture: "srgb",
    }
    assert {name: scene.textures[name].model_dump()["color_space"] for name in spaces} == spaces
    assert any("occlusion" in warning for warning in scene.warnings)
    assert paint.opacity == 1


def test_embedded_images_are_decoded(tmp_path: Path) -> None:
    gltf = textured({"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}})
    (texture,) = read(tmp_path, gltf).textures.values()
    assert isinstance(texture, ImageTexture)
    assert texture.pixels is not None
    assert texture.pixels.dtype == np.uint8
    assert np.array_equal(texture.pixels, PIXELS)


def test_images_beside_the_file_stay_files(tmp_path: Path) -> None:
    gltf = textured({"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}})
    gltf.json["images"] = [{"uri": "sub%20folder/a.png"}]
    with pytest.raises(SceneError, match="/images/0/uri: the file does not exist"):
        read(tmp_path, gltf)
    (tmp_path / "sub folder").mkdir()
    (tmp_path / "sub folder" / "a.png").write_bytes(png(PIXELS))
    (texture,) = read(tmp_path, gltf).textures.values()
    assert isinstance(texture, ImageTexture)
    assert texture.file == "sub folder/a.png"
    assert side_files(tmp_path / "a.glb") == {(tmp_path / "sub folder" / "a.png").resolve()}


def test_an_embedded_image_that_is_none_is_an_error(tmp_path: Path) -> None:
    gltf = textured({"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}})
    gltf.json["images"] = [{"uri": "data:image/png;base64,QUJD"}]
    with pytest.raises(SceneError, match="/images/0: the embedded image"):
        read(tmp_path, gltf)


def test_samplers(tmp_path: Path) -> None:
    gltf = textured({"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}})
    gltf.json["samplers"] = [{"wrapS": 33071, "wrapT": 33648, "magFilter": 9728}]
    gltf.json["textures"][0]["sampler"] = 0
    (texture,) = read(tmp_path, gltf).textures.values()
    assert isinstance(texture, ImageTexture)
    assert (texture.wrap_u, texture.wrap_v, texture.filter) == ("clamp", "mirror", "nearest")


def test_of_many_embedded_images_each_is_its_own_and_a_bad_one_is_named(tmp_path: Path) -> None:
    gltf = textured({})
    gltf.json["images"] = [{"bufferView": gltf.view(png(PIXELS + i))} for i in range(5)]
    gltf.json["textures"] = [{"source": i} for i in range(5)]
    gltf.json["materials"] = [
        {"pbrMetallicRoughness": {"baseColorTexture": {"index": i}}} for i in range(5)
    ]
    for i in range(1, 5):
        coordinates = {"TEXCOORD_0": gltf.accessor(UV)}
        gltf.node(mesh=gltf.mesh(TRIANGLE, attributes=coordinates, material=i))
    for i, texture in enumerate(read(tmp_path, gltf).textures.values()):
        assert isinstance(texture, ImageTexture)
        assert texture.pixels is not None
        assert np.array_equal(texture.pixels, PIXELS + i)
    gltf.json["images"][3] = {"bufferView": gltf.view(b"no image")}
    with pytest.raises(SceneError, match="/images/3: the embedded image cannot be read"):
        read(tmp_path, gltf)


def test_texture_transforms_turn_the_image_clockwise(tmp_path: Path) -> None:
    """As Khronos' TextureTransformTest shows: its arrow points at its green mark."""
    turn = {"offset": [0.5, 0.25], "scale": [2, 3], "rotation": math.pi / 2}
    info = {"index": 0, "extensions": {"KHR_texture_transform": turn}}
    gltf = textured({"pbrMetallicRoughness": {"baseColorTexture": info}})
    (texture,) = read(tmp_path, gltf).textures.values()
    matrix = np.array(texture.uv_transform)
    assert_allclose(matrix @ [0, 0, 1], [0.5, 0.25], atol=1e-12)
    # u runs up the image (against v), v runs to the right.
    assert_allclose(matrix @ [1, 0, 1], [0.5, 0.25 - 2], atol=1e-12)
    assert_allclose(matrix @ [0, 1, 1], [0.5 + 3, 0.25], atol=1e-12)


def test_the_arrow_of_the_transform_test_points_at_its_mark(shared_assets: Path) -> None:
    folder = shared_assets / "gltf/draco/KhronosSampleModels/TextureTransformTest/glTF"
    scene = load(folder / "TextureTransformTest.gltf")
    document = json.loads((folder / "TextureTransformTest.gltf").read_text())
    mark = next(n for n in document["nodes"] if n["name"] == "Rotation - Correct")
    uv = np.array([0.5 + mark["translation"][0], 0.5 - mark["translation"][1], 1])
    rotated = scene.materials["Rotation"]
    assert isinstance(rotated, Principled)
    assert isinstance(rotated.base_color, TextureRef)
    place = np.array(scene.textures[rotated.base_color.texture].uv_transform) @ uv
    # The arrow of the image lies on its diagonal and ends before (0.78, 0.78).
    assert_allclose(place, [0.778, 0.778], atol=2e-3)


def test_the_set_of_coordinates_that_the_material_uses(tmp_path: Path) -> None:
    info = {"index": 0, "texCoord": 1}
    scene = read(tmp_path, textured({"pbrMetallicRoughness": {"baseColorTexture": info}}, sets=2))
    (mesh,) = scene.shapes
    assert isinstance(mesh, Mesh)
    assert_allclose(np.array(mesh.uvs), UV * 2)
    mixed = {"pbrMetallicRoughness": {"baseColorTexture": info}, "normalTexture": {"index": 0}}
    scene = read(tmp_path, textured(mixed, sets=2))
    assert any("different sets" in warning for warning in scene.warnings)


@pytest.mark.parametrize(
    ("mode", "cutoff", "expected"),
    [(None, None, (1.0, None)), ("BLEND", None, ("a", None)), ("MASK", None, ("a", 0.5)),
     ("MASK", 0.25, ("a", 0.25)), ("MASK", 2.0, (0.0, None))],
)  # fmt: skip
def test_alpha_modes(tmp_path: Path, mode: Any, cutoff: Any, expected: Any) -> None:
    material: dict[str, Any] = {"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}
    if mode:
        material["alphaMode"] = mode
    if cutoff is not None:
        material["alphaCutoff"] = cutoff
    found = only_material(read(tmp_path, textured(material)))
    opacity = found.opacity.channel if isinstance(found.opacity, TextureRef) else found.opacity
    assert (opacity, found.alpha_cutoff) == expected


def test_material_extensions(tmp_path: Path) -> None:
    gltf = textured(
        {
            "extensions": {
                "KHR_materials_ior": {"ior": 1.33},
                "KHR_materials_specular": {"specularFactor": 0.5, "specularColorFactor": [2, 1, 0]},
                "KHR_materials_transmission": {"transmissionFactor": 0.75},
                "KHR_materials_clearcoat": {"clearcoatFactor": 1},
            }
        }
    )
    scene = read(tmp_path, gltf)
    found = only_material(scene)
    assert (found.ior, found.specular, found.specular_color) == (1.33, 0.5, (2, 1, 0))
    assert found.transmission == 0.75
    assert any("KHR_materials_clearcoat is not supported" in w for w in scene.warnings)


def test_unlit_materials_give_off_their_colour(tmp_path: Path) -> None:
    pbr = {"baseColorFactor": [0.25, 0.5, 1, 1]}
    gltf = textured({"pbrMetallicRoughness": pbr, "extensions": {"KHR_materials_unlit": {}}})
    scene = read(tmp_path, gltf)
    found = only_material(scene)
    assert isinstance(found, Diffuse)
    assert found.reflectance == 0
    (mesh,) = scene.shapes
    assert isinstance(mesh, Mesh)
    assert mesh.emission is not None
    assert mesh.emission.radiance == (0.25, 0.5, 1)


def test_one_vertex_colour_tints_and_many_are_said_not_to(tmp_path: Path) -> None:
    for colors, base in (([[0.5, 1, 1]] * 3, (0.5, 1, 1)), (np.eye(3), (1, 1, 1))):
        gltf = Gltf()
        attribute = {"COLOR_0": gltf.accessor(np.array(colors, np.float32))}
        gltf.node(mesh=gltf.mesh(TRIANGLE, attributes=attribute))
        scene = read(tmp_path, gltf)
        assert only_material(scene).base_color == base
        assert any("vertex colours" in w for w in scene.warnings) == (base == (1, 1, 1))


def test_a_texture_without_a_readable_image_is_said(tmp_path: Path) -> None:
    gltf = textured({"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}})
    gltf.json["textures"] = [{"extensions": {"KHR_texture_basisu": {"source": 0}}}]
    scene = read(tmp_path, gltf)
    assert only_material(scene).base_color == (1, 1, 1)
    assert any("no image that can be read" in warning for warning in scene.warnings)


@pytest.mark.parametrize(
    ("material", "pointer"),
    [
        ({"pbrMetallicRoughness": {"baseColorTexture": {"index": 9}}},
         "/materials/0/pbrMetallicRoughness/baseColorTexture/index"),
        ({"pbrMetallicRoughness": {"baseColorTexture": {}}},
         "/materials/0/pbrMetallicRoughness/baseColorTexture/index"),
        ({"pbrMetallicRoughness": {"baseColorFactor": [1, 1, 1]}},
         "/materials/0/pbrMetallicRoughness/baseColorFactor"),
        ({"pbrMetallicRoughness": {"metallicFactor": "much"}},
         "/materials/0/pbrMetallicRoughness/metallicFactor"),
        ({"alphaMode": "SOFT"}, "/materials/0/alphaMode"),
        ({"doubleSided": 1}, "/materials/0/doubleSided"),
        ({"extensions": {"KHR_materials_emissive_strength": {"emissiveStrength": -1}}},
         "/materials/0/extensions/KHR_materials_emissive_strength"),
    ],
)  # fmt: skip
def test_broken_materials_say_where(tmp_path: Path, material: dict[str, Any], pointer: str) -> None:
    with pytest.raises(SceneError) as caught:
        read(tmp_path, textured(material))
    assert caught.value.pointer == pointer

"""Mitsuba XML: structure, parameters, references, old versions, errors."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from format_support import LoadText
from numpy.testing import assert_allclose
from raykiln.errors import SceneError
from raykiln.formats import load
from raykiln.formats.mitsuba_upgrade import snake_case
from raykiln.scene import (
    CheckerTexture,
    Conductor,
    ConstantLight,
    Dielectric,
    Diffuse,
    DirectionalLight,
    EnvironmentLight,
    ImageTexture,
    Instance,
    Mesh,
    Plastic,
    PointLight,
    Principled,
    Rectangle,
    Scene,
    Sphere,
    SpotLight,
    TextureRef,
)


def scene_xml(body: str, version: str = "3.0.0") -> str:
    return f'<scene version="{version}">\n{body}\n</scene>'


def bsdf_of(scene: Scene) -> Any:
    (shape,) = scene.shapes
    return scene.materials[shape.material]  # type: ignore[union-attr, index]


def own_warnings(scene: Scene) -> list[str]:
    """Without those of the studio."""
    return [w for w in scene.warnings if not w.startswith("the scene has no")]


def test_defaults_are_those_of_mitsuba(load_text: LoadText) -> None:
    body = '<sensor type="perspective"/><shape type="sphere"/><integrator type="path"/>'
    scene = load_text("a.xml", scene_xml(body))
    assert scene.settings == {
        "width": 768, "height": 576, "integrator": "path", "max_depth": -1, "rr_depth": 5,
    }  # fmt: skip
    material = bsdf_of(scene)
    assert isinstance(material, Diffuse)
    assert (material.reflectance, material.two_sided) == (0.5, False)


def test_film_sampler_and_integrator(load_text: LoadText) -> None:
    body = """
    <integrator type="aov"><string name="aovs" value="n:sh_normal, dd:depth, u:uv"/>
      <integrator type="volpath"><integer name="max_depth" value="7"/>
        <integer name="rr_depth" value="9"/><boolean name="hide_emitters" value="true"/>
      </integrator>
    </integrator>
    <sensor type="thinlens"><float name="fov" value="33"/><string name="fov_axis" value="diagonal"/>
      <sampler type="multijitter"><integer name="sample_count" value="49"/></sampler>
      <film type="hdrfilm"><integer name="width" value="320"/><integer name="height" value="200"/>
        <integer name="crop_offset_x" value="10"/><integer name="crop_width" value="100"/>
        <integer name="crop_offset_y" value="20"/><integer name="crop_height" value="50"/>
        <rfilter type="mitchell"/></film>
    </sensor>"""
    scene = load_text("a.xml", scene_xml(body))
    assert scene.settings == {
        "width": 320, "height": 200, "crop": (10, 20, 110, 70), "spp": 49, "filter": "gaussian",
        "integrator": "path", "max_depth": 7, "rr_depth": 9, "aovs": ["normal", "depth"],
    }  # fmt: skip
    assert (scene.cameras[0].fov_deg, scene.cameras[0].fov_axis) == (33, "diagonal")
    for words in ("hide_emitters", "depth of field", "filter", "'uv'"):
        assert any(words in warning for warning in scene.warnings), words


@pytest.mark.parametrize(
    ("given", "ours"), [("direct", "direct"), ("ao", "ao"), ("path", "path"), ("bdpt", "path")]
)
def test_integrators(load_text: LoadText, given: str, ours: str) -> None:
    scene = load_text("a.xml", scene_xml(f'<integrator type="{given}"/>'))
    assert scene.settings["integrator"] == ours
    assert bool(own_warnings(scene)) == (given == "bdpt")


def test_parameters_references_aliases_and_includes(tmp_path: Path, load_text: LoadText) -> None:
    (tmp_path / "parts").mkdir()
    (tmp_path / "parts" / "more.xml").write_text(
        '<scene version="3.0.0"><default name="r" value="9"/>'
        '<shape type="sphere" id="included"><float name="radius" value="$r.5"/>'
        '<ref id="later"/></shape></scene>'
    )
    body = """
    <default name="r" value="2"/><default name="red" value="1"/>
    <include filename="parts/more.xml"/>
    <shape type="sphere"><float name="radius" value="$red"/><ref id="other"/></shape>
    <bsdf type="diffuse" id="later"><rgb name="reflectance" value="$red, 0, 0"/></bsdf>
    <alias id="later" as="other"/>
    <shape type="sphere"><string name="id" value="cost \\$5"/></shape>"""
    scene = load_text("a.xml", scene_xml(body))
    radii = [shape.radius for shape in scene.shapes if isinstance(shape, Sphere)]
    assert radii == [2.5, 1, 1]
    assert [s.material for s in scene.shapes if isinstance(s, Sphere)][:2] == ["later", "later"]
    assert scene.materials["later"].model_dump()["reflectance"] == (1, 0, 0)


BSDFS: list[tuple[str, type, dict[str, Any]]] = [
    ('<bsdf type="dielectric"><string name="int_ior" value="diamond"/></bsdf>', Dielectric,
     {"int_ior": 2.419, "ext_ior": 1.000277, "alpha": 0.0, "thin": False}),
    ('<bsdf type="thindielectric"/>', Dielectric, {"int_ior": 1.5046, "thin": True}),
    ('<bsdf type="roughdielectric"><float name="int_ior" value="1.4"/></bsdf>', Dielectric,
     {"int_ior": 1.4, "alpha": 0.1, "distribution": "beckmann"}),
    ('<bsdf type="conductor"/>', Conductor, {"metal": None, "eta": 0.0, "k": 1.0, "alpha": 0.0}),
    ('<bsdf type="roughconductor"><string name="material" value="Au"/><string name="distribution"'
     ' value="ggx"/><float name="alpha_u" value=".2"/><float name="alpha_v" value=".3"/></bsdf>',
     Conductor, {"metal": "Au", "alpha": 0.2, "alpha_v": 0.3, "distribution": "ggx"}),
    ('<bsdf type="roughconductor"><rgb name="eta" value="1 2 3"/><spectrum name="k" value="4"/>'
     "</bsdf>", Conductor, {"eta": (1, 2, 3), "k": 4.0, "metal": None}),
    ('<bsdf type="plastic"><boolean name="nonlinear" value="true"/></bsdf>', Plastic,
     {"int_ior": 1.49, "diffuse_reflectance": 0.5, "nonlinear": True, "alpha": 0.0}),
    ('<bsdf type="roughplastic"/>', Plastic, {"alpha": 0.1, "distribution": "beckmann"}),
    ('<bsdf type="principled"><float name="specular" value="0.5"/></bsdf>', Principled,
     {"base_color": 0.5, "roughness": 0.5, "metallic": 0.0}),
    ('<bsdf type="twosided"><bsdf type="diffuse"/></bsdf>', Diffuse, {"two_sided": True}),
    ('<bsdf type="mask"><float name="opacity" value="0.25"/><bsdf type="diffuse"/></bsdf>',
     Diffuse, {"opacity": 0.25, "two_sided": False}),
    ('<bsdf type="null"/>', Diffuse, {"opacity": 0.0}),
]  # fmt: skip


@pytest.mark.parametrize(("xml", "kind", "fields"), BSDFS)
def test_bsdfs(load_text: LoadText, xml: str, kind: type, fields: dict[str, Any]) -> None:
    scene = load_text("a.xml", scene_xml(f'<shape type="sphere">{xml}</shape>'))
    material = bsdf_of(scene)
    assert type(material) is kind
    assert {name: getattr(material, name) for name in fields} == fields
    assert own_warnings(scene) == []


@pytest.mark.parametrize(
    ("xml", "words"),
    [
        ('<bsdf type="hair"/>', "not supported"),
        ('<bsdf type="bumpmap"><texture type="checkerboard"/><bsdf type="diffuse"/></bsdf>',
         "the BSDF inside"),
        ('<bsdf type="blendbsdf"><float name="weight" value="0.7"/><bsdf type="plastic"/>'
         '<bsdf type="diffuse"/></bsdf>', "blends are not supported"),
        ('<bsdf type="twosided"><bsdf type="diffuse"/><bsdf type="plastic"/></bsdf>',
         "two different sides"),
        ('<bsdf type="diffuse"><float name="fluffiness" value="1"/></bsdf>', "'fluffiness'"),
        ('<bsdf type="principled"><float name="sheen" value="1"/></bsdf>', "'sheen'"),
        ('<bsdf type="diffuse"><texture type="perlin" name="reflectance"/></bsdf>',
         "texture is not supported"),
        ('<bsdf type="roughdielectric"><string name="distribution" value="phong"/></bsdf>',
         "rendered as beckmann"),
        ('<bsdf type="diffuse"><rgb name="reflectance" value="2 0 0"/></bsdf>', "over 1"),
    ],
)  # fmt: skip
def test_what_is_not_supported_is_said_with_its_line(
    load_text: LoadText, xml: str, words: str
) -> None:
    scene = load_text("a.xml", scene_xml(f'<shape type="sphere">\n{xml}</shape>'))
    (warning,) = own_warnings(scene)
    assert words in warning
    assert warning.startswith("line 3, ")


def test_textures(tmp_path: Path, load_text: LoadText) -> None:
    for name in ("a.png", "b.exr"):
        (tmp_path / name).touch()
    body = """
    <texture type="bitmap" id="photo"><string name="filename" value="a.png"/>
      <string name="filter_type" value="nearest"/><string name="wrap_mode" value="mirror"/>
    </texture>
    <texture type="bitmap" id="data"><string name="filename" value="a.png"/>
      <boolean name="raw" value="true"/></texture>
    <texture type="bitmap" id="hdr"><string name="filename" value="b.exr"/></texture>
    <texture type="checkerboard" id="squares"><rgb name="color0" value="1 0 0"/>
      <transform name="to_uv"><scale x="8" y="4"/><translate x="0.5"/></transform></texture>
    <shape type="sphere"><bsdf type="roughplastic">
      <ref id="photo" name="diffuse_reflectance"/><ref id="hdr" name="specular_reflectance"/>
      </bsdf></shape>
    <shape type="sphere"><bsdf type="normalmap"><ref name="normalmap" id="data"/>
      <bsdf type="diffuse"><ref name="reflectance" id="squares"/></bsdf></bsdf></shape>"""
    scene = load_text("a.xml", scene_xml(body))
    images = {k: v for k, v in scene.textures.items() if isinstance(v, ImageTexture)}
    assert {k: (v.file, v.color_space) for k, v in images.items()} == {
        "photo": ("a.png", "srgb"), "data": ("a.png", "linear"), "hdr": ("b.exr", "linear"),
    }  # fmt: skip
    assert (images["photo"].filter, images["photo"].wrap_u) == ("nearest", "mirror")
    squares = scene.textures["squares"]
    assert isinstance(squares, CheckerTexture)
    assert (squares.color0, squares.color1) == ((1, 0, 0), 0.2)
    assert squares.uv_transform == ((8, 0, 0.5), (0, 4, 0))
    second = scene.shapes[1]
    assert isinstance(second, Sphere)
    mapped = scene.materials[second.material or ""]
    assert isinstance(mapped, Diffuse)
    assert mapped.normal_map is not None
    assert mapped.normal_map.texture == "data"
    assert isinstance(mapped.reflectance, TextureRef)


def test_emitters(tmp_path: Path, load_text: LoadText) -> None:
    (tmp_path / "sky.exr").touch()
    body = """
    <shape type="rectangle"><emitter type="area"><rgb name="radiance" value="1 2 3"/></emitter>
    </shape>
    <emitter type="point"><point name="position" x="1" y="2" z="3"/></emitter>
    <emitter type="spot"><transform name="to_world"><lookat origin="0,5,0" target="0,0,0"
       up="0,0,1"/></transform><rgb name="intensity" value="5"/></emitter>
    <emitter type="directional"><vector name="direction" value="0 -1 0"/>
       <rgb name="irradiance" value="4"/></emitter>
    <emitter type="constant"><rgb name="radiance" value="0.5"/></emitter>
    <emitter type="envmap"><string name="filename" value="sky.exr"/><float name="scale" value="2"/>
       </emitter>
    <emitter type="sunsky"/>"""
    scene = load_text("a.xml", scene_xml(body))
    (lamp,) = scene.shapes
    assert isinstance(lamp, Rectangle)
    assert lamp.emission is not None
    assert (lamp.emission.radiance, lamp.emission.two_sided) == ((1, 2, 3), False)
    point, spot, sun, constant, sky = scene.lights
    assert isinstance(point, PointLight)
    assert point.position == (1, 2, 3)
    assert isinstance(spot, SpotLight)
    assert (spot.position, spot.outer_angle_deg, spot.inner_angle_deg) == ((0, 5, 0), 20, 15)
    assert_allclose(spot.direction, [0, -1, 0])
    assert isinstance(sun, DirectionalLight)
    assert (sun.direction, sun.irradiance) == ((0, -1, 0), (4, 4, 4))
    assert isinstance(constant, ConstantLight)
    assert isinstance(sky, EnvironmentLight)
    assert (sky.file, sky.scale) == ("sky.exr", 2)
    assert any("sunsky: this emitter is not supported" in w for w in scene.warnings)


def test_shapes_groups_and_instances(load_text: LoadText) -> None:
    body = """
    <shape type="shapegroup" id="tree"><shape type="sphere"/><shape type="cube"/></shape>
    <shape type="instance"><ref id="tree"/><transform name="to_world"><translate x="5"/></transform>
    </shape>
    <shape type="instance"><ref id="tree"/></shape>
    <shape type="disk"/><shape type="cylinder"/>
    <shape type="sphere"><point name="center" x="1" y="2" z="3"/><float name="radius" value="4"/>
      <boolean name="flip_normals" value="true"/></shape>"""
    scene = load_text("a.xml", scene_xml(body))
    disk, sphere, instance = scene.shapes
    assert disk.type == "disk"
    assert isinstance(sphere, Sphere)
    assert (sphere.center, sphere.radius, sphere.flip_normals) == ((1, 2, 3), 4, True)
    assert isinstance(instance, Instance)
    assert instance.group == "tree"
    assert instance.transforms[:, 0, 3].tolist() == [5, 0]
    assert [shape.type for shape in scene.groups["tree"]] == ["sphere", "cube"]
    assert any("cylinder: this shape is not supported" in w for w in scene.warnings)


def test_steps_of_a_transform_apply_in_order(load_text: LoadText) -> None:
    steps = """<shape type="rectangle"><transform name="to_world"><scale value="2"/>
      <rotate z="1" angle="90"/><translate x="10"/><matrix value="1 0 0 0 0 1 0 0 0 0 1 7 0 0 0 1"/>
      <matrix value="1 0 0 0 1 0 0 0 1"/></transform></shape>"""
    (shape,) = load_text("a.xml", scene_xml(steps)).shapes
    assert isinstance(shape, Rectangle)
    moved = np.array(shape.transform) @ [1, 0, 0, 1]
    assert_allclose(moved, [10, 2, 7, 1], atol=1e-12)


@pytest.mark.parametrize(
    ("old", "new"),
    [("toWorld", "to_world"), ("intIOR", "int_ior"), ("maxDepth", "max_depth"),
     ("diffuseReflectance", "diffuse_reflectance"), ("alpha", "alpha"), ("uscale", "uscale"),
     ("flipTexCoords", "flip_tex_coords"), ("id2D", "id2D")],
)  # fmt: skip
def test_old_names(old: str, new: str) -> None:
    assert snake_case(old) == new


def test_an_old_scene(load_text: LoadText) -> None:
    body = """
    <integrator type="path"><integer name="maxDepth" value="4"/></integrator>
    <sensor type="perspective"><string name="fovAxis" value="smaller"/>
      <float name="fov" value="30"/>
      <transform name="toWorld"><lookAt origin="0,0,5" target="0,0,0" up="0,1,0"/></transform>
      <sampler type="ldsampler"><integer name="sampleCount" value="16"/></sampler></sensor>
    <shape type="sphere"><bsdf type="diffuse"><texture type="checkerboard" name="reflectance">
      <float name="uscale" value="8"/><float name="voffset" value="0.5"/>
      <srgb name="color0" value="#ff8000"/></texture></bsdf></shape>
    <shape type="sphere"><bsdf type="diffuse">
      <spectrum name="diffuseReflectance" value="0.25"/></bsdf></shape>"""
    scene = load_text("a.xml", scene_xml(body, "0.5.0"))
    assert own_warnings(scene) == []
    assert (scene.settings["max_depth"], scene.settings["spp"]) == (4, 16)
    assert scene.cameras[0].fov_axis == "smaller"
    assert_allclose(np.array(scene.cameras[0].transform)[:3, 3], [0, 0, 5])
    (texture,) = scene.textures.values()
    assert isinstance(texture, CheckerTexture)
    assert texture.uv_transform == ((8, 0, 0), (0, 1, 0.5))
    assert_allclose(np.array(texture.color0), [1, 0.2158605, 0], atol=1e-6)
    second = scene.shapes[1]
    assert isinstance(second, Sphere)
    material = scene.materials[second.material or ""]
    assert isinstance(material, Diffuse)
    assert material.reflectance == 0.25


ERRORS: list[tuple[str, str, str]] = [
    ("<shape", "not XML", "line 3, column 1"),
    ("<shape></bsdf>", "not XML: mismatched tag", "line 2, column 10"),
    ("<form/>", "not a known element", "line 2"),
    ('<ref id="nothing"/>', "a reference to nothing", "line 2"),
    ('<bsdf type="twosided" id="a"><ref id="a"/></bsdf>', "refers to itself", "line 2"),
    ('<bsdf type="diffuse" id="a"/><bsdf type="diffuse" id="a"/>', "given twice", "line 2"),
    ('<alias id="a" as="b"/>', "an alias of nothing", "line 2"),
    ('<include filename="a.xml"/>', "(nested) includes", "line 2"),
    ('<include filename="/etc/hostname"/>', "absolute path", "line 2"),
    ('<include filename="../a.xml"/>', "leads out", "line 2"),
    ('<path value=".."/>', "not a folder inside", "line 2"),
    ('<shape type="$none"/>', "without a default", "line 2"),
    ('<shape type="sphere"><float name="radius" value="wide"/></shape>', "not finite", "line 2"),
    ('<shape type="sphere"><float name="radius" value="-1"/></shape>', "positive", "line 2"),
    ('<shape type="sphere"><float name="radius" value="nan"/></shape>', "not finite", "line 2"),
    ('<shape type="sphere"><string name="radius" value="1"/></shape>', "another type", "line 2"),
    ('<shape type="obj"><string name="filename" value="no.obj"/></shape>', "not exist", "line 2"),
    ('<shape type="obj"><string name="filename" value="../a.obj"/></shape>', "leads out", "line 2"),
    ('<shape type="rectangle"><transform name="to_world"><spin/></transform></shape>',
     "not a transform", "line 2"),
    ('<shape type="rectangle"><transform name="to_world"><matrix value="1 2"/></transform></shape>',
     "9 or 16", "line 2"),
    ('<shape type="rectangle"><transform name="to_world"><rotate angle="5"/></transform></shape>',
     "an axis other than zero", "line 2"),
    ('<shape type="rectangle"><transform name="to_world"><lookat origin="0,0,0" target="0,1,0"'
     ' up="0,1,0"/></transform></shape>', "on one line", "line 2"),
    ('<sensor type="perspective"><float name="fov" value="180"/></sensor>', "between 0", "line 2"),
    ('<sensor type="perspective"><string name="fov_axis" value="z"/></sensor>', "axis", "line 2"),
    ('<shape type="sphere"><bsdf type="dielectric"><string name="int_ior" value="jelly"/></bsdf>'
     "</shape>", "not a known material", "line 2"),
    ('<shape type="sphere"><bsdf type="conductor"><string name="material" value="Xx"/></bsdf>'
     "</shape>", "not a known metal", "line 2"),
    ('<shape type="sphere"><bsdf type="diffuse"><rgb name="reflectance" value="1 2"/></bsdf>'
     "</shape>", "one or three", "line 2"),
    ('<shape type="sphere"><bsdf type="diffuse"><rgb name="reflectance" value="-1"/></bsdf>'
     "</shape>", "must not be negative", "line 2"),
    ('<shape type="sphere"><bsdf type="diffuse"><spectrum name="reflectance" value="500:1"/>'
     "</bsdf></shape>", "increasing wavelength", "line 2"),
    ('<shape type="sphere"><bsdf type="mask"/></shape>', "takes one BSDF", "line 2"),
    ('<shape type="instance"/>', "takes one shape group", "line 2"),
    ("<bsdf>" * 100 + "</bsdf>" * 100, "nested too deeply", "line 2"),
]  # fmt: skip


@pytest.mark.parametrize(("body", "message", "pointer"), ERRORS)
def test_errors_say_where(load_text: LoadText, body: str, message: str, pointer: str) -> None:
    with pytest.raises(SceneError) as caught:
        load_text("a.xml", scene_xml(body))
    assert message in caught.value.message
    assert (caught.value.pointer or "").startswith(pointer)
    assert str(caught.value.file).endswith("a.xml")


@pytest.mark.parametrize(
    "dtd",
    [
        '<!DOCTYPE scene [<!ENTITY a "aaaa"><!ENTITY b "&a;&a;&a;&a;">]>',
        '<!DOCTYPE scene SYSTEM "file:///etc/passwd">',
        '<!DOCTYPE scene [<!ENTITY x SYSTEM "file:///etc/passwd">]>',
    ],
)
def test_document_types_are_refused(load_text: LoadText, dtd: str) -> None:
    with pytest.raises(SceneError, match="is refused"):
        load_text("a.xml", f'{dtd}<scene version="3.0.0"/>')


def test_a_parameter_that_doubles_itself_stops(load_text: LoadText) -> None:
    body = "".join(
        f'<default name="p{i}" value="{f"$p{i - 1}" * 10 if i else "x" * 10}"/>' for i in range(12)
    )
    with pytest.raises(SceneError, match="too long a text"):
        load_text("a.xml", scene_xml(body))


def test_public_scenes_load_whole(shared_assets: Path) -> None:
    found = {}
    for path in [
        shared_assets / "bitterli-mitsuba/cornell-box/scene.xml",
        *sorted((shared_assets / "lajolla" / "scenes").rglob("*.xml")),
    ]:
        scene = load(path)
        assert scene.warnings == []
        triangles = [s.faces for s in scene.shapes if isinstance(s, Mesh)]
        found[path.stem] = (len(scene.shapes), sum(len(f) for f in triangles if f is not None))
    assert found == {
        "scene": (8, 0), "cbox": (8, 38), "matpreview": (3, 61_600), "mi": (10, 12),
    }  # fmt: skip


def test_includes_that_multiply_stop(tmp_path: Path) -> None:
    """Ten files, each of which includes the next ten times."""
    for i in range(10):
        body = f'<include filename="{i + 1}.xml"/>' * 10
        (tmp_path / f"{i}.xml").write_text(scene_xml(body))
    (tmp_path / "10.xml").write_text(scene_xml(""))
    with pytest.raises(SceneError, match="too many"):
        load(tmp_path / "0.xml")

"""From a scene description to a scene of the core: references resolved, images read, BVH built."""

from __future__ import annotations

import hashlib
import math
import time
from collections.abc import Iterable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from raykiln import _core, primitives, studio
from raykiln.errors import ImageError, SceneError, SettingsError
from raykiln.image import read_image
from raykiln.metals import METALS, optical_constants
from raykiln.scene import (
    CheckerTexture,
    ColorInput,
    Conductor,
    ConstantLight,
    Cube,
    Dielectric,
    Diffuse,
    DirectionalLight,
    Disk,
    Emission,
    EnvironmentLight,
    FloatInput,
    ImageTexture,
    Instance,
    Material,
    Mesh,
    PerspectiveCamera,
    Plastic,
    PointLight,
    Principled,
    Rectangle,
    Scene,
    Shape,
    Sphere,
    SpotLight,
    TextureRef,
    fov_y_rad,
    look_at_matrix,
)
from raykiln.settings import RenderSettings

Matrix = NDArray[np.float64]
Rgb = tuple[float, float, float]
DEFAULT_MATERIAL = Diffuse()


class CompiledScene(NamedTuple):
    """A scene that is ready to render."""

    core: _core.Scene
    sha256: str
    warnings: list[str]
    load_s: float
    """Reading images, transforming, handing over."""
    bvh_s: float
    """Building the hierarchies and the tables of the lights."""


def compile_scene(scene: Scene, settings: RenderSettings) -> CompiledScene:
    """Check a scene wholly and build it; raises `SceneError` at the first bad place."""
    start = time.perf_counter()
    if scene.shapes:
        # What was loaded from a file is complete already; this is for scenes made in code.
        scene = scene.model_copy(
            update={name: list(getattr(scene, name)) for name in ("cameras", "lights", "warnings")}
        )
        studio.complete(scene)
    compiler = _Compiler(scene)
    compiler.run(settings)
    loaded = time.perf_counter()
    compiler.core.build()
    return CompiledScene(
        compiler.core,
        scene_sha256(scene, compiler.files_read),
        [*scene.warnings, *compiler.warnings],
        loaded - start,
        time.perf_counter() - loaded,
    )


def scene_sha256(scene: Scene, files: Iterable[Path] = ()) -> str:
    """SHA-256 of all that the scene says, arrays and image files included."""
    digest = hashlib.sha256()
    _hash_value(digest, scene.model_dump(exclude={"base_dir", "warnings", "settings"}))
    for path in sorted(set(files)):
        digest.update(hashlib.sha256(path.read_bytes()).digest())
    return digest.hexdigest()


def _hash_value(digest: Any, value: Any) -> None:
    # Each kind of value opens with its own mark, so that no two scenes spell the same bytes.
    if isinstance(value, dict):
        digest.update(b"{%d" % len(value))
        for key, item in value.items():
            _hash_value(digest, key)
            _hash_value(digest, item)
    elif isinstance(value, list | tuple):
        digest.update(b"[%d" % len(value))
        for item in value:
            _hash_value(digest, item)
    elif isinstance(value, np.ndarray):
        digest.update(f"a{value.dtype}{value.shape}".encode())
        digest.update(np.ascontiguousarray(value).data)
    else:
        text = repr(value).encode()
        digest.update(b"v%d:" % len(text) + text)


class _Compiler:
    """One pass over a scene; `pointer` names the place that is being compiled."""

    def __init__(self, scene: Scene) -> None:
        self.scene = scene
        self.core = _core.Scene()
        self.warnings: list[str] = []
        self.files_read: list[Path] = []
        self._pixels: dict[str, NDArray[Any]] = {}
        self._textures: dict[tuple[str, bool], int] = {}
        self._materials: dict[str | None, int] = {}
        self._groups: dict[str, int] = {}

    def run(self, settings: RenderSettings) -> None:
        if not self.scene.shapes:
            raise SceneError("the scene is empty", pointer="/shapes", accepted="at least one shape")
        self._camera(settings)
        for name, material in self.scene.materials.items():
            self._materials[name] = self._material(material, f"/materials/{name}")
        for name in self.scene.textures:
            self._texture(name, color=False, pointer=f"/textures/{name}")
        for name, shapes in self.scene.groups.items():
            self._groups[name] = self.core.add_group()
            for i, shape in enumerate(shapes):
                self._shape(shape, self._groups[name], f"/groups/{name}/{i}")
        for i, shape in enumerate(self.scene.shapes):
            self._shape(shape, 0, f"/shapes/{i}")
        for i, light in enumerate(self.scene.lights):
            self._light(light, f"/lights/{i}")

    # Textures

    def _texture(self, name: str, *, color: bool, pointer: str) -> int:
        texture = self.scene.textures.get(name)
        if texture is None:
            raise SceneError(
                "no texture of this name",
                pointer=pointer,
                found=name,
                accepted=_names(self.scene.textures),
            )
        if isinstance(texture, CheckerTexture):
            color = False
        if (name, color) not in self._textures:
            self._textures[name, color] = self._add_texture(name, texture, color)
        return self._textures[name, color]

    def _add_texture(self, name: str, texture: ImageTexture | CheckerTexture, color: bool) -> int:
        if isinstance(texture, CheckerTexture):
            return self.core.add_checker_texture(
                _rgb(texture.color0), _rgb(texture.color1), texture.uv_transform
            )
        if name not in self._pixels:
            self._pixels[name] = self._image(texture, f"/textures/{name}")
        pixels = self._pixels[name]
        srgb = texture.color_space == "srgb" or (
            texture.color_space == "auto" and color and pixels.dtype != np.float32
        )
        if srgb and pixels.dtype != np.uint8:
            pixels, srgb = _linear_of_srgb(pixels), False
        return self.core.add_image_texture(
            pixels,
            srgb=srgb,
            filter=texture.filter,
            wrap_u=texture.wrap_u,
            wrap_v=texture.wrap_v,
            uv_transform=texture.uv_transform,
        )

    def _image(self, node: ImageTexture | EnvironmentLight, pointer: str) -> NDArray[Any]:
        if node.pixels is not None:
            return node.pixels
        assert node.file is not None
        path = self._path(node.file, f"{pointer}/file")
        self.files_read.append(path)
        try:
            return np.ascontiguousarray(read_image(path))
        except ImageError as error:
            raise SceneError(str(error), pointer=f"{pointer}/file", found=node.file) from None

    def _path(self, file: str, pointer: str) -> Path:
        root = (self.scene.base_dir or Path.cwd()).resolve()
        path = (root / file).resolve()
        if not path.is_relative_to(root):
            raise SceneError(
                "a file outside the scene's folder", pointer=pointer, found=file,
                accepted="a relative path inside it",
            )
        if not path.is_file():
            raise SceneError("the file does not exist", pointer=pointer, found=file)
        return path

    # Materials

    def _color(self, value: ColorInput, pointer: str) -> tuple[Rgb, int, str]:
        if isinstance(value, TextureRef):
            index = self._texture(value.texture, color=True, pointer=f"{pointer}/texture")
            return _rgb(value.factor), index, value.channel
        return _rgb(value), -1, "rgb"

    def _number(self, value: FloatInput, pointer: str) -> tuple[float, int, str]:
        if isinstance(value, TextureRef):
            index = self._texture(value.texture, color=False, pointer=f"{pointer}/texture")
            return float(np.mean(value.factor)), index, value.channel
        return float(value), -1, "rgb"

    def _material(self, material: Material, pointer: str) -> int:
        common: dict[str, Any] = {
            # A clear interface has two different sides.
            "two_sided": material.two_sided and not isinstance(material, Dielectric),
            "normal_map": -1,
            "normal_scale": 1.0,
            "opacity": self._number(material.opacity, f"{pointer}/opacity"),
            "alpha_cutoff": -1.0 if material.alpha_cutoff is None else material.alpha_cutoff,
        }
        if material.normal_map is not None:
            common["normal_map"] = self._texture(
                material.normal_map.texture, color=False, pointer=f"{pointer}/normal_map/texture"
            )
            common["normal_scale"] = material.normal_map.scale
        kind, values = self._material_values(material, pointer)
        return self.core.add_material(kind, {**common, **values})

    def _material_values(self, m: Material, at: str) -> tuple[str, dict[str, Any]]:
        if isinstance(m, Diffuse):
            return "diffuse", {"reflectance": self._color(m.reflectance, f"{at}/reflectance")}
        if isinstance(m, Conductor):
            eta, k = _rgb(m.eta), _rgb(m.k)
            if m.metal is not None:
                eta, k = _named_metal(m.metal, f"{at}/metal")
            return "conductor", {
                "eta": tuple(x / m.ext_ior for x in eta),
                "k": tuple(x / m.ext_ior for x in k),
                "reflectance": self._color(m.specular_reflectance, f"{at}/specular_reflectance"),
                **self._surface(m, at),
            }
        if isinstance(m, Dielectric):
            return "dielectric", {
                "eta": m.int_ior / m.ext_ior,
                "reflectance": self._color(m.specular_reflectance, f"{at}/specular_reflectance"),
                "transmittance": self._color(
                    m.specular_transmittance, f"{at}/specular_transmittance"
                ),
                "thin": m.thin,
                **self._surface(m, at),
            }
        if isinstance(m, Plastic):
            return "plastic", self._plastic_values(m, at)
        return "principled", self._principled_values(m, at)

    def _plastic_values(self, m: Plastic, at: str) -> dict[str, Any]:
        if isinstance(m.alpha, TextureRef):
            raise SceneError(
                "the alpha of a plastic cannot be a texture",
                pointer=f"{at}/alpha", found="a texture", accepted="a number",
            )
        alpha = self._number(m.alpha, f"{at}/alpha")
        return {
            "eta": m.int_ior / m.ext_ior,
            "diffuse": self._color(m.diffuse_reflectance, f"{at}/diffuse_reflectance"),
            "specular": self._color(m.specular_reflectance, f"{at}/specular_reflectance"),
            "nonlinear": m.nonlinear,
            "alpha_u": alpha,
            "alpha_v": alpha,
            "beckmann": m.distribution == "beckmann",
        }

    def _principled_values(self, m: Principled, at: str) -> dict[str, Any]:
        colors = ("base_color", "specular_color")
        numbers = ("metallic", "roughness", "specular", "transmission")
        return {
            "ior": m.ior,
            **{name: self._color(getattr(m, name), f"{at}/{name}") for name in colors},
            **{name: self._number(getattr(m, name), f"{at}/{name}") for name in numbers},
        }

    def _surface(self, m: Conductor | Dielectric, at: str) -> dict[str, Any]:
        alpha_u = self._number(m.alpha, f"{at}/alpha")
        alpha_v = alpha_u if m.alpha_v is None else self._number(m.alpha_v, f"{at}/alpha_v")
        return {"alpha_u": alpha_u, "alpha_v": alpha_v, "beckmann": m.distribution == "beckmann"}

    def _material_index(self, name: str | None, pointer: str) -> int:
        if name is None and None not in self._materials:
            self._materials[None] = self._material(DEFAULT_MATERIAL, "/materials")
        if name not in self._materials:
            raise SceneError(
                "no material of this name",
                pointer=f"{pointer}/material",
                found=name,
                accepted=_names(self.scene.materials),
            )
        return self._materials[name]

    # Shapes

    def _shape(self, shape: Shape, group: int, pointer: str) -> None:
        if isinstance(shape, Instance):
            self._instances(shape, pointer)
            return
        material = self._material_index(shape.material, pointer)
        emission = self._emission(shape.emission, f"{pointer}/emission")
        flip = shape.flip_normals
        matrix = None if shape.transform is None else np.array(shape.transform, np.float64)
        if isinstance(shape, Sphere):
            baked = _baked_sphere(shape, matrix)
            if baked is not None and not self._uses_uv(shape, matrix):
                self.core.add_sphere(group, *baked, material, emission, flip)
                return
            place = np.diag([shape.radius] * 3 + [1.0])
            place[:3, 3] = shape.center
            matrix = place if matrix is None else matrix @ place
        mesh = primitives.transformed(_triangles(shape, pointer), matrix)
        if not len(mesh.faces):
            self.warnings.append(f"{pointer}: the mesh has no triangles")
            return
        if not np.isfinite(mesh.vertices.sum(dtype=np.float64)):
            raise SceneError("the transform moves vertices out of range", pointer=pointer)
        self.core.add_mesh(group, *mesh, material, emission, flip)

    def _uses_uv(self, shape: Sphere, matrix: Matrix | None) -> bool:
        """Whether a turn of the sphere would show."""
        turned = matrix is not None and not np.allclose(
            matrix[:3, :3], np.eye(3) * matrix[0, 0], atol=1e-6
        )
        if not turned or shape.material is None:
            return False
        material = self.scene.materials[shape.material]
        if getattr(material, "alpha_v", None) is not None:
            return True
        return "texture" in repr(material.model_dump())

    def _instances(self, instance: Instance, pointer: str) -> None:
        if instance.group not in self._groups:
            raise SceneError(
                "no group of this name",
                pointer=f"{pointer}/group",
                found=instance.group,
                accepted=_names(self.scene.groups),
            )
        linear = instance.transforms[:, :3, :3].astype(np.float64)
        if not np.isfinite(instance.transforms).all():
            raise SceneError("a transform is not finite", pointer=f"{pointer}/transforms")
        singular = np.abs(np.linalg.det(linear)) < 1e-30
        if singular.any():
            raise SceneError(
                f"transform {int(np.argmax(singular))} flattens the group to nothing",
                pointer=f"{pointer}/transforms",
            )
        if self._has_emissive_sphere(instance.group) and not _all_similarities(linear):
            raise SceneError(
                "a group with an emissive sphere can be moved, turned and scaled evenly only",
                pointer=f"{pointer}/transforms",
            )
        self.core.add_instances(self._groups[instance.group], instance.transforms)

    def _has_emissive_sphere(self, group: str) -> bool:
        shapes = self.scene.groups[group]
        return any(isinstance(s, Sphere) and s.emission is not None for s in shapes)

    def _emission(self, emission: Emission | None, pointer: str) -> dict[str, Any] | None:
        if emission is None:
            return None
        radiance = self._color(emission.radiance, f"{pointer}/radiance")
        if radiance[1] < 0 and not any(radiance[0]):
            return None
        return {"radiance": radiance, "two_sided": emission.two_sided}

    # Lights and the camera

    def _light(self, light: Any, pointer: str) -> None:
        if isinstance(light, PointLight):
            self.core.add_point_light(light.position, _rgb(light.intensity))
        elif isinstance(light, SpotLight):
            outer = math.cos(math.radians(light.outer_angle_deg))
            inner = math.cos(math.radians(min(light.inner_angle_deg, light.outer_angle_deg)))
            _check_direction(light.direction, pointer)
            self.core.add_spot_light(
                light.position, light.direction, _rgb(light.intensity), inner, outer
            )
        elif isinstance(light, DirectionalLight):
            _check_direction(light.direction, pointer)
            self.core.add_directional_light(light.direction, _rgb(light.irradiance))
        elif isinstance(light, ConstantLight):
            self.core.add_environment_light(_rgb(light.radiance), -1, _columns(None, pointer))
        else:
            self._environment(light, pointer)

    def _environment(self, light: EnvironmentLight, pointer: str) -> None:
        pixels = self._image(light, pointer)
        if pixels.dtype != np.float32:
            pixels = _linear_of_srgb(pixels)
        if not np.isfinite(pixels).all() or (pixels < 0).any():
            self.warnings.append(f"{pointer}: pixels that are negative or not finite are taken as 0")
            pixels = np.where(np.isfinite(pixels), np.maximum(pixels, 0), 0).astype(np.float32)
        image = self.core.add_image_texture(
            np.ascontiguousarray(pixels), srgb=False, filter="bilinear", wrap_u="repeat",
            wrap_v="clamp", uv_transform=None,
        )
        self.core.add_environment_light(
            _rgb(light.scale), image, _columns(light.transform, pointer)
        )

    def _camera(self, settings: RenderSettings) -> None:
        camera = self._chosen_camera(settings.camera)
        if camera.look_at is not None:
            matrix = look_at_matrix(camera.look_at)
        else:
            matrix = np.eye(4) if camera.transform is None else np.array(camera.transform)
        if not abs(np.linalg.det(matrix[:3, :3])) > 0:
            raise SceneError("the camera's transform is singular", pointer="/cameras")
        tan_y = math.tan(fov_y_rad(camera, settings.width, settings.height) / 2)
        self.core.set_camera(
            matrix.astype(np.float32),
            tan_half_x=tan_y * settings.width / settings.height,
            tan_half_y=tan_y,
            offset_x=camera.principal_offset[0],
            offset_y=camera.principal_offset[1],
            near=camera.near,
            far=camera.far,
        )

    def _chosen_camera(self, name: str | None) -> PerspectiveCamera:
        if not self.scene.cameras:
            raise SceneError("the scene has no camera", pointer="/cameras")
        if name is None:
            return self.scene.cameras[0]
        for camera in self.scene.cameras:
            if camera.name == name:
                return camera
        names = ", ".join(c.name for c in self.scene.cameras)
        raise SettingsError(f"camera: no camera is named {name!r}; accepted: {names}")


def _triangles(shape: Any, pointer: str) -> primitives.Triangles:
    if isinstance(shape, Rectangle):
        return primitives.rectangle()
    if isinstance(shape, Cube):
        return primitives.cube()
    if isinstance(shape, Disk):
        return primitives.disk()
    if isinstance(shape, Sphere):
        return primitives.sphere()
    assert isinstance(shape, Mesh)
    if shape.vertices is None or shape.faces is None:
        raise SceneError("the mesh file was not read", pointer=f"{pointer}/file", found=shape.file)
    return primitives.Triangles(shape.vertices, shape.faces, shape.normals, shape.uvs)


def _baked_sphere(shape: Sphere, matrix: Matrix | None) -> tuple[Rgb, float] | None:
    """Centre and radius in the outer space, or None if the transform makes it no sphere."""
    if matrix is None:
        return shape.center, shape.radius
    if not _all_similarities(matrix[None, :3, :3]):
        return None
    center = matrix[:3, :3] @ np.array(shape.center) + matrix[:3, 3]
    scale = abs(float(np.linalg.det(matrix[:3, :3]))) ** (1 / 3)
    return (float(center[0]), float(center[1]), float(center[2])), shape.radius * scale


def _all_similarities(linear: NDArray[np.float64]) -> bool:
    gram = np.einsum("nij,nik->njk", linear, linear)
    scale = np.trace(gram, axis1=1, axis2=2)[:, None, None] / 3
    return bool(np.all(np.abs(gram - scale * np.eye(3)) <= 1e-4 * scale))


def _columns(transform: Any, pointer: str) -> list[Rgb]:
    """Orthonormal axes of a light's frame in world space."""
    if transform is None:
        return [(1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)]
    linear = np.array(transform, np.float64)[:3, :3]
    u, singular, vt = np.linalg.svd(linear)
    if not singular[-1] > 0:
        raise SceneError("the transform is singular", pointer=f"{pointer}/transform")
    return [tuple(float(x) for x in column) for column in (u @ vt).T]  # type: ignore[misc]


def _named_metal(name: str, pointer: str) -> tuple[Rgb, Rgb]:
    constants = optical_constants(name)
    if constants is None:
        raise SceneError(
            "no metal of this name", pointer=pointer, found=name, accepted=", ".join(METALS)
        )
    return constants


def _check_direction(direction: Rgb, pointer: str) -> None:
    if not any(direction):
        raise SceneError(
            "the direction is 0", pointer=f"{pointer}/direction", found=direction,
            accepted="a vector of any length but 0",
        )


def _rgb(value: float | Rgb) -> Rgb:
    if isinstance(value, tuple):
        return value
    return (value, value, value)


def _linear_of_srgb(pixels: NDArray[Any]) -> NDArray[np.float32]:
    """Integer or float pixels decoded with the sRGB curve (IEC 61966-2-1); alpha as it is."""
    x = pixels.astype(np.float32)
    if pixels.dtype != np.float32:
        x /= np.iinfo(pixels.dtype).max
    linear = np.where(x <= 0.04045, x / 12.92, ((x + 0.055) / 1.055) ** 2.4).astype(np.float32)
    if pixels.shape[2] in (2, 4):
        linear[..., -1] = x[..., -1]
    return np.ascontiguousarray(linear)


def _names(entries: dict[str, Any]) -> str:
    return ", ".join(sorted(entries)[:20]) or "none are defined"

"""The scene description: what the native JSON format holds and every other format is read into.

Conventions: right-handed, y up, metres.  Matrices are 4 x 4, row-major, and act on column vectors
(the translation is the last column).  Colours are linear RGB with Rec.709 primaries.  A texture
coordinate (0, 0) is the upper left corner of the image, as in glTF.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeVar

import numpy as np
from pydantic import AfterValidator, Field, PlainSerializer, PrivateAttr, ValidationError

from raykiln.errors import SceneError, scene_error_of
from raykiln.scene.base import (
    Affine2,
    Finite,
    Matrix4,
    Name,
    Node,
    NonNegative,
    Positive,
    Rgb,
    Unit,
    Vec3,
)
from raykiln.scene.cameras import Camera, LookAt, PerspectiveCamera, fov_y_rad, look_at_matrix
from raykiln.scene.lights import (
    ConstantLight,
    DirectionalLight,
    EnvironmentLight,
    Light,
    PointLight,
    SpotLight,
)
from raykiln.scene.materials import (
    Conductor,
    Dielectric,
    Diffuse,
    Distribution,
    Material,
    MaterialBase,
    NormalMap,
    Plastic,
    Principled,
)
from raykiln.scene.shapes import (
    Cube,
    Disk,
    Emission,
    GroupShape,
    Instance,
    Mesh,
    Rectangle,
    Shape,
    ShapeBase,
    Sphere,
)
from raykiln.scene.textures import (
    CheckerTexture,
    ColorInput,
    FloatInput,
    ImageTexture,
    Texture,
    TextureRef,
)
from raykiln.settings import RenderSettings

__all__ = [
    "MAX_WARNINGS",
    "Affine2",
    "Camera",
    "CheckerTexture",
    "ColorInput",
    "Conductor",
    "ConstantLight",
    "Cube",
    "Dielectric",
    "Diffuse",
    "DirectionalLight",
    "Disk",
    "Distribution",
    "Emission",
    "EnvironmentLight",
    "Finite",
    "FloatInput",
    "GroupShape",
    "ImageTexture",
    "Instance",
    "Light",
    "LookAt",
    "Material",
    "MaterialBase",
    "Matrix4",
    "Mesh",
    "Name",
    "Node",
    "NonNegative",
    "NormalMap",
    "PerspectiveCamera",
    "Plastic",
    "PointLight",
    "Positive",
    "Principled",
    "Rectangle",
    "Rgb",
    "Scene",
    "SceneError",
    "Shape",
    "ShapeBase",
    "Sphere",
    "SpotLight",
    "Texture",
    "TextureRef",
    "Unit",
    "Vec3",
    "fov_y_rad",
    "look_at_matrix",
]

Made = TypeVar("Made", bound=Node)

if TYPE_CHECKING:
    SceneSettings = dict[str, Any]
else:
    # Checked as settings, kept as what was given.
    SceneSettings = Annotated[
        RenderSettings,
        AfterValidator(lambda s: {name: getattr(s, name) for name in s.model_fields_set}),
        PlainSerializer(lambda given: given),
    ]


MAX_WARNINGS = 500


class Scene(Node):
    """A scene: build it in code, or read it with `raykiln.load_scene`."""

    version: Literal[1] = 1
    name: str | None = None
    description: str | None = None
    settings: SceneSettings = Field(default_factory=dict)
    """`RenderSettings` fields that apply where the caller gives none."""
    cameras: list[Camera] = Field(default_factory=list)
    """The first is the default."""
    textures: dict[Name, Texture] = Field(default_factory=dict)
    materials: dict[Name, Material] = Field(default_factory=dict)
    groups: dict[Name, list[GroupShape]] = Field(default_factory=dict)
    """Shapes that instances place."""
    shapes: list[Shape] = Field(default_factory=list)
    lights: list[Light] = Field(default_factory=list)

    base_dir: Path | None = Field(default=None, exclude=True)
    """Folder that relative file names start from; nothing outside it is read."""
    warnings: list[str] = Field(default_factory=list, exclude=True)
    """What the file asked for and is not supported, one sentence each."""
    _time_range_s: tuple[float, float] | None = PrivateAttr(default=None)

    @property
    def time_range_s(self) -> tuple[float, float] | None:
        """First and last moment of the file's animation; None = not animated."""
        return self._time_range_s

    @time_range_s.setter
    def time_range_s(self, value: tuple[float, float] | None) -> None:
        self._time_range_s = value

    @classmethod
    def create(cls, data: dict[str, Any], *, file: object = None) -> Scene:
        """A validated scene; a `SceneError` names the first bad place.

        Parameters
        ----------
        data
            The fields, as in the native JSON format (arrays may be NumPy arrays).
        file
            Named in the error.
        """
        try:
            return cls.model_validate(data)
        except ValidationError as error:
            raise scene_error_of(error, data=data, file=file) from None

    def to_json(self, *, indent: int | None = None) -> str:
        """The scene in the native JSON format (arrays are embedded)."""
        return self.model_dump_json(indent=indent, exclude_defaults=False, exclude_none=True)

    def warn(self, message: str) -> None:
        """Note something that the file asks for and that is not supported, once."""
        if message not in self.warnings and len(self.warnings) <= MAX_WARNINGS:
            full = len(self.warnings) == MAX_WARNINGS
            self.warnings.append("there are further warnings" if full else message)

    # Building in code. Each returns what later calls refer to.

    def add_texture(self, name: str, texture: Texture | np.ndarray[Any, Any]) -> str:
        """Add a texture, or an image array (height, width, channels); returns its name."""
        node = ImageTexture(pixels=texture) if isinstance(texture, np.ndarray) else texture
        self.textures[name] = node
        return name

    def add_material(self, name: str, material: Material) -> str:
        """Add a material under a name; returns the name."""
        self.materials[name] = material
        return name

    def add_mesh(
        self,
        vertices: Any,
        faces: Any,
        normals: Any = None,
        uvs: Any = None,
        material: str | Material | None = None,
        *,
        transform: Any = None,
        emission: Emission | float | Rgb | None = None,
        name: str | None = None,
        group: str | None = None,
    ) -> Mesh:
        """Add a triangle mesh; float32 and uint32 C-contiguous arrays are not copied.

        Parameters
        ----------
        vertices, faces, normals, uvs
            (n, 3) positions, (m, 3) vertex indices, (n, 3) normals, (n, 2) texture coordinates.
        material
            A name, or a material to add under a new name.
        transform
            4 x 4, world_from_mesh.
        emission
            Radiance in W / (sr m^2), or an `Emission`.
        group
            Add to this group (made if new) rather than to the scene itself.
        """
        return self._add(
            Mesh,
            group,
            vertices=vertices,
            faces=faces,
            normals=normals,
            uvs=uvs,
            material=self._material_name(material),
            transform=transform,
            emission=_emission(emission),
            name=name,
        )

    def add_sphere(
        self,
        center: Vec3 = (0.0, 0.0, 0.0),
        radius: float = 1.0,
        material: str | Material | None = None,
        *,
        emission: Emission | float | Rgb | None = None,
        name: str | None = None,
        group: str | None = None,
    ) -> Sphere:
        """Add an analytic sphere (`center` in metres; the rest as in `add_mesh`)."""
        return self._add(
            Sphere,
            group,
            center=center,
            radius=radius,
            material=self._material_name(material),
            emission=_emission(emission),
            name=name,
        )

    def add_instances(self, group: str, transforms: Any) -> Instance:
        """Place a group once for each of the (n, 4, 4) matrices world_from_group."""
        return self._add(Instance, None, group=group, transforms=transforms)

    def add_light(self, light: Light) -> Light:
        """Add a light that is not a shape."""
        self.lights.append(light)
        return light

    def set_camera(
        self,
        camera: Camera | None = None,
        *,
        origin: Vec3 | None = None,
        target: Vec3 | None = None,
        up: Vec3 = (0.0, 1.0, 0.0),
        fov_deg: float = 40.0,
        fov_axis: str = "smaller",
        name: str = "camera",
    ) -> Camera:
        """Make a camera the scene's first: a given one, or one that looks from origin to target."""
        if camera is None:
            look_at = {"origin": origin or (0, 0, 0), "target": target or (0, 0, -1), "up": up}
            camera = _node(
                PerspectiveCamera, look_at=look_at, fov_deg=fov_deg, fov_axis=fov_axis, name=name
            )
        self.cameras = [camera, *(c for c in self.cameras if c.name != camera.name)]
        return camera

    def _material_name(self, material: str | Material | None) -> str | None:
        if material is None or isinstance(material, str):
            return material
        number = len(self.materials)
        while f"material_{number}" in self.materials:
            number += 1
        return self.add_material(f"material_{number}", material)

    def _add(self, kind: type[Made], group: str | None, /, **values: Any) -> Made:
        shape = _node(kind, **values)
        target: list[Any] = self.shapes if group is None else self.groups.setdefault(group, [])
        target.append(shape)
        return shape


def _node(kind: type[Made], **values: Any) -> Made:
    try:
        return kind(**values)
    except ValidationError as error:
        raise scene_error_of(error, data=values) from None


def _emission(value: Emission | float | Rgb | None) -> Emission | None:
    if value is None or isinstance(value, Emission):
        return value
    return Emission(radiance=value)

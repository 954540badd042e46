"""The scene description: what the native JSON format holds and every other format is read into.

Conventions: right-handed, y up, metres.  Matrices are 4 x 4, row-major, and act on column vectors
(the translation is the last column).  Colours are linear RGB with Rec.709 primaries.  A texture
coordinate (0, 0) is the upper left corner of the image, as in glTF.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from raykiln.arrays import Float2, Float3, FloatImage, Index3, Matrices
from raykiln.errors import SceneError, scene_error_of

Finite = Annotated[float, Field(allow_inf_nan=False)]
NonNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
Unit = Annotated[float, Field(ge=0, le=1, allow_inf_nan=False)]
Vec3 = tuple[Finite, Finite, Finite]
Rgb = tuple[NonNegative, NonNegative, NonNegative]
Row = tuple[Finite, Finite, Finite, Finite]
Matrix4 = tuple[Row, Row, Row, Row]
Affine2 = tuple[tuple[Finite, Finite, Finite], tuple[Finite, Finite, Finite]]
Name = Annotated[str, Field(min_length=1, max_length=256)]


class Node(BaseModel):
    """Base of all parts of a scene: unknown fields are errors."""

    model_config = ConfigDict(extra="forbid", arbitrary_types_allowed=True)


# ---------------------------------------------------------------- textures


class TextureRef(Node):
    """A texture used for a parameter: value = factor x texture(uv)[channel]."""

    texture: Name
    """Name of an entry of `Scene.textures`."""
    channel: Literal["rgb", "r", "g", "b", "a"] = "rgb"
    """Which channel; `rgb` for a number means the mean of the three."""
    factor: NonNegative | Rgb = 1.0


ColorInput = NonNegative | Rgb | TextureRef
FloatInput = NonNegative | TextureRef


class ImageTexture(Node):
    """An image: a file beside the scene, or pixels in memory (exactly one of the two)."""

    type: Literal["image"] = "image"
    file: Name | None = None
    """Path relative to the scene file."""
    pixels: FloatImage | None = None
    """(height, width, 1..4), uint8, uint16 or float32; row 0 is the top."""
    color_space: Literal["auto", "srgb", "linear"] = "auto"
    """auto: 8- and 16-bit images used as colours are sRGB, all else is linear."""
    filter: Literal["bilinear", "nearest"] = "bilinear"
    wrap_u: Literal["repeat", "clamp", "mirror"] = "repeat"
    wrap_v: Literal["repeat", "clamp", "mirror"] = "repeat"
    uv_transform: Affine2 | None = None
    """(u, v) -> A (u, v, 1), applied before the look-up."""

    @model_validator(mode="after")
    def _one_source(self) -> ImageTexture:
        if (self.file is None) == (self.pixels is None):
            raise ValueError("an image texture takes exactly one of 'file' and 'pixels'")
        return self


class CheckerTexture(Node):
    """Checkerboard of 2 x 2 squares a unit of uv; `color0` lies at (0.25, 0.25)."""

    type: Literal["checker"] = "checker"
    color0: NonNegative | Rgb = 0.4
    color1: NonNegative | Rgb = 0.2
    uv_transform: Affine2 | None = None


Texture = Annotated[ImageTexture | CheckerTexture, Field(discriminator="type")]

# --------------------------------------------------------------- materials


class NormalMap(Node):
    """A tangent-space normal map (x right, y up in the image, z out)."""

    texture: Name
    scale: NonNegative = 1.0


class MaterialBase(Node):
    """What every material has."""

    two_sided: bool = True
    """Opaque materials: shade the back like the front (else the back is black)."""
    normal_map: NormalMap | None = None
    opacity: FloatInput = 1.0
    """1 = solid, 0 = not there; fractions let that share of the rays through."""
    alpha_cutoff: Unit | None = None
    """If given, opacity is 1 where it reaches the cut-off, else 0."""


class Diffuse(MaterialBase):
    """Lambertian reflection."""

    type: Literal["diffuse"] = "diffuse"
    reflectance: ColorInput = 0.5


Distribution = Literal["ggx", "beckmann"]


class Conductor(MaterialBase):
    """A metal with a smooth (alpha 0) or microfacet surface and complex index of refraction."""

    type: Literal["conductor"] = "conductor"
    metal: Name | None = None
    """A named metal (Au, Ag, Al, Cu, ... or `none`, a perfect mirror); else eta and k."""
    eta: NonNegative | Rgb = 0.0
    k: NonNegative | Rgb = 1.0
    ext_ior: Positive = 1.0
    alpha: FloatInput = 0.0
    """Microfacet width along u (and v, if `alpha_v` is not given); 0 = smooth."""
    alpha_v: FloatInput | None = None
    distribution: Distribution = "ggx"
    specular_reflectance: ColorInput = 1.0


class Dielectric(MaterialBase):
    """A clear material that reflects and refracts, with a smooth or microfacet surface."""

    type: Literal["dielectric"] = "dielectric"
    int_ior: Positive = 1.5046
    ext_ior: Positive = 1.000277
    alpha: FloatInput = 0.0
    alpha_v: FloatInput | None = None
    distribution: Distribution = "ggx"
    specular_reflectance: ColorInput = 1.0
    specular_transmittance: ColorInput = 1.0
    thin: bool = False
    """A thin pane: both interfaces at once, without refraction (smooth only)."""


class Plastic(MaterialBase):
    """A diffuse base under a smooth or microfacet dielectric coat."""

    type: Literal["plastic"] = "plastic"
    diffuse_reflectance: ColorInput = 0.5
    specular_reflectance: ColorInput = 1.0
    int_ior: Positive = 1.49
    ext_ior: Positive = 1.000277
    alpha: FloatInput = 0.0
    distribution: Distribution = "ggx"
    nonlinear: bool = False
    """Account for colour shifts by light scattered back from the coat."""


class Principled(MaterialBase):
    """Metallic-roughness material, as in glTF 2.0 (alpha = roughness squared, GGX)."""

    type: Literal["principled"] = "principled"
    base_color: ColorInput = 0.8
    metallic: FloatInput = 0.0
    roughness: FloatInput = 0.5
    ior: Annotated[float, Field(ge=1, le=10, allow_inf_nan=False)] = 1.5
    specular: FloatInput = 1.0
    """Strength of the dielectric reflection (glTF KHR_materials_specular)."""
    specular_color: ColorInput = 1.0
    transmission: FloatInput = 0.0
    """Share of the light that enters the base and is refracted instead of diffused."""


Material = Annotated[
    Diffuse | Conductor | Dielectric | Plastic | Principled, Field(discriminator="type")
]

# ------------------------------------------------------------------ shapes


class Emission(Node):
    """Light given off by a surface."""

    radiance: ColorInput
    """W / (sr m^2)."""
    two_sided: bool = False
    """Also from the back (against the normal)."""


class ShapeBase(Node):
    """What every shape has."""

    name: Name | None = None
    material: Name | None = None
    """Name of an entry of `Scene.materials`; None = a grey diffuse."""
    transform: Matrix4 | None = None
    """world_from_shape (within a group: group_from_shape)."""
    emission: Emission | None = None
    flip_normals: bool = False


class Mesh(ShapeBase):
    """Indexed triangles, counter-clockwise seen from outside; arrays here, or a file."""

    type: Literal["mesh"] = "mesh"
    file: Name | None = None
    """.ply, .obj or .stl beside the scene file, in place of the arrays."""
    vertices: Float3 | None = None
    """(n, 3) float32."""
    faces: Index3 | None = None
    """(m, 3) uint32, each below n."""
    normals: Float3 | None = None
    """(n, 3) float32, or None: face normals."""
    uvs: Float2 | None = None
    """(n, 2) float32."""

    @model_validator(mode="after")
    def _whole(self) -> Mesh:
        if (self.file is None) == (self.vertices is None and self.faces is None):
            raise ValueError("a mesh takes either 'file' or 'vertices' and 'faces'")
        if self.file is None:
            _check_mesh_arrays(self)
        return self


def _check_mesh_arrays(mesh: Mesh) -> None:
    if mesh.vertices is None or mesh.faces is None:
        raise ValueError("a mesh takes both 'vertices' and 'faces'")
    count = len(mesh.vertices)
    if mesh.faces.size and int(mesh.faces.max()) >= count:
        face = int(np.argmax((mesh.faces >= count).any(axis=1)))
        raise ValueError(f"face {face} refers to vertex {int(mesh.faces.max())} of {count}")
    for label, array in (("vertices", mesh.vertices), ("normals", mesh.normals), ("uvs", mesh.uvs)):
        if array is None:
            continue
        if len(array) != count:
            raise ValueError(f"{label} has {len(array)} rows for {count} vertices")
        if not np.isfinite(array.sum(dtype=np.float64)):
            finite = np.isfinite(array).all(axis=1)
            if not finite.all():
                raise ValueError(f"{label} row {int(np.argmin(finite))} is not finite")


class Sphere(ShapeBase):
    """An analytic sphere."""

    type: Literal["sphere"] = "sphere"
    center: Vec3 = (0.0, 0.0, 0.0)
    radius: Positive = 1.0


class Rectangle(ShapeBase):
    """The square [-1, 1]^2 in the xy plane, facing +z, uv (0, 0) to (1, 1)."""

    type: Literal["rectangle"] = "rectangle"


class Cube(ShapeBase):
    """The cube [-1, 1]^3, facing outwards."""

    type: Literal["cube"] = "cube"


class Disk(ShapeBase):
    """The unit disk in the xy plane, facing +z."""

    type: Literal["disk"] = "disk"


class Instance(Node):
    """A group, placed once for each matrix."""

    type: Literal["instance"] = "instance"
    name: Name | None = None
    group: Name
    """Name of an entry of `Scene.groups`."""
    transforms: Matrices
    """(n, 4, 4) float32, world_from_group."""


GroupShape = Annotated[Mesh | Sphere | Rectangle | Cube | Disk, Field(discriminator="type")]
Shape = Annotated[Mesh | Sphere | Rectangle | Cube | Disk | Instance, Field(discriminator="type")]

# ------------------------------------------------------------------ lights


class PointLight(Node):
    """Equal intensity into all directions."""

    type: Literal["point"] = "point"
    position: Vec3
    intensity: NonNegative | Rgb
    """W / sr."""


class SpotLight(Node):
    """A cone of light: full inside `inner_angle_deg`, none outside `outer_angle_deg`.

    Between them the intensity falls off as in glTF's KHR_lights_punctual: with t linear in the
    cosine from 0 (outer) to 1 (inner), as t squared.
    """

    type: Literal["spot"] = "spot"
    position: Vec3
    direction: Vec3
    """The way the light travels along the axis."""
    intensity: NonNegative | Rgb
    """W / sr, on the axis."""
    inner_angle_deg: Annotated[float, Field(ge=0, lt=180)] = 0.0
    """Half angle of the inner cone."""
    outer_angle_deg: Annotated[float, Field(gt=0, le=180)] = 45.0
    """Half angle of the outer cone."""


class DirectionalLight(Node):
    """Parallel light from infinitely far away."""

    type: Literal["directional"] = "directional"
    direction: Vec3
    """The way the light travels."""
    irradiance: NonNegative | Rgb
    """W / m^2, on a surface that faces the light."""


class ConstantLight(Node):
    """The same radiance from every direction."""

    type: Literal["constant"] = "constant"
    radiance: NonNegative | Rgb


class EnvironmentLight(Node):
    """A latitude-longitude map of the radiance from infinitely far away.

    With d the direction in the light's own frame: u = atan2(d.x, -d.z) / 2 pi (wrapped to 0..1),
    v = acos(d.y) / pi; row 0 of the image is +y.
    """

    type: Literal["environment"] = "environment"
    file: Name | None = None
    pixels: FloatImage | None = None
    scale: NonNegative | Rgb = 1.0
    transform: Matrix4 | None = None
    """world_from_light (its rotation counts)."""

    @model_validator(mode="after")
    def _one_source(self) -> EnvironmentLight:
        if (self.file is None) == (self.pixels is None):
            raise ValueError("an environment light takes exactly one of 'file' and 'pixels'")
        return self


Light = Annotated[
    PointLight | SpotLight | DirectionalLight | ConstantLight | EnvironmentLight,
    Field(discriminator="type"),
]

# ----------------------------------------------------------------- cameras


class LookAt(Node):
    """A camera placed by points."""

    origin: Vec3
    target: Vec3
    up: Vec3 = (0.0, 1.0, 0.0)

    @model_validator(mode="after")
    def _not_degenerate(self) -> LookAt:
        forward = np.subtract(self.target, self.origin)
        if not np.linalg.norm(np.cross(forward, self.up)) > 0:
            raise ValueError("origin, target and up must not lie on one line")
        return self


class PerspectiveCamera(Node):
    """A pinhole camera: in its own frame it looks along -z, with +x right and +y up."""

    type: Literal["perspective"] = "perspective"
    name: Name = "camera"
    fov_deg: Annotated[float, Field(gt=0, lt=180)] = 40.0
    """Full field of view along `fov_axis`."""
    fov_axis: Literal["x", "y", "smaller", "larger", "diagonal"] = "smaller"
    transform: Matrix4 | None = None
    """world_from_camera; a scale in it is ignored."""
    look_at: LookAt | None = None
    """In place of `transform`."""
    near: NonNegative = 0.0
    """Nothing nearer than this (along the view axis) is seen."""
    far: Positive = 1e30
    principal_offset: tuple[Finite, Finite] = (0.0, 0.0)
    """Shift of the principal point, in image widths and heights, to the right and down."""

    @model_validator(mode="after")
    def _placed_once(self) -> PerspectiveCamera:
        if self.transform is not None and self.look_at is not None:
            raise ValueError("a camera takes 'transform' or 'look_at', not both")
        return self


Camera = PerspectiveCamera

# ------------------------------------------------------------------- scene


MAX_WARNINGS = 500

class Scene(Node):
    """A scene: build it in code, or read it with `raykiln.load_scene`."""

    version: Literal[1] = 1
    name: str | None = None
    description: str | None = None
    settings: dict[str, Any] = Field(default_factory=dict)
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

    def _add(self, kind: type[Any], group: str | None, /, **values: Any) -> Any:
        shape = _node(kind, **values)
        target: list[Any] = self.shapes if group is None else self.groups.setdefault(group, [])
        target.append(shape)
        return shape


def _node(kind: type[Any], **values: Any) -> Any:
    try:
        return kind(**values)
    except ValidationError as error:
        raise scene_error_of(error, data=values) from None


def _emission(value: Emission | float | Rgb | None) -> Emission | None:
    if value is None or isinstance(value, Emission):
        return value
    return Emission(radiance=value)


def look_at_matrix(look_at: LookAt) -> np.ndarray[Any, np.dtype[np.float64]]:
    """world_from_camera (4, 4) of a camera that looks along its -z from origin to target."""
    back = np.subtract(look_at.origin, look_at.target).astype(np.float64)
    back /= np.linalg.norm(back)
    right = np.cross(look_at.up, back)
    right /= np.linalg.norm(right)
    matrix = np.eye(4)
    matrix[:3, 0], matrix[:3, 1], matrix[:3, 2] = right, np.cross(back, right), back
    matrix[:3, 3] = look_at.origin
    return matrix


def fov_y_rad(camera: PerspectiveCamera, width: int, height: int) -> float:
    """Vertical field of view in radians for an image of the given size in pixels."""
    half = math.tan(math.radians(camera.fov_deg) / 2)
    aspect = width / height
    axis = camera.fov_axis
    if axis == "smaller":
        axis = "x" if aspect < 1 else "y"
    elif axis == "larger":
        axis = "y" if aspect < 1 else "x"
    if axis == "diagonal":
        half /= math.hypot(aspect, 1.0)
    elif axis == "x":
        half /= aspect
    return 2 * math.atan(half)


__all__ = [name for name in globals() if name[0].isupper()] + ["SceneError"]

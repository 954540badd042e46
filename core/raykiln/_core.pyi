"""The compiled core: scenes are handed over part by part, then rendered pass by pass."""

from collections.abc import Callable, Sequence
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

_Vec3: TypeAlias = tuple[float, float, float]

__version__: str

def isa() -> str:
    """The instruction set of this process: "sse4.2", "avx2" or "avx512".

    Raises `SettingsError` if RAYKILN_ISA names another, or one that this processor lacks.
    """

class Scene:
    """A scene under construction, then built; indices count from 0, -1 = none."""

    def __init__(self) -> None: ...
    def add_image_texture(
        self,
        pixels: NDArray[Any],
        *,
        srgb: bool,
        filter: str,
        wrap_u: str,
        wrap_v: str,
        uv_transform: Sequence[Sequence[float]] | None,
    ) -> int:
        """A C-contiguous (height, width, 1..4) array of uint8, uint16 or float32; not copied."""

    def add_checker_texture(
        self,
        color0: _Vec3,
        color1: _Vec3,
        uv_transform: Sequence[Sequence[float]] | None,
    ) -> int: ...
    def add_material(self, kind: str, parameters: dict[str, Any]) -> int: ...
    def add_group(self) -> int:
        """A group of shapes for instances; group 0 is the world itself."""

    def add_mesh(
        self,
        group: int,
        vertices: NDArray[np.float32],
        faces: NDArray[np.uint32],
        normals: NDArray[np.float32] | None,
        uvs: NDArray[np.float32] | None,
        material: int,
        emission: dict[str, Any] | None,
        flip_normals: bool,
    ) -> None:
        """C-contiguous (n, 3), (m, 3), (n, 3) and (n, 2) arrays; they are not copied."""

    def add_sphere(
        self,
        group: int,
        center: _Vec3,
        radius: float,
        material: int,
        emission: dict[str, Any] | None,
        flip_normals: bool,
    ) -> None: ...
    def add_instances(self, group: int, matrices: NDArray[np.float32]) -> None:
        """One for each of the (n, 4, 4) matrices world_from_group."""

    def add_point_light(self, position: _Vec3, intensity: _Vec3, /) -> None: ...
    def add_spot_light(
        self,
        position: _Vec3,
        axis: _Vec3,
        intensity: _Vec3,
        cos_inner: float,
        cos_outer: float,
        /,
    ) -> None: ...
    def add_directional_light(self, direction: _Vec3, irradiance: _Vec3, /) -> None: ...
    def add_environment_light(self, scale: _Vec3, map: int, columns: Sequence[_Vec3]) -> None:
        """A map of texture `map` (-1 = even light) in the frame of three orthonormal columns."""

    def set_camera(
        self,
        world_from_camera: NDArray[np.float32],
        tan_half_x: float,
        tan_half_y: float,
        offset_x: float,
        offset_y: float,
        near: float,
        far: float,
    ) -> None: ...
    def build(self) -> None:
        """Build the hierarchies and the tables of the lights: call once, after the last part."""

    def summary(self) -> dict[str, int]: ...
    def bounds(self) -> tuple[_Vec3, _Vec3]:
        """Lowest and highest corner, in metres."""

    @property
    def memory_bytes(self) -> int:
        """Of the hierarchies; 0 before `build`."""

class Renderer:
    """A film and what fills it."""

    def __init__(self, scene: Scene, options: dict[str, Any]) -> None: ...
    def run_pass(self, poll: Callable[[int], bool]) -> bool:
        """Go on until the pass under way is finished; False if `poll` stopped it.

        `poll` is called about every 20 ms with the samples done; what it raises comes through.
        """

    def planes(self) -> dict[str, NDArray[Any]]:
        """The film's sums by name, shared with it: (height, width) or (height, width, 3)."""

    def resume(self) -> None:
        """Go on from the counts that were written into `planes`."""

    def counts(self) -> dict[str, int]:
        """Rays by kind, and samples that were not finite."""

    @property
    def samples_done(self) -> int:
        """Samples that every pixel has."""

    @property
    def finished(self) -> bool: ...
    @property
    def threads(self) -> int: ...

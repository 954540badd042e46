"""Materials: the parameters of each kind, as numbers or textures of the core."""

from __future__ import annotations

from typing import Any

from raykiln.compile.build import Build, Rgb, names_of, rgb_of
from raykiln.compile.textures import Textures
from raykiln.errors import SceneError
from raykiln.metals import METALS, optical_constants
from raykiln.scene import (
    Conductor,
    Dielectric,
    Diffuse,
    Material,
    Plastic,
    Principled,
    TextureRef,
)

DEFAULT_MATERIAL = Diffuse()


class Materials:
    """The materials of a scene by name."""

    def __init__(self, build: Build, textures: Textures) -> None:
        self._build = build
        self._textures = textures
        self._indices: dict[str | None, int] = {}
        for name, material in build.scene.materials.items():
            self._indices[name] = self._add(material, f"/materials/{name}")

    def index(self, name: str | None, pointer: str) -> int:
        """The index of a shape's material; None is a grey diffuse."""
        if name is None and None not in self._indices:
            self._indices[None] = self._add(DEFAULT_MATERIAL, "/materials")
        if name not in self._indices:
            raise SceneError(
                "no material of this name",
                pointer=f"{pointer}/material",
                found=name,
                accepted=names_of(self._build.scene.materials),
            )
        return self._indices[name]

    def _add(self, material: Material, pointer: str) -> int:
        common: dict[str, Any] = {
            # A clear interface has two different sides.
            "two_sided": material.two_sided and not isinstance(material, Dielectric),
            "normal_map": -1,
            "normal_scale": 1.0,
            "opacity": self._number(material, "opacity", pointer),
            "alpha_cutoff": -1.0 if material.alpha_cutoff is None else material.alpha_cutoff,
        }
        if material.normal_map is not None:
            common["normal_map"] = self._textures.index(
                material.normal_map.texture, color=False, pointer=f"{pointer}/normal_map/texture"
            )
            common["normal_scale"] = material.normal_map.scale
        kind, values = self._values(material, pointer)
        return self._build.core.add_material(kind, {**common, **values})

    def _values(self, m: Material, at: str) -> tuple[str, dict[str, Any]]:
        if isinstance(m, Diffuse):
            return "diffuse", {"reflectance": self._color(m, "reflectance", at)}
        if isinstance(m, Conductor):
            return "conductor", self._conductor(m, at)
        if isinstance(m, Dielectric):
            return "dielectric", {
                "eta": m.int_ior / m.ext_ior,
                "reflectance": self._color(m, "specular_reflectance", at),
                "transmittance": self._color(m, "specular_transmittance", at),
                "thin": m.thin,
                **self._surface(m, at),
            }
        if isinstance(m, Plastic):
            return "plastic", self._plastic(m, at)
        return "principled", self._principled(m, at)

    def _conductor(self, m: Conductor, at: str) -> dict[str, Any]:
        eta, k = rgb_of(m.eta), rgb_of(m.k)
        if m.metal is not None:
            eta, k = _named_metal(m.metal, f"{at}/metal")
        return {
            "eta": tuple(x / m.ext_ior for x in eta),
            "k": tuple(x / m.ext_ior for x in k),
            "reflectance": self._color(m, "specular_reflectance", at),
            **self._surface(m, at),
        }

    def _plastic(self, m: Plastic, at: str) -> dict[str, Any]:
        if isinstance(m.alpha, TextureRef):
            raise SceneError(
                "the alpha of a plastic cannot be a texture",
                pointer=f"{at}/alpha",
                found="a texture",
                accepted="a number",
            )
        alpha = self._number(m, "alpha", at)
        return {
            "eta": m.int_ior / m.ext_ior,
            "diffuse": self._color(m, "diffuse_reflectance", at),
            "specular": self._color(m, "specular_reflectance", at),
            "nonlinear": m.nonlinear,
            "alpha_u": alpha,
            "alpha_v": alpha,
            "beckmann": m.distribution == "beckmann",
        }

    def _principled(self, m: Principled, at: str) -> dict[str, Any]:
        colors = ("base_color", "specular_color")
        numbers = ("metallic", "roughness", "specular", "transmission")
        return {
            "ior": m.ior,
            **{name: self._color(m, name, at) for name in colors},
            **{name: self._number(m, name, at) for name in numbers},
        }

    def _surface(self, m: Conductor | Dielectric, at: str) -> dict[str, Any]:
        alpha_v = "alpha" if m.alpha_v is None else "alpha_v"
        return {
            "alpha_u": self._number(m, "alpha", at),
            "alpha_v": self._number(m, alpha_v, at),
            "beckmann": m.distribution == "beckmann",
        }

    def _color(self, m: Material, name: str, at: str) -> tuple[Rgb, int, str]:
        return self._textures.color(getattr(m, name), f"{at}/{name}")

    def _number(self, m: Material, name: str, at: str) -> tuple[float, int, str]:
        return self._textures.number(getattr(m, name), f"{at}/{name}")


def _named_metal(name: str, pointer: str) -> tuple[Rgb, Rgb]:
    constants = optical_constants(name)
    if constants is None:
        raise SceneError(
            "no metal of this name", pointer=pointer, found=name, accepted=", ".join(METALS)
        )
    return constants

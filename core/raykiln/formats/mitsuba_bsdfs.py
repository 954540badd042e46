"""Mitsuba BSDFs as our materials.

A Mitsuba BSDF that does not transmit is black from behind unless it is wrapped in `twosided`.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from raykiln.errors import SceneError
from raykiln.formats.mitsuba_objects import MitsubaObject
from raykiln.formats.mitsuba_textures import TEXTURE_TAGS, Context
from raykiln.formats.names import unique_name
from raykiln.metals import METALS, optical_constants
from raykiln.scene import (
    Conductor,
    Dielectric,
    Diffuse,
    Material,
    NormalMap,
    Plastic,
    Principled,
)

# Indices of refraction by name, at 589 nm.
INDICES = {
    "vacuum": 1.0, "helium": 1.000036, "hydrogen": 1.000132, "air": 1.000277,
    "carbon dioxide": 1.00045, "water": 1.3330, "acetone": 1.36, "ethanol": 1.361,
    "carbon tetrachloride": 1.461, "glycerol": 1.4729, "benzene": 1.501, "silicone oil": 1.52045,
    "bromine": 1.661, "water ice": 1.31, "fused quartz": 1.458, "pyrex": 1.470,
    "acrylic glass": 1.49, "polypropylene": 1.49, "bk7": 1.5046, "sodium chloride": 1.544,
    "amber": 1.55, "pet": 1.5750, "diamond": 2.419,
}  # fmt: skip
_DISTRIBUTIONS = {"beckmann": "beckmann", "ggx": "ggx"}
_UNSUPPORTED_PRINCIPLED = (
    "anisotropic", "spec_tint", "sheen", "sheen_tint", "clearcoat", "clearcoat_gloss", "flatness",
    "diff_trans",
)  # fmt: skip


class Materials:
    """Makes materials, each object once."""

    def __init__(self, context: Context) -> None:
        self.context = context
        self._names: dict[int, str] = {}

    def name(self, owner: MitsubaObject) -> str:
        """The name in the scene of the material of a BSDF object."""
        key = id(owner)
        if key not in self._names:
            materials = self.context.scene.materials
            name = unique_name(owner.id or f"bsdf_line_{owner.line}", materials)
            materials[name] = self.material(owner)
            self._names[key] = name
        return self._names[key]

    def default_name(self, *, shines: bool) -> str:
        """The name of what shapes without a BSDF are made of: lamps are black, others grey."""
        name, reflectance = ("mitsuba_lamp", 0.0) if shines else ("mitsuba_default", 0.5)
        default = Diffuse(reflectance=reflectance, two_sided=False)
        self.context.scene.materials.setdefault(name, default)
        return name

    def material(self, owner: MitsubaObject) -> Material:
        """The material of a BSDF object."""
        maker = _MAKERS.get(owner.type)
        if maker is None:
            self.context.warn(owner, "this BSDF is not supported; a grey diffuse is used")
            owner.used.update(owner.properties, (name for name, _ in owner.children))
            return Diffuse(reflectance=0.5, two_sided=False)
        return maker(self, owner)

    def diffuse(self, owner: MitsubaObject) -> Material:
        """`diffuse`, and as an approximation `roughdiffuse`."""
        if owner.type == "roughdiffuse":
            self.context.warn(owner, "rough diffuse is rendered as a Lambertian")
            owner.used.update(("alpha", "use_fast_approx"))
        reflectance = self.context.color(owner, "reflectance", 0.5, "reflectance")
        return Diffuse(reflectance=reflectance, two_sided=False)

    def dielectric(self, owner: MitsubaObject) -> Material:
        """`dielectric`, `thindielectric` and `roughdielectric`."""
        context = self.context
        values: dict[str, Any] = {
            "int_ior": self._index(owner, "int_ior", "bk7"),
            "ext_ior": self._index(owner, "ext_ior", "air"),
            "specular_reflectance": context.color(
                owner, "specular_reflectance", 1.0, "reflectance"
            ),
            "specular_transmittance": context.color(
                owner, "specular_transmittance", 1.0, "reflectance"
            ),
            "thin": owner.type == "thindielectric",
        }
        if owner.type == "roughdielectric":
            values |= self._roughness(owner)
        return Dielectric(**values)

    def conductor(self, owner: MitsubaObject) -> Material:
        """`conductor` and `roughconductor`."""
        values: dict[str, Any] = {
            "specular_reflectance": self.context.color(
                owner, "specular_reflectance", 1.0, "reflectance"
            ),
            "ext_ior": self._index(owner, "ext_eta", "vacuum"),
            "two_sided": False,
        }
        has_eta = "eta" in owner.properties or owner.child("eta") is not None
        metal = owner.string("material", "none")
        if has_eta or metal == "none":
            values["eta"] = self.context.constant_color(owner, "eta", 0.0, "index")
            values["k"] = self.context.constant_color(owner, "k", 1.0, "index")
        elif optical_constants(metal) is None:
            raise SceneError(
                "not a known metal", pointer=owner.pointer, found=metal, accepted=" ".join(METALS)
            )
        else:
            values["metal"] = metal
        if owner.type == "roughconductor":
            values |= self._roughness(owner)
        return Conductor(**values)

    def plastic(self, owner: MitsubaObject) -> Material:
        """`plastic` and `roughplastic`."""
        context = self.context
        values: dict[str, Any] = {
            "diffuse_reflectance": context.color(owner, "diffuse_reflectance", 0.5, "reflectance"),
            "specular_reflectance": context.color(
                owner, "specular_reflectance", 1.0, "reflectance"
            ),
            "int_ior": self._index(owner, "int_ior", "polypropylene"),
            "ext_ior": self._index(owner, "ext_ior", "air"),
            "nonlinear": owner.boolean("nonlinear", False),
            "two_sided": False,
        }
        if owner.type == "roughplastic":
            values["alpha"] = context.value(owner, "alpha", 0.1)
            values["distribution"] = self._distribution(owner)
        return Plastic(**values)

    def principled(self, owner: MitsubaObject) -> Material:
        """`principled`: the parts that the metallic-roughness model has too."""
        context = self.context
        for name in _UNSUPPORTED_PRINCIPLED:
            given = context.value(owner, name, 0.0)
            if given != 0.0:
                context.warn(owner, f"'{name}' is not supported and not used")
        if owner.type == "principledthin":
            context.warn(owner, "the thin surface is rendered as a solid one")
        specular = owner.float("specular", 0.5)
        ior = owner.float("eta", 2 / (1 - math.sqrt(min(max(0.08 * specular, 0.0), 0.9))) - 1)
        return Principled(
            base_color=context.color(owner, "base_color", 0.5, "reflectance"),
            metallic=context.value(owner, "metallic", 0.0),
            roughness=context.value(owner, "roughness", 0.5),
            ior=min(max(ior, 1.0), 10.0),
            transmission=context.value(owner, "spec_trans", 0.0),
            two_sided=False,
        )

    def two_sided(self, owner: MitsubaObject) -> Material:
        """`twosided`."""
        inner = self._inner(owner, most=2)
        if len(inner) > 1:
            self.context.warn(owner, "two different sides are not supported; the first is used")
        return self.material(inner[0]).model_copy(update={"two_sided": True})

    def mask(self, owner: MitsubaObject) -> Material:
        """`mask`: an opacity over a BSDF."""
        inner = self.material(self._inner(owner)[0])
        opacity = self.context.value(owner, "opacity", 0.5)
        return inner.model_copy(update={"opacity": opacity})

    def null(self, owner: MitsubaObject) -> Material:
        """`null`: nothing there."""
        return Diffuse(opacity=0.0)

    def normal_map(self, owner: MitsubaObject) -> Material:
        """`normalmap`."""
        inner = self.material(self._inner(owner)[0])
        image = owner.child("normalmap") or next(iter(owner.tagged(*TEXTURE_TAGS)), None)
        if image is None:
            raise SceneError("a normal map without a texture", pointer=owner.pointer)
        name = self.context.texture(image)
        return inner.model_copy(update={"normal_map": NormalMap(texture=name) if name else None})

    def without_bumps(self, owner: MitsubaObject) -> Material:
        """`bumpmap` and coatings: the BSDF inside."""
        self.context.warn(owner, "this is not supported; the BSDF inside is used alone")
        owner.used.update(owner.properties, (name for name, _ in owner.children))
        return self.material(self._inner(owner)[0])

    def blend(self, owner: MitsubaObject) -> Material:
        """`blendbsdf`: the heavier of its two."""
        inner = self._inner(owner, most=2)
        weight = self.context.value(owner, "weight", 0.5)
        self.context.warn(owner, "blends are not supported; the heavier BSDF is used alone")
        heavier = isinstance(weight, float) and weight > 0.5
        return self.material(inner[-1] if heavier else inner[0])

    def _inner(self, owner: MitsubaObject, most: int = 1) -> list[MitsubaObject]:
        inner = owner.tagged("bsdf")
        owner.used.update(name for name, child in owner.children if child.tag == "bsdf")
        if not 1 <= len(inner) <= most:
            raise SceneError(
                f"takes {'one BSDF' if most == 1 else 'one or two BSDFs'}",
                pointer=owner.pointer,
                found=len(inner),
            )
        return inner

    def _index(self, owner: MitsubaObject, name: str, default: str) -> float:
        value = owner.get(name, (float, int, str), default)
        if isinstance(value, str):
            if value.lower() not in INDICES:
                raise SceneError(
                    f"not a known material for '{name}'",
                    pointer=owner.pointer,
                    found=value,
                    accepted=", ".join(INDICES),
                )
            return INDICES[value.lower()]
        if not value > 0:
            raise SceneError(f"'{name}' must be positive", pointer=owner.pointer, found=value)
        return float(value)

    def _roughness(self, owner: MitsubaObject) -> dict[str, Any]:
        context = self.context
        values: dict[str, Any] = {"distribution": self._distribution(owner)}
        split = any(
            name in owner.properties or owner.child(name) is not None
            for name in ("alpha_u", "alpha_v")
        )
        if split:
            values["alpha"] = context.value(owner, "alpha_u", 0.1)
            values["alpha_v"] = context.value(owner, "alpha_v", 0.1)
        else:
            values["alpha"] = context.value(owner, "alpha", 0.1)
        return values

    def _distribution(self, owner: MitsubaObject) -> str:
        owner.used.add("sample_visible")
        name = owner.string("distribution", "beckmann")
        if name not in _DISTRIBUTIONS:
            self.context.warn(owner, f"the distribution '{name}' is rendered as beckmann")
        return _DISTRIBUTIONS.get(name, "beckmann")


_MAKERS: dict[str, Callable[[Materials, MitsubaObject], Material]] = {
    "diffuse": Materials.diffuse,
    "roughdiffuse": Materials.diffuse,
    "dielectric": Materials.dielectric,
    "thindielectric": Materials.dielectric,
    "roughdielectric": Materials.dielectric,
    "conductor": Materials.conductor,
    "roughconductor": Materials.conductor,
    "plastic": Materials.plastic,
    "roughplastic": Materials.plastic,
    "principled": Materials.principled,
    "principledthin": Materials.principled,
    "twosided": Materials.two_sided,
    "mask": Materials.mask,
    "null": Materials.null,
    "normalmap": Materials.normal_map,
    "bumpmap": Materials.without_bumps,
    "bump": Materials.without_bumps,
    "coating": Materials.without_bumps,
    "roughcoating": Materials.without_bumps,
    "blendbsdf": Materials.blend,
    "mixturebsdf": Materials.blend,
}

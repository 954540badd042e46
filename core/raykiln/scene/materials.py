"""Materials: how surfaces scatter light."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from raykiln.scene.base import Name, Node, NonNegative, Positive, Rgb, Unit
from raykiln.scene.textures import ColorInput, FloatInput


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

"""glTF materials as principled materials."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from raykiln.errors import SceneError
from raykiln.formats.gltf_data import GltfData
from raykiln.formats.gltf_textures import Textures, Use
from raykiln.formats.json_text import Item
from raykiln.formats.names import unique_name
from raykiln.scene import Diffuse, Emission, Material, NormalMap, Principled, Scene, TextureRef

_EXTENSIONS = {
    "KHR_materials_emissive_strength", "KHR_materials_ior", "KHR_materials_specular",
    "KHR_materials_transmission", "KHR_materials_unlit",
}  # fmt: skip


@dataclass
class GltfMaterial:
    """A material of the scene, and what its glTF shapes must know."""

    name: str
    emission: Emission | None = None
    coordinates: int = 0


class Materials:
    """Adds each material to the scene once."""

    def __init__(self, data: GltfData, scene: Scene, textures: Textures) -> None:
        self.data, self.scene, self.textures = data, scene, textures
        self._made: dict[int | None, GltfMaterial] = {}

    def get(self, index: int | None, pointer: str) -> GltfMaterial:
        """The material of an index; None is the glTF default material."""
        if index not in self._made:
            root = self.data.root
            item = Item({}, "") if index is None else root.entry("materials", index, pointer)
            self._made[index] = self._make(item, index)
        return self._made[index]

    def has(self, index: int) -> bool:
        """Whether the material was asked for."""
        return index in self._made

    def _make(self, item: Item, index: int | None) -> GltfMaterial:
        label = item.string("name", "") or ("default" if index is None else f"material_{index}")
        name = unique_name(label, self.scene.materials)
        builder = _Builder(self.scene, self.textures, item)
        self.scene.materials[name] = builder.material()
        return GltfMaterial(name, builder.emission(), builder.coordinates())


class _Builder:
    """Makes one material.

    Faces are shaded from both sides whatever `doubleSided` says, which asks rasterizers to cull;
    it does decide from which sides light is given off.
    """

    def __init__(self, scene: Scene, textures: Textures, item: Item) -> None:
        self.scene, self.textures, self.item = scene, textures, item
        self.extensions = item.item("extensions")
        self.uses: list[Use] = []
        for name in sorted(self.extensions.data.keys() - _EXTENSIONS):
            self._warn(f"{name} is not supported and not used")

    def material(self) -> Material:
        """The surface, without its emission."""
        common: dict[str, Any] = {**self._opacity(), "normal_map": self._normal_map()}
        if "KHR_materials_unlit" in self.extensions:
            return Diffuse(reflectance=0.0, **common)
        pbr = self.item.item("pbrMetallicRoughness")
        base = self._factors(pbr, "baseColorFactor", 4)[:3]
        ior = self.extensions.item("KHR_materials_ior").number("ior", 1.5)
        if "occlusionTexture" in self.item:
            self.scene.warn("occlusion textures are not used: the renderer finds the occlusion")
        return Principled(
            base_color=self._color(pbr, "baseColorTexture", base),
            metallic=self._value(pbr, "metallicRoughnessTexture", "b",
                                 self._factor(pbr, "metallicFactor", 1.0)),
            roughness=self._value(pbr, "metallicRoughnessTexture", "g",
                                  self._factor(pbr, "roughnessFactor", 1.0)),
            ior=min(max(ior, 1.0), 10.0),
            **self._specular(),
            **self._transmission(),
            **common,
        )  # fmt: skip

    def emission(self) -> Emission | None:
        """The radiance given off, or None."""
        two_sided = self.item.boolean("doubleSided", False)
        if "KHR_materials_unlit" in self.extensions:
            pbr = self.item.item("pbrMetallicRoughness")
            base = self._factors(pbr, "baseColorFactor", 4)[:3]
            radiance = self._color(pbr, "baseColorTexture", base)
            return Emission(radiance=radiance, two_sided=two_sided)
        strength = self.extensions.item("KHR_materials_emissive_strength")
        scale = strength.number("emissiveStrength", 1.0)
        if scale < 0:
            raise SceneError("a negative strength", pointer=strength.pointer, found=scale)
        factor = [scale * f for f in self._factors(self.item, "emissiveFactor", 3, 0.0)]
        if not any(factor):
            return None
        radiance = self._color(self.item, "emissiveTexture", factor)
        return Emission(radiance=radiance, two_sided=two_sided)

    def coordinates(self) -> int:
        """The set of texture coordinates that the textures use."""
        sets = [use.coordinates for use in self.uses]
        if len(set(sets)) > 1:
            self._warn("textures with different sets of coordinates: the first one's set is used")
        return sets[0] if sets else 0

    def _opacity(self) -> dict[str, Any]:
        mode = self.item.string("alphaMode", "OPAQUE")
        if mode not in ("OPAQUE", "MASK", "BLEND"):
            raise SceneError("an unknown alpha mode", pointer=f"{self.item.pointer}/alphaMode",
                             found=mode, accepted="OPAQUE MASK BLEND")  # fmt: skip
        if mode == "OPAQUE":
            return {}
        pbr = self.item.item("pbrMetallicRoughness")
        alpha = self._factors(pbr, "baseColorFactor", 4)[3]
        # A texture times 0 is 0, but a reference's factor of 0 would still read the image.
        values: dict[str, Any] = {"opacity": self._value(pbr, "baseColorTexture", "a", alpha)}
        if mode == "MASK":
            values["alpha_cutoff"] = self.item.number("alphaCutoff", 0.5)
            if not 0 <= values["alpha_cutoff"] <= 1:
                # Above 1 nothing is left; below 0 all.
                values["opacity"] = 0.0 if values["alpha_cutoff"] > 1 else 1.0
                values["alpha_cutoff"] = None
        return values

    def _normal_map(self) -> NormalMap | None:
        if "normalTexture" not in self.item:
            return None
        info = self.item.item("normalTexture")
        use = self._use(info, "linear")
        scale = info.number("scale", 1.0)
        if scale < 0:
            self._warn("a negative normal scale is not supported; its size is used")
        return NormalMap(texture=use.name, scale=abs(scale)) if use else None

    def _specular(self) -> dict[str, Any]:
        item = self.extensions.item("KHR_materials_specular")
        if not item.data:
            return {}
        strength = self._factor(item, "specularFactor", 1.0)
        color = self._factors(item, "specularColorFactor", 3, limit=None)
        return {
            "specular": self._value(item, "specularTexture", "a", strength),
            "specular_color": self._color(item, "specularColorTexture", color),
        }

    def _transmission(self) -> dict[str, Any]:
        item = self.extensions.item("KHR_materials_transmission")
        strength = self._factor(item, "transmissionFactor", 0.0)
        if not strength:
            return {}
        return {"transmission": self._value(item, "transmissionTexture", "r", strength)}

    def _color(self, owner: Item, texture: str, factor: list[float]) -> Any:
        color = (factor[0], factor[1], factor[2])
        use = self._use(owner.item(texture), "srgb") if texture in owner else None
        return TextureRef(texture=use.name, factor=color) if use else color

    def _value(self, owner: Item, texture: str, channel: str, factor: float) -> Any:
        space = "srgb" if texture == "baseColorTexture" else "linear"
        use = self._use(owner.item(texture), space) if texture in owner else None
        if use is None:
            return factor
        return TextureRef.model_validate(
            {"texture": use.name, "channel": channel, "factor": factor}
        )

    def _use(self, info: Item, color_space: str) -> Use | None:
        use = self.textures.use(info, color_space)
        if use:
            self.uses.append(use)
        return use

    def _factor(self, owner: Item, name: str, default: float) -> float:
        return min(max(owner.number(name, default), 0.0), 1.0)

    def _factors(
        self, owner: Item, name: str, size: int, default: float = 1.0, limit: float | None = 1.0
    ) -> list[float]:
        values = [max(v, 0.0) for v in owner.numbers(name, size, [default] * size)]
        return values if limit is None else [min(v, limit) for v in values]

    def _warn(self, message: str) -> None:
        label = self.item.string("name", "")
        self.scene.warn(f"{self.item.pointer or 'material'} {label}: {message}".replace(" :", ":"))

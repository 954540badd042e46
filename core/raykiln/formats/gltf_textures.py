"""glTF textures as textures of the scene."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from raykiln.errors import SceneError
from raykiln.formats.gltf_data import GltfData
from raykiln.formats.gltf_images import EmbeddedImages, image_of, is_embedded
from raykiln.formats.json_text import Item
from raykiln.formats.names import unique_name
from raykiln.scene import ImageTexture, Scene

_WRAPS = {10497: "repeat", 33071: "clamp", 33648: "mirror"}
_NEAREST = 9728


@dataclass(frozen=True)
class Use:
    """A texture as a material uses it: the scene's name for it, and which set of coordinates."""

    name: str
    coordinates: int


class Textures:
    """Adds each texture to the scene once for every way in which it is used."""

    def __init__(self, data: GltfData, scene: Scene, images: EmbeddedImages) -> None:
        self.data, self.scene, self.images = data, scene, images
        self._names: dict[Any, str] = {}

    def use(self, info: Item, color_space: str) -> Use | None:
        """The texture of a textureInfo; None (and a warning) if its image is not supported."""
        texture = self.data.root.entry("textures", info.integer("index"), f"{info.pointer}/index")
        use = Use("", info.integer("texCoord", 0))
        matrix = None
        transform = info.item("extensions")
        if "KHR_texture_transform" in transform:
            shift = transform.item("KHR_texture_transform")
            use = replace(use, coordinates=shift.integer("texCoord", use.coordinates))
            matrix = uv_matrix(shift)
        source = image_of(texture)
        if source is None:
            self.scene.warn(f"{texture.pointer}: the texture has no image that can be read")
            return None
        key = (texture.pointer, color_space, matrix)
        if key not in self._names:
            self._names[key] = self._add(texture, source, color_space, matrix)
        return replace(use, name=self._names[key])

    def _add(self, texture: Item, source: int, color_space: str, matrix: Any) -> str:
        image = self.data.root.entry("images", source, f"{texture.pointer}/source")
        values: dict[str, Any] = {
            **self._content(image),
            **self._sampler(texture),
            "color_space": color_space,
            "uv_transform": matrix,
        }
        label = image.string("name", "") or texture.string("name", "") or f"image_{source}"
        name = unique_name(label, self.scene.textures)
        self.scene.textures[name] = ImageTexture.model_validate(values)
        return name

    def _content(self, image: Item) -> dict[str, Any]:
        if is_embedded(image):
            return {"pixels": self.images.pixels(image)}
        path = self.data.files.resolve_uri(image.string("uri"), f"{image.pointer}/uri")
        return {"file": self.data.files.relative(path)}

    def _sampler(self, texture: Item) -> dict[str, Any]:
        if "sampler" not in texture:
            return {}
        index = texture.integer("sampler")
        sampler = self.data.root.entry("samplers", index, f"{texture.pointer}/sampler")
        values: dict[str, Any] = {}
        for key, name in (("wrapS", "wrap_u"), ("wrapT", "wrap_v")):
            mode = sampler.integer(key, 10497)
            if mode not in _WRAPS:
                raise SceneError(
                    "an unknown wrap mode",
                    pointer=f"{sampler.pointer}/{key}",
                    found=mode,
                    accepted=" ".join(map(str, _WRAPS)),
                )
            values[name] = _WRAPS[mode]
        if sampler.integer("magFilter", 0) == _NEAREST:
            values["filter"] = "nearest"
        return values


def uv_matrix(transform: Item) -> Any:
    """The rows of a KHR_texture_transform that act on (u, v, 1).

    The rotation is counter-clockwise as seen on the image, where v points down.
    """
    x, y = transform.numbers("offset", 2, [0.0, 0.0])
    sx, sy = transform.numbers("scale", 2, [1.0, 1.0])
    angle = transform.number("rotation", 0.0)
    c, s = math.cos(angle), math.sin(angle)
    matrix = np.array([[c * sx, s * sy, x], [-s * sx, c * sy, y]])
    return tuple(tuple(float(value) for value in row) for row in matrix)

"""The images within a glTF file."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress

from raykiln.errors import ImageError, SceneError
from raykiln.formats.gltf_data import GltfData, data_uri
from raykiln.formats.json_text import Item
from raykiln.formats.meshes import Array
from raykiln.image.ahead import reading_ahead
from raykiln.image.codec import Source

_EXTENSIONS = ("EXT_texture_webp",)


def image_of(texture: Item) -> int | None:
    """The index of a texture's image; None if it has none of a supported kind."""
    extensions = texture.item("extensions")
    for name in _EXTENSIONS:
        if name in extensions:
            return extensions.item(name).integer("source")
    return texture.integer("source") if "source" in texture else None


def is_embedded(image: Item) -> bool:
    """Whether an image is within the file rather than beside it."""
    return "uri" not in image or image.string("uri").startswith("data:")


class EmbeddedImages:
    """Images within the file, decoded by several threads before a material asks for them."""

    def __init__(self, data: GltfData) -> None:
        self._data = data
        self._coded: dict[str, Source] = {}
        self._decoded: Callable[[str], Array]

    @contextmanager
    def decoding(self) -> Iterator[None]:
        """Within this, `pixels` may be called."""
        root = self._data.root
        for texture in root.items("textures"):
            with suppress(SceneError):  # raised again when the image is asked for
                index = image_of(texture)
                if index is not None:
                    image = root.entry("images", index, f"{texture.pointer}/source")
                    if is_embedded(image):
                        self._bytes(image)
        with reading_ahead(self._coded) as self._decoded:
            yield

    def pixels(self, image: Item) -> Array:
        """Pixels (height, width, channels) of an embedded image that a texture has."""
        self._bytes(image)
        try:
            return self._decoded(image.pointer)
        except ImageError as error:
            raise SceneError(
                f"the embedded image cannot be read: {error}", pointer=image.pointer
            ) from None

    def _bytes(self, image: Item) -> Source:
        if image.pointer not in self._coded:
            self._coded[image.pointer] = self._found(image)
        return self._coded[image.pointer]

    def _found(self, image: Item) -> Source:
        if "uri" in image:
            return data_uri(image.string("uri"), f"{image.pointer}/uri")
        if "bufferView" not in image:
            raise SceneError("an image without data", pointer=image.pointer)
        view, _ = self._data.view(image.integer("bufferView"), f"{image.pointer}/bufferView")
        return view

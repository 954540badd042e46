"""NumPy arrays as fields of the scene description, and how they look in JSON."""

from __future__ import annotations

import base64
import zlib
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import BeforeValidator, PlainSerializer, WithJsonSchema

# Longer arrays are written as base64 of the deflated bytes, shorter ones as lists.
LIST_LIMIT = 96
# A deflated array may not claim more than this.
MAX_BYTES = 1 << 33


def decode(value: Any, dtype: str) -> Any:
    """An array from nested lists, from {"dtype", "shape", "base64"}, or itself."""
    if isinstance(value, dict):
        return _from_packed(value)
    if isinstance(value, np.ndarray):
        return value
    try:
        return np.asarray(value, dtype=dtype)
    except (ValueError, TypeError, OverflowError) as error:
        raise ValueError(f"not an array of {dtype}: {error}") from None


def _from_packed(value: dict[str, Any]) -> NDArray[Any]:
    try:
        dtype = np.dtype(value["dtype"])
        shape = tuple(int(n) for n in value["shape"])
        raw = base64.b64decode(value["base64"], validate=True)
    except (KeyError, TypeError, ValueError) as error:
        raise ValueError(f"a packed array takes dtype, shape and base64: {error}") from None
    size = int(np.prod(shape, dtype=object)) * dtype.itemsize
    if dtype.kind not in "fiu" or not 0 <= size <= MAX_BYTES:
        raise ValueError(f"a packed array of {dtype} and shape {shape} is not accepted")
    try:
        inflater = zlib.decompressobj()
        data = inflater.decompress(raw, size + 1)
    except zlib.error as error:
        raise ValueError(f"a packed array that cannot be inflated: {error}") from None
    if len(data) != size:
        raise ValueError(f"a packed array of shape {shape} holds {len(data)} bytes, not {size}")
    return np.frombuffer(data, dtype=dtype).reshape(shape)


def encode(array: NDArray[Any]) -> Any:
    """The JSON form of an array: nested lists if short, else packed."""
    # 8- and 16-bit images are packed whatever their size: a list would come back as float32.
    if array.size <= LIST_LIMIT and array.dtype not in (np.uint8, np.uint16):
        return array.tolist()
    raw = zlib.compress(np.ascontiguousarray(array).tobytes(), 6)
    return {
        "dtype": str(array.dtype),
        "shape": list(array.shape),
        "base64": base64.b64encode(raw).decode("ascii"),
    }


def _rows(dtype: str, *columns: int) -> BeforeValidator:
    def check(value: Any) -> Any:
        if value is None:
            return None
        array = decode(value, dtype)
        if array.size == 0:
            array = array.reshape((0, *columns))
        if array.ndim != 1 + len(columns) or array.shape[1:] != columns:
            wanted = " x ".join(["n", *map(str, columns)])
            raise ValueError(f"expected an array of {wanted}, found shape {array.shape}")
        return _cast(array, dtype)

    return BeforeValidator(check)


def _cast(array: NDArray[Any], dtype: str) -> NDArray[Any]:
    if np.dtype(dtype).kind == "u" and array.size:
        if array.dtype.kind not in "iu":
            raise ValueError(f"expected integers, found {array.dtype}")
        if array.dtype.kind == "i" and int(array.min()) < 0:
            raise ValueError(f"expected indices from 0, found {int(array.min())}")
        if int(array.max()) > 0xFFFFFFFF:
            raise ValueError(f"expected 32-bit indices, found {int(array.max())}")
    # Aligned too: a view into the bytes of a file may begin anywhere, and the core shares arrays.
    return np.require(array, dtype, ["C", "A"])


def _image(value: Any) -> Any:
    if value is None:
        return None
    array = decode(value, "float32")
    if array.ndim == 2:
        array = array[:, :, None]
    if array.ndim != 3 or not 1 <= array.shape[2] <= 4 or array.size == 0:
        raise ValueError(f"expected an image (height, width, 1..4), found shape {array.shape}")
    if array.dtype not in (np.uint8, np.uint16):
        array = array.astype(np.float32, copy=False)
    return np.require(array, requirements=["C", "A"])


_SCHEMA = {
    "anyOf": [
        {"type": "array", "description": "nested lists of numbers"},
        {
            "type": "object",
            "description": "base64 of the deflated little-endian bytes in C order",
            "properties": {
                "dtype": {"type": "string"},
                "shape": {"type": "array", "items": {"type": "integer"}},
                "base64": {"type": "string"},
            },
            "required": ["dtype", "shape", "base64"],
        },
    ]
}
_JSON = (PlainSerializer(encode, when_used="json-unless-none"), WithJsonSchema(_SCHEMA))

Float3 = Annotated[NDArray[np.float32], _rows("float32", 3), *_JSON]
Float2 = Annotated[NDArray[np.float32], _rows("float32", 2), *_JSON]
Index3 = Annotated[NDArray[np.uint32], _rows("uint32", 3), *_JSON]
Matrices = Annotated[NDArray[np.float32], _rows("float32", 4, 4), *_JSON]
FloatImage = Annotated[NDArray[Any], BeforeValidator(_image), *_JSON]

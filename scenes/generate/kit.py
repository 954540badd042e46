"""What the generators share: JSON that is pleasant to read, matrices, and a sky."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
from numpy.typing import NDArray
from raykiln.arrays import encode

Array = NDArray[np.float64]
LINE = 96


def scene_json(scene: dict[str, Any]) -> bytes:
    """A scene as JSON: what fits goes on one line, long arrays are packed."""
    return (_text(_plain(scene), 0) + "\n").encode()


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray):
        return _plain(encode(value))
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, float | np.floating):
        short = float(f"{float(value):.6g}")
        return int(short) if short.is_integer() else short
    return value


def _text(value: Any, depth: int) -> str:
    line = json.dumps(value, ensure_ascii=False)
    if not isinstance(value, dict | list) or len(line) + depth <= LINE or _is_packed(value):
        return line
    if isinstance(value, list):
        brackets, items = "[]", [_text(item, depth + 1) for item in value]
    else:
        brackets = "{}"
        items = [f"{json.dumps(key)}: {_text(item, depth + 1)}" for key, item in value.items()]
    space = " " * (depth + 1)
    inside = ",\n".join(space + item for item in items)
    return f"{brackets[0]}\n{inside}\n{' ' * depth}{brackets[1]}"


def _is_packed(value: Any) -> bool:
    return isinstance(value, dict) and "base64" in value


def coarse(values: Any, step: float) -> NDArray[np.float32]:
    """Values rounded to multiples of `step` (a power of 2), which pack better.

    Rounding also hides the last bits in which mathematical libraries differ.
    """
    return (np.round(np.asarray(values, np.float64) / step) * step).astype(np.float32)


def unit(vector: Any) -> Array:
    """Vectors (..., 3) scaled to length 1."""
    v = np.asarray(vector, np.float64)
    normalized: Array = v / np.linalg.norm(v, axis=-1, keepdims=True)
    return normalized


def quad_faces(count: int) -> NDArray[np.int64]:
    """Two triangles for each four vertices in a row."""
    first = 4 * np.arange(count)[:, None]
    return np.concatenate([first + np.array([0, 1, 2]), first + np.array([0, 2, 3])])


def placement(center: Any, x: Any, y: Any, z: Any) -> Array:
    """The matrix (4, 4) that takes the axes of a shape to the vectors x, y, z around `center`."""
    matrix = np.eye(4)
    matrix[:3, 0], matrix[:3, 1], matrix[:3, 2], matrix[:3, 3] = x, y, z, center
    return matrix


def rows(matrix: Array) -> list[list[float]]:
    """A matrix as the scene format spells it."""
    return [[float(x) for x in row] for row in matrix]


def directions(height: int) -> Array:
    """Directions (height, 2 height, 3) of the pixel centres of an environment map."""
    u = (np.arange(2 * height) + 0.5) / (2 * height) * 2 * np.pi
    v = ((np.arange(height) + 0.5) / height * np.pi)[:, None]
    shape = (height, 2 * height)
    return np.stack(
        [np.sin(v) * np.sin(u), np.broadcast_to(np.cos(v), shape), -np.sin(v) * np.cos(u)], axis=-1
    )


def lobe(toward: Any, direction: Any, sharpness: float) -> Array:
    """A spherical Gaussian around `direction`, 1 at its centre, for directions (..., 3)."""
    cosine = np.asarray(toward) @ unit(direction)
    values: Array = np.exp(sharpness * (cosine - 1.0))
    return values[..., None]

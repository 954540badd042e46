"""Mitsuba's transform elements as matrices."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raykiln.errors import SceneError
from raykiln.formats.mitsuba_xml import XmlNode

Matrix = NDArray[np.float64]


def numbers(text: str, pointer: str) -> list[float]:
    """Finite numbers apart by blanks or commas."""
    try:
        values = [float(word) for word in text.replace(",", " ").split()]
    except ValueError:
        values = [math.nan]
    if not all(math.isfinite(value) for value in values):
        raise SceneError("not finite numbers", pointer=pointer, found=text)
    return values


def number(text: str, pointer: str) -> float:
    """One finite number."""
    values = numbers(text, pointer)
    if len(values) != 1:
        raise SceneError("not one number", pointer=pointer, found=text)
    return values[0]


def vector(node: XmlNode, default: float = 0.0) -> list[float]:
    """x, y and z of an element, given one by one or as `value` (one for all, or three)."""
    if "value" in node.attributes:
        values = numbers(node.attributes["value"], node.pointer)
        if len(values) not in (1, 3):
            raise SceneError("a vector takes one or three numbers", pointer=node.pointer)
        return values * 3 if len(values) == 1 else values
    return [
        number(node.attributes[k], node.pointer) if k in node.attributes else default for k in "xyz"
    ]


def transform(node: XmlNode) -> Matrix:
    """The matrix of a transform element: its steps, the first applied first."""
    matrix = np.eye(4)
    for step in node.children:
        maker = _STEPS.get(step.tag)
        if maker is None:
            raise SceneError(
                "not a transform", pointer=step.pointer, found=step.tag, accepted=" ".join(_STEPS)
            )
        matrix = maker(step) @ matrix
    if not np.isfinite(matrix).all():
        raise SceneError("the transform is not finite", pointer=node.pointer)
    return matrix


def _translate(node: XmlNode) -> Matrix:
    matrix = np.eye(4)
    matrix[:3, 3] = vector(node)
    return matrix


def _scale(node: XmlNode) -> Matrix:
    return np.diag([*vector(node, 1.0), 1.0])


def _rotate(node: XmlNode) -> Matrix:
    axis = np.array(vector(node))
    length = float(np.linalg.norm(axis))
    if length == 0:
        raise SceneError("a rotation takes an axis other than zero", pointer=node.pointer)
    x, y, z = axis / length
    angle = math.radians(number(node.attributes.get("angle", ""), node.pointer))
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    matrix = np.eye(4)
    matrix[:3, :3] += math.sin(angle) * cross + (1 - math.cos(angle)) * (cross @ cross)
    return matrix


def _matrix(node: XmlNode) -> Matrix:
    values = numbers(node.attributes.get("value", ""), node.pointer)
    matrix = np.eye(4)
    if len(values) == 16:
        matrix[:] = np.reshape(values, (4, 4))
    elif len(values) == 9:
        matrix[:3, :3] = np.reshape(values, (3, 3))
    else:
        raise SceneError("a matrix takes 9 or 16 numbers", pointer=node.pointer, found=len(values))
    if not np.allclose(matrix[3], [0, 0, 0, 1]):
        raise SceneError("the last row of a matrix must be 0 0 0 1", pointer=node.pointer)
    return matrix


def _look_at(node: XmlNode) -> Matrix:
    origin, target = (np.array(_three(node, name)) for name in ("origin", "target"))
    forward = _unit(target - origin, node)
    up = np.array(_three(node, "up")) if node.attributes.get("up") else np.zeros(3)
    if not up.any():
        up = np.eye(3)[int(np.argmin(np.abs(forward)))]
    left = _unit(np.cross(up, forward), node)
    matrix = np.eye(4)
    matrix[:3] = np.stack([left, np.cross(forward, left), forward, origin], axis=1)
    return matrix


def _three(node: XmlNode, name: str) -> list[float]:
    values = numbers(node.attributes.get(name, ""), node.pointer)
    if len(values) != 3:
        raise SceneError(f"'{name}' takes three numbers", pointer=node.pointer)
    return values


def _unit(v: Any, node: XmlNode) -> Any:
    length = np.linalg.norm(v)
    if not length > 0:
        raise SceneError("origin, target and up must not lie on one line", pointer=node.pointer)
    return v / length


_STEPS = {
    "translate": _translate,
    "scale": _scale,
    "rotate": _rotate,
    "matrix": _matrix,
    "lookat": _look_at,
    "lookAt": _look_at,
}

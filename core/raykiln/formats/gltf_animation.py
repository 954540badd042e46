"""The animations of a glTF file: nodes as they are at one moment."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from raykiln.errors import SceneError
from raykiln.formats.gltf_data import GltfData
from raykiln.formats.json_text import Item
from raykiln.formats.meshes import Array
from raykiln.scene import Scene

_WIDTHS = {"translation": 3, "rotation": 4, "scale": 3}
_INTERPOLATIONS = ("LINEAR", "STEP", "CUBICSPLINE")


class Track(NamedTuple):
    """The values of one property of one node over time."""

    node: int
    path: str
    times: Array
    """(n,) seconds, rising."""
    values: Array
    """(n, width); for cubic splines (n, 3, width): in-tangent, value, out-tangent."""
    interpolation: str

    def at(self, time_s: float) -> list[float]:
        """The value at a moment; before the first key and after the last it stands still."""
        place = int(np.searchsorted(self.times, time_s, side="right")) - 1
        after = min(place + 1, len(self.times) - 1)
        place = max(place, 0)
        span = float(self.times[after] - self.times[place])
        share = (time_s - float(self.times[place])) / span if place < after else 0.0
        value = self._between(place, after, min(max(share, 0.0), 1.0), span)
        if self.path == "rotation":
            length = float(np.linalg.norm(value))
            value = value / length if length > 0 else np.array([0.0, 0.0, 0.0, 1.0])
        return [float(x) for x in value]

    def _between(self, before: int, after: int, share: float, span: float) -> Array:
        values = self.values.astype(np.float64)
        if self.interpolation == "CUBICSPLINE":
            return _cubic(values[before], values[after], share, span)
        if self.interpolation == "STEP" or share == 0.0:
            kept: Array = values[before]
            return kept
        if self.path == "rotation":
            return _slerp(values[before], values[after], share)
        between: Array = values[before] + share * (values[after] - values[before])
        return between


def _cubic(start: Array, end: Array, t: float, span: float) -> Array:
    """A Hermite spline (glTF 2.0, appendix C.5)."""
    t2, t3 = t * t, t * t * t
    value: Array = (
        (2 * t3 - 3 * t2 + 1) * start[1]
        + span * (t3 - 2 * t2 + t) * start[2]
        + (-2 * t3 + 3 * t2) * end[1]
        + span * (t3 - t2) * end[0]
    )
    return value


def _slerp(start: Array, end: Array, t: float) -> Array:
    """The shorter way from one rotation to another, at an even pace (appendix C.4)."""
    cosine = float(start @ end)
    sign = -1.0 if cosine < 0 else 1.0
    angle = float(np.arccos(min(abs(cosine), 1.0)))
    if angle < 1e-6:
        near: Array = start + t * (sign * end - start)
        return near
    weights = np.sin((1 - t) * angle), sign * np.sin(t * angle)
    value: Array = (weights[0] * start + weights[1] * end) / np.sin(angle)
    return value


def animate(data: GltfData, nodes: list[Item], scene: Scene, time_s: float | None) -> None:
    """Check all animations, and move `nodes` to where they are at `time_s` (None = at rest).

    All animations play at once.  Where several move one property of one node, the first counts.
    """
    tracks: dict[tuple[int, str], Track] = {}
    clash = False
    for animation in data.root.items("animations"):
        for track in _tracks(data, animation, nodes):
            clash |= (track.node, track.path) in tracks
            tracks.setdefault((track.node, track.path), track)
    if not tracks:
        return
    scene.time_range_s = (
        min(float(track.times[0]) for track in tracks.values()),
        max(float(track.times[-1]) for track in tracks.values()),
    )
    if time_s is None:
        scene.warn("animations are not played: the scene is shown at rest")
        return
    if clash:
        scene.warn("several animations move the same nodes: the first of each is played")
    for track in tracks.values():
        node = nodes[track.node]
        nodes[track.node] = Item({**node.data, track.path: track.at(time_s)}, node.pointer)


def _tracks(data: GltfData, animation: Item, nodes: list[Item]) -> list[Track]:
    tracks = []
    for channel in animation.items("channels"):
        target = channel.item("target")
        path = target.string("path")
        if "node" not in target or path not in (*_WIDTHS, "weights"):
            continue
        number = target.integer("node")
        if number >= len(nodes):
            raise SceneError("a reference to no node", pointer=f"{target.pointer}/node")
        if "matrix" in nodes[number]:
            raise SceneError("an animated node must not have a matrix", pointer=target.pointer)
        sampler = animation.entry("samplers", channel.integer("sampler"), channel.pointer)
        tracks.append(_track(data, sampler, number, path))
    return tracks


def _track(data: GltfData, sampler: Item, node: int, path: str) -> Track:
    interpolation = sampler.string("interpolation", "LINEAR")
    if interpolation not in _INTERPOLATIONS:
        raise SceneError(
            "an unknown interpolation",
            pointer=f"{sampler.pointer}/interpolation",
            found=interpolation,
            accepted=" ".join(_INTERPOLATIONS),
        )
    times = data.floats(sampler.integer("input"), f"{sampler.pointer}/input").astype(np.float64)
    if times.shape[1] != 1 or not np.isfinite(times).all() or (np.diff(times[:, 0]) <= 0).any():
        raise SceneError("the times of an animation must rise", pointer=f"{sampler.pointer}/input")
    values = data.floats(sampler.integer("output"), f"{sampler.pointer}/output")
    return Track(node, path, times[:, 0], _shaped(values, times, sampler, path), interpolation)


def _shaped(values: Array, times: Array, sampler: Item, path: str) -> Array:
    """The values as one row a key (of three rows for a cubic spline)."""
    parts = 3 if sampler.string("interpolation", "LINEAR") == "CUBICSPLINE" else 1
    keys, width = len(times), _WIDTHS.get(path, 0)
    fits = values.shape == (keys * parts, width)
    if path == "weights":
        width = values.size // (keys * parts)
        fits = width >= 1 and values.size == keys * parts * width
    if not fits or not np.isfinite(values).all():
        raise SceneError(
            f"the values of an animated {path} do not match its times",
            pointer=f"{sampler.pointer}/output",
            found=f"{len(values)} x {values.shape[1]}",
            accepted=f"{parts} for each of {keys} times",
        )
    return values.reshape((keys, 3, width) if parts == 3 else (keys, width))

"""What a render returns: image, layers, statistics, and how to save them."""

from __future__ import annotations

import json
import time
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raykiln import image as images
from raykiln.errors import ImageError
from raykiln.settings import RenderSettings

Pixels = NDArray[np.float32]


@dataclass
class RenderStats:
    """Phases in seconds, work done, and with what: the fields of ``stats.json``."""

    queue_s: float = 0.0
    load_s: float = 0.0
    bvh_s: float = 0.0
    render_s: float = 0.0
    denoise_s: float = 0.0
    encode_s: float = 0.0
    total_s: float = 0.0
    samples: int = 0
    """Camera samples over all pixels."""
    spp: int = 0
    """Samples that every pixel has."""
    camera_rays: int = 0
    bounce_rays: int = 0
    shadow_rays: int = 0
    rays_per_s: float = 0.0
    peak_memory_bytes: int = 0
    triangles: int = 0
    threads: int = 0
    isa: str = ""
    nonfinite_samples: int = 0
    engine_version: str = ""
    scene_sha256: str = ""
    warm: bool = False
    """The scene was in memory already, built for an earlier render."""

    def as_dict(self) -> dict[str, Any]:
        """The statistics as plain values, for JSON."""
        return asdict(self)


@dataclass
class RenderResult:
    """A finished (or stopped) render.

    Attributes
    ----------
    image
        float32 (height, width, 3), linear scene-referred radiance, Rec.709 primaries.
    aovs
        Layers by name: albedo and normal (height, width, 3), depth and variance (height, width).
        Normals are in world space; depth is along the view axis in metres, 0 where nothing was
        met; variance is that of the pixel's luminance estimate. A denoised result also has the
        image before denoising, `noisy`.
    settings
        What was rendered: the caller's settings, then the scene's, then the defaults.
    complete
        False if the render was stopped before all its samples were taken.
    """

    image: Pixels
    aovs: dict[str, Pixels]
    stats: RenderStats
    settings: RenderSettings
    warnings: list[str] = field(default_factory=list)
    complete: bool = True

    @property
    def scene_sha256(self) -> str:
        """SHA-256 of all that the scene says."""
        return self.stats.scene_sha256

    def save(
        self,
        path: str | Path,
        *,
        exposure: float = 0.0,
        view: images.View = "srgb",
        half: bool = False,
        compress: bool = True,
    ) -> Path:
        """Write the result: ``.exr`` with all layers, or ``.png`` through a view transform.

        Parameters
        ----------
        path
            The extension says the format; the file appears whole or not at all.
        exposure
            Stops; PNG only.
        view
            srgb, agx, aces or raw; PNG only.
        half
            Store the colours of an EXR as 16-bit floats.
        compress
            False writes a larger EXR at several times the speed.

        Raises
        ------
        ImageError
            Another extension, or a file that cannot be written.
        """
        start = time.perf_counter()
        path = Path(path)
        suffix = path.suffix.lower()
        if suffix == ".exr":
            layers = {"beauty": self.image, **self.aovs}
            window = self._window()
            images.write_exr(
                path,
                layers,
                half=half,
                metadata=self.metadata(),
                window=window,
                compress=compress,
            )
        elif suffix == ".png":
            pixels = images.to_png_pixels(self.image, view=view, exposure=exposure)
            metadata = {**self.metadata(), "view": view, "exposure": float(exposure)}
            images.write_png(path, pixels, metadata=metadata)
        else:
            raise ImageError(f"{path}: unknown image format {suffix!r}; accepted: .exr, .png")
        self.stats.encode_s += time.perf_counter() - start
        return path

    def _window(self) -> tuple[int, int, int, int] | None:
        """Where the pixels of a crop lie in the whole image."""
        if self.settings.crop is None:
            return None
        x0, y0, _x1, _y1 = self.settings.crop
        return x0, y0, self.settings.width, self.settings.height

    def metadata(self) -> dict[str, str | int | float]:
        """What the image files say about themselves; the same for the same bits."""
        settings = self.settings.model_dump(exclude={"threads", "time_budget_s"})
        return {
            "raykiln:scene_sha256": self.scene_sha256,
            "raykiln:settings": json.dumps(settings, sort_keys=True),
            "raykiln:seed": self.settings.seed,
            "raykiln:spp": self.stats.spp,
            "raykiln:complete": int(self.complete),
            "raykiln:engine_version": self.stats.engine_version,
            "raykiln:isa": self.stats.isa,
        }

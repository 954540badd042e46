"""Denoising with Intel Open Image Denoise, the optional extra `raykiln[denoise]`."""

from __future__ import annotations

import importlib.util

import numpy as np
from numpy.typing import NDArray

from raykiln.errors import RenderError, SettingsError

Pixels = NDArray[np.float32]


def available() -> bool:
    """Whether the extra is installed."""
    return importlib.util.find_spec("pyoidn") is not None


def require() -> None:
    """Raise `SettingsError` if the extra is not installed."""
    if not available():
        raise SettingsError("denoise: needs the extra: pip install 'raykiln[denoise]'")


def denoise(image: Pixels, albedo: Pixels, normal: Pixels) -> Pixels:
    """Denoise linear radiance, guided by the albedo and the normals of the same render.

    Parameters
    ----------
    image, albedo, normal
        float32 (height, width, 3).

    Raises
    ------
    SettingsError
        The extra is not installed.
    RenderError
        The denoiser failed.
    """
    require()
    import pyoidn

    guides = {"albedo": np.clip(albedo, 0, 1), "normal": normal}
    try:
        result = pyoidn.denoise(image, hdr=True, **guides)
    except (RuntimeError, OSError) as error:
        raise RenderError(f"the denoiser failed: {error}") from None
    return np.ascontiguousarray(result, dtype=np.float32)

"""Render settings: what a caller may ask of a render, with the defaults of the contract."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any, Literal, get_args

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from raykiln.errors import SettingsError, pointer_of, shorten

Integrator = Literal["path", "whitted", "direct", "ao"]
Sampler = Literal["sobol", "independent"]
Filter = Literal["box", "tent", "gaussian", "blackman_harris"]
Aov = Literal["albedo", "normal", "depth", "variance"]

MAX_PIXELS = 1 << 28
_DEPTH = "a path length of at least 1, or -1 for none"


if TYPE_CHECKING:
    _Base = BaseModel
else:

    class _RaisesSettingsError(type(BaseModel)):
        """Makes `RenderSettings(spp=0)` a `SettingsError`; validation by pydantic stays its own."""

        def __call__(cls, *args, **values):
            try:
                return super().__call__(*args, **values)
            except ValidationError as error:
                raise settings_error_of(error) from None

    class _Base(BaseModel, metaclass=_RaisesSettingsError):
        pass


class RenderSettings(_Base):
    """How to render a scene.  Fields left unset are taken from the scene, then from the defaults.

    A bad value raises `SettingsError`, which names it.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    width: Annotated[int, Field(ge=1, le=65536)] = 512
    """Image width in pixels."""
    height: Annotated[int, Field(ge=1, le=65536)] = 512
    """Image height in pixels."""
    spp: Annotated[int, Field(ge=1, le=1 << 20)] = 64
    """Samples per pixel."""
    max_depth: Annotated[int, Field(ge=-1, le=1 << 16)] = 8
    """Path segments at most: 1 = emission only, 2 = direct light, -1 = no limit."""
    rr_depth: Annotated[int, Field(ge=-1, le=1 << 16)] = 5
    """Path length from which Russian roulette may end a path; -1 = never."""
    seed: Annotated[int, Field(ge=0, lt=1 << 32)] = 0
    """Seed of the sample sequence: the same seed gives the same bits."""
    integrator: Integrator = "path"
    """The estimator: path tracing, Whitted's ray tracing, direct light, or ambient occlusion."""
    sampler: Sampler = "sobol"
    """Owen-scrambled Sobol' points, or independent random numbers."""
    filter: Filter = "gaussian"
    """Pixel reconstruction filter, sampled by importance."""
    threads: Annotated[int, Field(ge=0, le=1024)] = 0
    """Worker threads; 0 = all."""
    camera: Annotated[str, Field(max_length=256)] | None = None
    """Name of the camera to use; None = the scene's first."""
    crop: tuple[int, int, int, int] | None = None
    """Part of the image to render, in pixels: (x0, y0, x1, y1), x1 and y1 excluded."""
    time_budget_s: Annotated[float, Field(gt=0, allow_inf_nan=False)] | None = None
    """Stop after the pass in which this many seconds of rendering are over."""
    noise_threshold: Annotated[float, Field(gt=0, allow_inf_nan=False)] | None = None
    """Stop when the mean relative standard error of the image falls below this."""
    denoise: bool = False
    """Denoise the result with Intel Open Image Denoise (the `denoise` extra)."""
    aovs: tuple[Aov, ...] = ()
    """Further layers to return: albedo, normal, depth, variance."""

    @model_validator(mode="after")
    def _consistent(self) -> RenderSettings:
        if self.max_depth == 0:
            raise ValueError(f"max_depth must be {_DEPTH}")
        if self.width * self.height > MAX_PIXELS:
            raise ValueError(
                f"an image of {self.width} x {self.height} pixels is over the limit of "
                f"{MAX_PIXELS} pixels"
            )
        if self.crop is not None:
            x0, y0, x1, y1 = self.crop
            # A size that is not given may be the scene's: then `over` looks again.
            width, height = (
                getattr(self, name) if name in self.model_fields_set else 65536
                for name in ("width", "height")
            )
            if not (0 <= x0 < x1 <= width and 0 <= y0 < y1 <= height):
                raise ValueError(f"crop must lie within the {width} x {height} image")
        return self

    @classmethod
    def create(cls, **values: Any) -> RenderSettings:
        """Settings from keyword values; a `SettingsError` names the first bad one."""
        return cls(**values)

    def over(self, scene_settings: dict[str, Any]) -> RenderSettings:
        """These settings, with unset fields taken from the scene's own."""
        given = {name: getattr(self, name) for name in self.model_fields_set}
        size = {name: RenderSettings.model_fields[name].default for name in ("width", "height")}
        return RenderSettings.create(**{**size, **scene_settings, **given})


def settings_error_of(error: ValidationError) -> SettingsError:
    """The first complaint of a pydantic validation, as a `SettingsError`."""
    first = error.errors(include_url=False)[0]
    name = pointer_of(first["loc"]).lstrip("/")
    found = "" if not name else f" (found {shorten(first.get('input'))})"
    return SettingsError(f"{name or 'settings'}: {first['msg']}{found}")


AOV_NAMES: tuple[str, ...] = get_args(Aov)
